"""Tests in two processes: those of the nodes one after the other in one of them, all others beside them.

Runs in real time have the machine to themselves but for one other test. The tests of a file stay together: what a
module makes for all its tests is made once.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from xdist.scheduler import LoadFileScheduling

NODES = "tests/ros/"
"""Folder of the tests that start nodes."""


def lane_of(nodeid: str) -> str:
    """What is given to a process as a whole: all tests of the nodes, or one file.

    Examples
    --------
    >>> lane_of("tests/ros/test_control.py::test_changes"), lane_of("tests/unit/lftkit/test_system.py::test_gain[1]")
    ('tests/ros/', 'tests/unit/lftkit/test_system.py')
    """
    return NODES if nodeid.startswith(NODES) else nodeid.split("::", 1)[0]


class Lanes(LoadFileScheduling):
    """Hands out files, and the tests of the nodes as if they were one file."""

    def _split_scope(self, nodeid: str) -> str:
        return lane_of(nodeid)


def nodes_first(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Tests in the order in which they are handed out: those of the nodes take longest."""
    return sorted(items, key=lambda item: not item.nodeid.startswith(NODES))
