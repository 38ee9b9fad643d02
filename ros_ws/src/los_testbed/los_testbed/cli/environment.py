"""Variables of the environment that the command line reads or sets."""

from __future__ import annotations

QUIET, TRACEBACK = "LOS_TESTBED_QUIET", "LOS_TESTBED_TRACEBACK"
"""As ``--quiet``; unexpected errors with their place."""
SUPERVISED = "LOS_TESTBED_SUPERVISED"
"""Of a program: code of the user runs in a process of its own, and its end is watched."""
