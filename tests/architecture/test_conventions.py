"""Conventions of the code: directions of imports, docstrings, lengths, packages."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
FOLDERS = {
    "lftkit": ROOT / "lftkit",
    "titop_plant": ROOT / "titop_plant",
    "los_estimator": ROOT / "los_estimator",
    "fsm_pma_controller": ROOT / "fsm_pma_controller",
    "los_loop": ROOT / "los_loop",
    "los_design": ROOT / "los_design",
    "pointing_analysis": ROOT / "pointing_analysis",
    "los_testbed": ROOT / "ros_ws/src/los_testbed/los_testbed",
}
MAY_IMPORT: dict[str, set[str]] = {
    "lftkit": set(),
    "titop_plant": {"lftkit", "pointing_analysis"},
    "los_estimator": {"lftkit", "titop_plant"},
    "fsm_pma_controller": {"lftkit", "titop_plant"},
    "pointing_analysis": set(),
    "los_loop": {"lftkit", "titop_plant", "pointing_analysis"},
    "los_design": set(FOLDERS) - {"los_testbed"},
    "los_testbed": set(FOLDERS),
}
LANGUAGE = "pointing_analysis.requirements.text"
"""What the telescope may import of the analysis: the language of requirements, in which its file states them."""
LAYERS = (
    "config",
    "topics",
    "run_start",
    "variants",
    "plugins",
    "user_blocks",
    "factories",
    "bags",
    "loop",
    "run",
    "live",
    "campaign",
    "nodes",
    "cli",
)
"""Modules and subpackages of los_testbed: each imports of the package only itself and what stands before it."""
ROS = {
    "rclpy",
    "ament_index_python",
    "launch",
    "launch_ros",
    "rcl_interfaces",
    "std_msgs",
    "sensor_msgs",
    "geometry_msgs",
    "diagnostic_msgs",
    "rosgraph_msgs",
    "builtin_interfaces",
    "lifecycle_msgs",
    "std_srvs",
}
STACKS = {
    "lftkit/analysis/batched_linalg.py",
    "los_loop/sampled_loop.py",
    "los_loop/sampled_loop_norms.py",
    "los_loop/tone_model.py",
    "los_loop/steady_state.py",
    "los_loop/worst_tone.py",
}
"""Files that may use numpy.linalg, for what scipy.linalg lacks: stacks of matrices, powers of a matrix."""
MODULES = sorted((package, path) for package, folder in FOLDERS.items() for path in folder.rglob("*.py"))
FUNCTION = 60


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"), str(path))


def imports(path: Path) -> Iterator[tuple[str, str]]:
    """Top-level package and full name of every import, wherever it stands."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name.split(".")[0], alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import in line {node.lineno}"
            name = str(node.module)
            yield name.split(".")[0], name


def identifier(case: tuple[str, Path]) -> str:
    return str(case[1].relative_to(FOLDERS[case[0]].parent))


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree(path)) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)))


def lines_of_code(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines from the first statement behind the docstring to the last."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return int(body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def is_protocol(node: ast.ClassDef) -> bool:
    """A protocol says in its own docstring what its members are."""
    return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in node.bases)


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_imports_obey_the_direction(case: tuple[str, Path]) -> None:
    package, path = case
    inside = {top for top, _ in imports(path) if top in FOLDERS} - {package}
    assert inside <= MAY_IMPORT[package], f"{package} may import {sorted(MAY_IMPORT[package])}, got {sorted(inside)}"
    if package == "titop_plant":
        of_analysis = {name for top, name in imports(path) if top == "pointing_analysis"}
        assert of_analysis <= {LANGUAGE}, f"titop_plant may import {LANGUAGE} of the analysis, got {of_analysis}"
    if "nodes" not in path.relative_to(FOLDERS[package]).parts:
        assert not {top for top, _ in imports(path)} & ROS, "only nodes/ imports rclpy and message packages"


def layer(path: Path) -> str:
    return path.relative_to(FOLDERS["los_testbed"]).with_suffix("").parts[0]


