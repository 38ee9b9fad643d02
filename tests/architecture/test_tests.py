"""Conventions of the tests: names, reasons to skip, no bound for a slow machine, tables of files that exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from support.anywhere import ANYWHERE
from support.further import FURTHER
from support.packages import ROOT, tree
from support.skip_remedies import REMEDIES, remedy

TESTS = ROOT / "tests"
CHOICES = {"keeps_pace", "judged", "judged_at_pace"}


def names_in(tree: ast.AST) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def test_no_bound_depends_on_the_speed_of_the_machine() -> None:
    """Neither ``0.2 if keeps_pace(run) else 1.0`` nor ``x < 0.2 or not keeps_pace(run)``: the part is judged or not."""
    texts = {path: path.read_text("utf-8") for path in sorted(TESTS.rglob("*.py"))}
    chosen = [
        f"{path.name}, line {node.lineno}"
        for path, text in texts.items()
        if any(choice in text for choice in CHOICES)
        for node in ast.walk(tree(path))
        if (isinstance(node, ast.IfExp) and names_in(node.test) & CHOICES)
        or (isinstance(node, ast.BoolOp) and names_in(node) & CHOICES)
    ]
    assert chosen == []


def test_test_modules_have_names_of_their_own() -> None:
    names = [path.name for path in TESTS.rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)


def skip_reasons(path: Path) -> Iterator[str]:
    """Reasons in calls of pytest.skip, skipif and importorskip; what is filled in at run time is left out."""
    if "skip" not in path.read_text("utf-8"):
        return
    for node in ast.walk(tree(path)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        given = {k.arg: k.value for k in node.keywords}
        if node.func.attr in ("skip", "skipif"):
            reason = given.get("reason", node.args[0] if node.args else None)
            parts = reason.values if isinstance(reason, ast.JoinedStr) else [reason]
            yield " ".join(str(p.value) for p in parts if isinstance(p, ast.Constant))
        elif node.func.attr == "importorskip" and "reason" not in given and isinstance(node.args[0], ast.Constant):
            yield f"could not import '{node.args[0].value!s}"


def test_every_reason_to_skip_has_a_remedy() -> None:
    assert not list(skip_reasons(Path(__file__)))
    files = [path for pattern in ("test_*.py", "conftest.py") for path in TESTS.rglob(pattern)]
    reasons = {reason for path in files for reason in skip_reasons(path)}
    assert len(reasons) > 5
    assert not [reason for reason in reasons if remedy(reason) is None]
    unused = [part for part in REMEDIES if not any(part in reason for reason in reasons)]
    assert set(unused) <= {"extra nastran", "could not import 'mcap_ros2", "could not import 'rosbags"}


def test_every_file_exists_and_so_does_what_looks_at_the_same() -> None:
    assert [name for name in FURTHER if not (TESTS / name).is_file()] == []
    named = [path for reason in FURTHER.values() for path in re.findall(r"\w+/[\w/*]+\.py", reason)]
    assert len(named) > 10 and [path for path in named if not list(TESTS.glob(path))] == []
    assert not set(named) & set(FURTHER), "what looks at the same is in make test"


def test_files_for_other_machines_exist() -> None:
    assert [name for name in ANYWHERE if not (TESTS / name).is_file()] == []
