"""The files that have to be trusted of the checks of proofs, and their lines."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

CHECKERS = tuple(
    f"lftkit.proofs.trusted.{name}" for name in ("axis", "cells", "lower_bound", "noise", "sampled_loop", "structured")
)
"""The checks of all kinds."""


def file_of(module: str) -> Path:
    """Source of a module, wherever it is installed; no file where the name is that of no module."""
    try:
        found = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        found = None
    return Path(found.origin if found is not None and found.origin else module)


def is_for_types(node: ast.AST) -> bool:
    """Whether a statement is run by a checker of types alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def imported_by(*start: str, packages: tuple[str, ...] = ("lftkit",)) -> set[Path]:
    """Some modules, and the modules of these packages that they import when they run, one by one from others."""
    waiting, found = [*start], dict[str, Path]()
    while waiting:
        module = waiting.pop()
        if module in found or module.split(".")[0] not in packages or not file_of(module).exists():
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
    numbers = {n for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.strip().startswith("#")}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            numbers -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(numbers)


def lines(paths: set[Path]) -> int:
    """Lines of files, all of them counted."""
    return sum(len(path.read_text("utf-8").splitlines()) for path in paths)
