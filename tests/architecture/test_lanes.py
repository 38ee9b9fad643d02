"""Tests beside each other: those of the nodes in one process, which has the processors first."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from support.lanes import GIVE_WAY, lane_of

TESTS = Path(__file__).parents[1]
CODE = """
import os, sys
from support.lanes import give_way
for nodeid in sys.argv[1:]:
    give_way(nodeid)
    print(os.getpriority(os.PRIO_PROCESS, 0))
"""


def test_tests_that_start_no_nodes_give_way() -> None:
    """The process that has the tests of the nodes has them first; a priority that is given up does not come back."""
    asked = ["tests/ros/test_a.py::test_1", "tests/ros/test_b.py::test_1", "tests/unit/test_c.py::test_1"]
    variables = {**os.environ, "PYTHONPATH": str(TESTS)}
    command = [sys.executable, "-c", CODE, *asked, "lftkit/system.py::lftkit.system"]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=120, check=True)
    start = os.getpriority(os.PRIO_PROCESS, 0)
    below = min(start + GIVE_WAY, 19)
    assert [int(line) for line in done.stdout.split()] == [start, start, below, below]


def test_all_tests_of_the_nodes_are_in_one_lane() -> None:
    files = [str(path.relative_to(TESTS.parent)) for path in TESTS.glob("*/**/test_*.py")]
    lanes = {lane_of(f"{file}::test") for file in files}
    assert len(lanes) == 1 + sum(not file.startswith("tests/ros/") for file in files)
