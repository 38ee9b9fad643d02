"""lftkit is a library of its own: its tests need no other package, its text names none of their subjects."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from support.packages import files_of, tree

TESTS = Path(__file__).parents[1]
OTHERS = {path.parent.name for path in TESTS.parent.glob("*/__init__.py")} - {"lftkit"} | {
    "los_testbed",
    "rclpy",
    "mcap",
}
"""Packages beside it."""

WORDS = {*OTHERS - {"rclpy", "mcap"}, "los", "fsm", "pma", "k_fsm", "k_pma"}
SUBJECTS = re.compile(rf"telescope|mirror|spacecraft|testbed|\b({'|'.join(sorted(WORDS))})\b", re.IGNORECASE)
"""What the packages beside it are about."""


def imported(path: Path) -> set[str]:
    """Modules that a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"support.{name.name}" for name in node.names if node.module == "support"}
    return found


def test_no_test_of_lftkit_imports_another_package() -> None:
    waiting = list((TESTS / "unit" / "lftkit").rglob("*.py"))
    seen: set[Path] = set()
    wrong = []
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for module in imported(path):
            if module.split(".")[0] in OTHERS:
                wrong.append(f"{path.relative_to(TESTS)}: {module}")
            helper = TESTS / Path(*module.split(".")).with_suffix(".py")
            if module.startswith("support.") and helper.exists():
                waiting.append(helper)
    assert len(seen) > 50 and "los_design" in OTHERS
    assert not wrong


def test_no_test_of_lftkit_reads_what_is_not_a_test() -> None:
    """A path upwards from a test ends at the folder of tests, at most."""
    for path in (TESTS / "unit" / "lftkit").rglob("*.py"):
        depth = len(path.relative_to(TESTS).parts) - 1
        for levels in re.findall(r"parents\[(\d+)\]", path.read_text("utf-8")):
            assert int(levels) <= depth, path


def test_the_library_names_no_subject_of_another_package() -> None:
    """Code, messages, docstrings, formats and the README."""
    folder = TESTS.parent / "lftkit"
    texts = [*files_of(folder), *folder.glob("*.md"), folder / "pyproject.toml"]
    named = [
        f"{path.relative_to(folder).as_posix()}:{number}: {line.strip()}"
        for path in texts
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if SUBJECTS.search(line)
    ]
    assert len(texts) > 150
    assert not named