@pytest.mark.parametrize("case", [c for c in MODULES if c[0] == "los_testbed"], ids=identifier)
def test_the_ros_package_imports_downward(case: tuple[str, Path]) -> None:
    _, path = case
    if layer(path) == "__init__":
        return
    allowed = LAYERS[: LAYERS.index(layer(path)) + 1]
    inside = {name.split(".")[1] for top, name in imports(path) if top == "los_testbed" and "." in name}
    assert inside <= set(allowed), f"{layer(path)} may import {allowed}, got {sorted(inside)}"


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_modules_have_telling_names(case: tuple[str, Path]) -> None:
    assert case[1].stem not in {"statistics", "utils", "core", "misc", "helpers", "common"}


@pytest.mark.parametrize("case", [c for c in MODULES if c[1].name in ("runtime.py", "interface.py")], ids=identifier)
def test_runtime_modules_need_numpy_only(case: tuple[str, Path]) -> None:
    allowed = {"numpy", *sys.stdlib_module_names}
    others = {name for top, name in imports(case[1]) if top not in allowed}
    assert others <= {
        "lftkit.systems.ports",
        "lftkit.systems.sampled_system",
        "titop_plant.interface",
        "titop_plant.ports",
    }


def test_importing_a_runtime_module_does_not_load_scipy() -> None:
    import subprocess

    code = (
        "import sys, los_estimator.runtime, fsm_pma_controller.runtime, titop_plant.interface\n"
        "import los_testbed.bags.metadata as m, los_testbed.config as c; m.run_metadata(c.RunConfig())\n"
        "print([m for m in ('scipy', 'control', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_linear_algebra_is_that_of_scipy(case: tuple[str, Path]) -> None:
    """scipy.linalg raises and warns where numpy.linalg returns; runtime modules use neither."""
    if identifier(case) in STACKS:
        return
    used = [name for _, name in imports(case[1]) if name.startswith("numpy.linalg")]
    used += [
        f"np.linalg in line {node.lineno}"
        for node in ast.walk(tree(case[1]))
        if isinstance(node, ast.Attribute)
        and node.attr == "linalg"
        and isinstance(node.value, ast.Name)
        and node.value.id in ("np", "numpy")
    ]
    assert not used


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_everything_public_has_a_docstring(case: tuple[str, Path]) -> None:
    module = tree(case[1])
    missing = []
    if module.body and ast.get_docstring(module) is None:
        missing.append("the module")
    for node in module.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            missing += [node.name] if ast.get_docstring(node) is None else []
            methods = node.body if isinstance(node, ast.ClassDef) and not is_protocol(node) else []
            missing += [
                f"{node.name}.{m.name}"
                for m in methods
                if isinstance(m, ast.FunctionDef) and not m.name.startswith("_") and ast.get_docstring(m) is None
            ]
    assert not missing


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_examples_have_a_section_of_their_own(case: tuple[str, Path]) -> None:
    """Without it the documentation site shows them as text, and a list in their output as a link."""
    texts = {
        getattr(node, "name", "module"): ast.get_docstring(node) or ""
        for node in ast.walk(tree(case[1]))
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
    }
    assert not [name for name, text in texts.items() if ">>>" in text and "Examples\n--------" not in text]


@pytest.mark.parametrize("case", MODULES, ids=identifier)
def test_functions_are_short(case: tuple[str, Path]) -> None:
    path = case[1]
    long = {f.name: lines_of_code(f) for f in functions(path) if lines_of_code(f) >= FUNCTION}
    assert not long


def test_every_package_is_in_the_distribution() -> None:
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    found = {
        ".".join([name, *path.parent.relative_to(folder).parts])
        for name, folder in FOLDERS.items()
        for path in folder.rglob("__init__.py")
    }
    assert found == listed


def test_every_folder_with_code_is_a_package() -> None:
    for folder in FOLDERS.values():
        for path in folder.rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), path


def test_test_modules_have_names_of_their_own() -> None:
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)


def test_pictures_of_the_documentation_are_small() -> None:
    for path in (ROOT / "docs").rglob("*.png"):
        assert path.stat().st_size < 150_000, path
