"""No test has a bound of its own for a slow machine."""

from __future__ import annotations

import ast
from pathlib import Path

from support.packages import tree

ROOT = Path(__file__).parents[2]
CHOICES = {"keeps_pace", "judged", "judged_at_pace"}


def names_in(tree: ast.AST) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def test_no_bound_depends_on_the_speed_of_the_machine() -> None:
    """Neither ``0.2 if keeps_pace(run) else 1.0`` nor ``x < 0.2 or not keeps_pace(run)``: the part is judged or not."""
    texts = {path: path.read_text("utf-8") for path in sorted((ROOT / "tests").rglob("*.py"))}
    chosen = [
        f"{path.name}, line {node.lineno}"
        for path, text in texts.items()
        if any(choice in text for choice in CHOICES)
        for node in ast.walk(tree(path))
        if (isinstance(node, ast.IfExp) and names_in(node.test) & CHOICES)
        or (isinstance(node, ast.BoolOp) and names_in(node) & CHOICES)
    ]
    assert chosen == []
