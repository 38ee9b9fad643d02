"""Variables of the environment that the command line reads or sets."""

from __future__ import annotations

QUIET, TRACEBACK = "LOS_TESTBED_QUIET", "LOS_TESTBED_TRACEBACK"
"""As ``--quiet``; unexpected errors with traceback."""
SUPERVISED = "LOS_TESTBED_SUPERVISED"
"""Set by the program: user code runs in a supervised process."""
