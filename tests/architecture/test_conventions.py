"""Conventions that no linter checks: examples, lengths, packages. `make lint` checks imports and docstrings."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from support.packages import ANALYSIS, LIBRARIES, LIBRARY, NAMES, PROJECT, ROOT, files_of, tree
from support.packages import FOLDERS as PACKAGES

FOLDERS = {name: ROOT / folder for name, folder in zip(NAMES, PACKAGES)}
MODULES = sorted((package, path) for package, folder in FOLDERS.items() for path in files_of(folder))
PARAMETERS = 8


@cache
def definitions(path: Path) -> tuple[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef, ...]:
    """The module, its classes and functions, at any depth: they stand among statements, never inside expressions."""
    found: list[ast.AST] = []
    left: list[ast.AST] = [tree(path)]
    while left:
        node = left.pop()
        found.append(node)
        for field in ("body", "orelse", "handlers", "finalbody", "cases"):
            inner = getattr(node, field, None)
            left.extend(inner if isinstance(inner, list) else [])
    return tuple(n for n in found if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)))


def identifier(case: tuple[str, Path]) -> str:
    return str(case[1].relative_to(FOLDERS[case[0]].parent))


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in definitions(path) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)))


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    """Names of a function's parameters but the object or class of a method."""
    of = function.args
    found = [*of.posonlyargs, *of.args, *of.kwonlyargs, *(rest for rest in (of.vararg, of.kwarg) if rest is not None)]
    return [one.arg for one in found if one.arg not in ("self", "cls")]


def test_modules_have_telling_names() -> None:
    telling_nothing = {"statistics", "utils", "core", "misc", "helpers", "common"}
    assert [identifier(case) for case in MODULES if case[1].stem in telling_nothing] == []


def classes(path: Path) -> Iterator[tuple[str, str]]:
    """Public classes that a module defines, with their places."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"{path.relative_to(ROOT)}:{node.lineno}"


def test_no_name_stands_for_two_classes() -> None:
    """Classes of the packages and of the launch file; only files that may hold one of a name twice are parsed."""
    product = [path for folder in (*LIBRARIES, "ros_ws/src") for path in files_of(ROOT / folder)]
    headed = {path: re.findall(r"^ *class ([A-Za-z]\w*)", path.read_text("utf-8"), re.MULTILINE) for path in product}
    counts = Counter(name for names in headed.values() for name in names)
    assert len(counts) > 300
    found: dict[str, list[str]] = {}
    for path, names in headed.items():
        if any(counts[name] > 1 for name in names):
            for name, place in classes(path):
                found.setdefault(name, []).append(place)
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_what_is_imported_at_every_start_is_small() -> None:
    """A runtime module or the command line needs no scipy, the table of a run nothing of it that is large."""
    import subprocess

    code = (
        "import sys, los_estimator.runtime, fsm_pma_controller.runtime, titop_plant.interface, los_testbed.cli.app\n"
        "import los_testbed.run.metadata as m, los_testbed.config.run_config as c\n"
        "m.run_metadata(m.RunParts(c.RunConfig()))\n"
        "large = ['control', 'matplotlib', 'scipy.stats', 'scipy.optimize', 'scipy.signal', 'scipy.interpolate']\n"
        "first = [m for m in ('scipy', *large) if m in sys.modules]\n"
        "import los_testbed.run.summary.summary; print(first, [m for m in large if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, cwd=ROOT)
    assert done.stdout.strip() == "[] []", done.stderr


def test_examples_have_a_section_of_their_own() -> None:
    """Without it the documentation site shows them as text, and a list in their output as a link."""
    found = [
        f"{identifier(case)}: {getattr(node, 'name', 'module')}"
        for case in MODULES
        if ">>>" in case[1].read_text("utf-8")
        for node in definitions(case[1])
        if ">>>" in (text := ast.get_docstring(node) or "") and "Examples\n--------" not in text
    ]
    assert found == []


def test_refused_input_has_the_exception_of_the_library() -> None:
    """Any other ValueError is a fault of the program; the trusted code imports nothing of the library."""
    parser = FOLDERS["pointing_analysis"] / "files" / "structured_text.py"  # what parsers raise is put into one line

    def raised(path: Path) -> Iterator[str]:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
                yield node.exc.func.id

    trusted = FOLDERS["lftkit"] / "proofs" / "trusted"
    own = [path for _, path in MODULES if path != parser and not path.is_relative_to(trusted)]
    named = [path for path in own if "raise ValueError" in path.read_text("utf-8")]  # in a docstring, most of them
    assert not [path for path in named if "ValueError" in raised(path)]


def test_functions_have_few_parameters() -> None:
    """But the commands and the functions of the api, which have one for each of their options."""
    commands = (
        FOLDERS["los_testbed"] / "cli",
        FOLDERS["los_testbed"] / "api",
        FOLDERS["pointing_analysis"] / "command" / "program.py",
    )
    many = [
        f"{identifier(case)}: {function.name} has {len(parameters(function))} parameters"
        for case in MODULES
        if not any(case[1].is_relative_to(place) for place in commands)
        for function in functions(case[1])
        if len(parameters(function)) > PARAMETERS
    ]
    assert many == []


def test_every_package_is_in_one_distribution() -> None:
    each = [project["tool"]["setuptools"]["packages"] for project in (PROJECT, LIBRARY, ANALYSIS)]
    for name, packages in (("lftkit", each[1]), ("pointing_analysis", each[2])):
        assert all(package.split(".")[0] == name for package in packages)
    listed = set().union(*each)
    assert len(listed) == sum(map(len, each))
    found = {
        ".".join([name, *path.parent.relative_to(folder).parts])
        for name, folder in FOLDERS.items()
        for path in files_of(folder, "__init__.py")
    }
    assert found == listed


def test_the_library_imports_its_dependencies_only() -> None:
    """Every import of lftkit, also inside functions: standard library, dependencies, optional ones in one module."""
    allowed = {"lftkit", "numpy", "scipy", "control", "threadpoolctl", *sys.stdlib_module_names}
    optional = {
        "lftkit/analysis/plots.py": {"matplotlib"},
        "lftkit/tuning/pictures/plots.py": {"matplotlib"},
        "lftkit/support/progress.py": {"rich"},
        "lftkit/benchmarks/norms.py": {"slycot"},
    }
    others = {}
    for path in files_of(FOLDERS["lftkit"]):
        nodes = list(ast.walk(tree(path)))
        names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
        name = path.relative_to(ROOT).as_posix()
        others[name] = {n.split(".")[0] for n in names} - allowed - optional.get(name, set())
    assert not {name: found for name, found in others.items() if found}


def test_pictures_of_the_documentation_are_small() -> None:
    for path in (ROOT / "docs").rglob("*.png"):
        assert path.stat().st_size < 150_000, path
