"""Tests in several processes: those of the nodes one after the other in one of them, all others beside them.

Runs in real time have the processors when they want them: all other tests have a lower priority. A loop in real time
waits most of its time, so that there are more processes of tests than processors. The tests of a file stay together:
what a module makes for all its tests is made once.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import pytest
from xdist.scheduler import LoadFileScheduling

NODES = "tests/ros/"
"""Folder of the tests that start nodes."""
RULES = "tests/architecture/"
"""Folder of the tests that read the whole code: its files are parsed once for all of them."""
GIVE_WAY = 3
"""Niceness of the other tests above that of `make`: half of the share of a node that is ready at the same time, or of
another program: where others have the processors, too, the tests go on."""
_START = os.getpriority(os.PRIO_PROCESS, 0)


def lane_of(nodeid: str) -> str:
    """What is given to a process as a whole: all tests of the nodes, those of the rules of the code, or one file.

    Examples
    --------
    >>> lane_of("tests/ros/test_control.py::test_changes"), lane_of("tests/unit/lftkit/test_system.py::test_gain[1]")
    ('tests/ros/', 'tests/unit/lftkit/test_system.py')
    """
    return next((folder for folder in (NODES, RULES) if nodeid.startswith(folder)), nodeid.split("::", 1)[0])


class Lanes(LoadFileScheduling):
    """Hands out files, and the tests of the nodes and of the rules as if they were one file each."""

    def _split_scope(self, nodeid: str) -> str:
        return lane_of(nodeid)


def give_way(nodeid: str) -> None:
    """Lower the priority of this process and those that it starts, but for a test of the nodes.

    A priority is never raised again; the process that has the tests of the nodes has them first.
    """
    if lane_of(nodeid) != NODES and os.getpriority(os.PRIO_PROCESS, 0) < _START + GIVE_WAY:
        os.setpriority(os.PRIO_PROCESS, 0, _START + GIVE_WAY)


def nodes_first(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Tests in the order in which they are handed out: those of the nodes take longest."""
    return sorted(items, key=lambda item: not item.nodeid.startswith(NODES))
