"""What a test cannot judge on a slow machine is counted, and no test has a bound of its own for such a machine."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.packages import tree
from support.unjudged import REMEDIES, UnjudgedWarning, judged

ROOT = Path(__file__).parents[2]
CHOICES = {"keeps_pace", "judged", "judged_at_pace"}

SLOW_MACHINE = """
import pytest
from support.unjudged import judged

@pytest.fixture(scope="module")
def run():
    judged(False, "the share of samples", "samples were lost")

@pytest.mark.parametrize("possible", [True, False])
def test_a_part(run, possible):
    if judged(possible, "the order", "the loop does not keep pace"):
        assert possible
"""


def test_what_was_not_judged_is_counted_at_the_end_of_a_run(tmp_path: Path) -> None:
    """Also where the tests run in processes of their own."""
    (tmp_path / "test_slow_machine.py").write_text(SLOW_MACHINE)
    told = tmp_path / "told.txt"
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    variables = {**own, "PYTHONPATH": str(ROOT / "tests"), "SKIPPED_TESTS_FILE": str(told)}
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), "-q"]
    command += ["-p", "conftest", "-p", "no:cacheprovider", "-n", "1", str(tmp_path)]
    done = subprocess.run(command, env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout
    lines = told.read_text().splitlines()
    assert [line.split(" -> ")[0] for line in lines] == [
        "1 x not judged, samples were lost: the share of samples",
        "1 x not judged, the loop does not keep pace: the order",
    ]
    assert all(line in done.stdout for line in lines)


def test_what_can_be_judged_is_judged_without_a_word(recwarn: pytest.WarningsRecorder) -> None:
    assert judged(True, "the order", "samples were lost")
    assert not recwarn.list
    with pytest.warns(UnjudgedWarning, match="^samples were lost: the order$"):
        assert not judged(False, "the order", "samples were lost")
    with pytest.raises(ValueError, match=f"reason must be one of {next(iter(REMEDIES))}"):
        judged(False, "the order", "bad luck")


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
