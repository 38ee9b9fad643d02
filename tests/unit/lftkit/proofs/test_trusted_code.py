"""What has to be trusted of the check of sampled loops: its files and lines, as docs/certificates.md states them."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
PACKAGES = (
    "lftkit",
    "los_design",
    "los_loop",
    "titop_plant",
    "los_estimator",
    "fsm_pma_controller",
    "pointing_analysis",
)
CHECKER = "lftkit.proofs.trusted.checker"


def file_of(module: str) -> Path:
    path = ROOT / Path(*module.split("."))
    return path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"


def is_for_types(node: ast.AST) -> bool:
    """Whether a statement is run by a checker of types alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def imported_by(start: str, packages: tuple[str, ...] = PACKAGES) -> set[Path]:
    """A module, and the modules of this repository that it imports when it runs, one by one from others."""
    waiting, found = [start], dict[str, Path]()
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        if module.split(".")[0] not in packages or not file_of(module).exists():
            continue
        found[module] = file_of(module)
        tree = ast.parse(found[module].read_text("utf-8"))
        types = {id(node) for part in ast.walk(tree) if is_for_types(part) for node in ast.walk(part)}
        nodes = [node for node in ast.walk(tree) if id(node) not in types]
        imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
        waiting += [str(node.module) for node in imports]
        waiting += [f"{node.module}.{name.name}" for node in imports for name in node.names]
        waiting += [name.name for node in nodes if isinstance(node, ast.Import) for name in node.names]
    return {path for path in found.values() if path.read_text("utf-8").strip()}


def code_lines(path: Path) -> int:
    """Lines that are neither empty nor comments nor docstrings."""
    text = path.read_text("utf-8")
    lines = {n for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.strip().startswith("#")}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def lines(paths: set[Path]) -> int:
    return sum(len(path.read_text("utf-8").splitlines()) for path in paths)


def stated(pattern: str) -> list[int]:
    page = (ROOT / "docs" / "certificates.md").read_text("utf-8")
    found = re.search(pattern, " ".join(page.split()))
    assert found is not None, pattern
    return [int(number) for number in found.groups()]


def test_the_page_states_how_much_code_is_trusted() -> None:
    files = imported_by(CHECKER)
    found = [len(files), lines(files), sum(map(code_lines, files))]
    assert found == stated(
        r"What is trusted is the package `lftkit/proofs/trusted`: (\d+) files, (\d+) lines, (\d+) of"
    )


def test_the_page_states_what_makes_the_model() -> None:
    """To a tenth: it is the program itself, and changes with it."""
    files = imported_by("los_design.verification.loop_models")
    assert [len(files), lines(files)] == pytest.approx(
        stated(r"some (\d+) files with (\d+) lines make the model"), rel=0.1
    )


def test_the_checker_imports_only_its_own_package() -> None:
    assert {path.parent for path in imported_by(CHECKER)} == {ROOT / "lftkit" / "proofs" / "trusted"}


def test_what_runs_is_what_is_counted() -> None:
    """Modules of this repository that a process has loaded when it can check, but for those of packages' names."""
    code = f"import sys, {CHECKER}; print(*(m for m in sys.modules if m.split('.')[0] in {PACKAGES}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    allowed = {path.resolve() for path in imported_by(CHECKER)} | {file_of("lftkit.support.on_demand").resolve()}
    assert {f for m in loaded if (f := file_of(m).resolve()) not in allowed and f.name != "__init__.py"} == set()
