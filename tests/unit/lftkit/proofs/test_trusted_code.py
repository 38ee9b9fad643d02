"""What has to be trusted of the check of sampled loops: its files and lines, as docs/certificates.md states them."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[4]
CHECKER = "lftkit.proofs.sampled_loop.checker"


def file_of(module: str) -> Path:
    path = ROOT / Path(*module.split("."))
    return path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"


def is_for_types(node: ast.AST) -> bool:
    """Whether a statement is run by a checker of types alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def trusted() -> set[Path]:
    """The checker, and the modules of this repository that it imports when it runs, one by one from others."""
    waiting, found = [CHECKER], dict[str, Path]()
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        found[module] = file_of(module)
        tree = ast.parse(found[module].read_text("utf-8"))
        types = {id(node) for part in ast.walk(tree) if is_for_types(part) for node in ast.walk(part)}
        nodes = [node for node in ast.walk(tree) if id(node) not in types]
        imported = [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
        waiting += [name for name in imported if name.startswith("lftkit")]
    return set(found.values())


def code_lines(path: Path) -> int:
    """Lines that are neither empty nor comments nor docstrings."""
    text = path.read_text("utf-8")
    lines = {n for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.strip().startswith("#")}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def test_the_page_states_how_much_code_is_trusted() -> None:
    page = (ROOT / "docs" / "certificates.md").read_text("utf-8")
    stated = re.search(r"What is trusted: (\d+) lines in ten files.*?; (\d+) of them are code", page, re.DOTALL)
    files = trusted()
    assert stated is not None and len(files) == 10
    assert int(stated[1]) == sum(len(path.read_text("utf-8").splitlines()) for path in files)
    assert int(stated[2]) == sum(map(code_lines, files))


def test_what_runs_is_what_is_counted() -> None:
    """Modules of this repository that a process has loaded when it can check, but for empty ones of packages."""
    code = f"import sys, {CHECKER}; print(*(m for m in sys.modules if m.startswith('lftkit.')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    allowed = {path.resolve() for path in trusted()} | {file_of("lftkit.support.on_demand").resolve()}
    assert {f for m in loaded if (f := file_of(m).resolve()) not in allowed and f.name != "__init__.py"} == set()


def test_the_checker_imports_nothing_that_finds_or_reads_proofs() -> None:
    names = {path.stem for path in trusted()}
    assert not names & {"files", "strip_files", "bounds", "scalings", "branching", "build", "barrier", "noise"}
