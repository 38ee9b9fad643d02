"""Table of the exit codes of the command line, as in docs/reference.md."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType


class ExitCode(IntEnum):
    """Exit code of a command."""

    FINISHED = 0
    FAILED = 1
    USER_ERROR = 2
    RESTARTED = 3
    MISSED_TICKS = 4
    CONTRADICTION = 5
    DEVICE = 6
    NOT_MET = 7
    NOT_DEMONSTRATED = 8
    INTERRUPTED = 130


MEANINGS: Mapping[ExitCode, str] = MappingProxyType(
    {
        ExitCode.FINISHED: "finished",
        ExitCode.FAILED: "the work failed",
        ExitCode.USER_ERROR: "user error, found before any work",
        ExitCode.RESTARTED: "finished, but a node died or did not answer, or a topic had a second publisher",
        ExitCode.MISSED_TICKS: "finished, but more ticks were missed than `--max-missed` permits",
        ExitCode.CONTRADICTION: "finished, but a bag contradicts its own digests",
        ExitCode.DEVICE: "a device failed or fell silent; the message says whether mirror and forces are at zero",
        ExitCode.NOT_MET: "a requirement is not met",
        ExitCode.NOT_DEMONSTRATED: "no requirement is violated, but one is not demonstrated",
        ExitCode.INTERRUPTED: "interrupted by SIGINT, SIGTERM or SIGHUP",
    }
)
"""Meaning of each code, as in the page."""

COMMANDS: Mapping[ExitCode, str] = MappingProxyType(
    {
        ExitCode.RESTARTED: "`run`",
        ExitCode.MISSED_TICKS: "`run`",
        ExitCode.DEVICE: "`run`, `device check`",
        ExitCode.NOT_MET: "`run`, `analyse`, `report`, `campaign`, `budget` with `--gate`; `design`",
        ExitCode.NOT_DEMONSTRATED: "`run`, `analyse`, `report`, `campaign` with `--gate`; `design`",
        ExitCode.CONTRADICTION: "`analyse`, `report`, `replay`, `bag`",
    }
)
"""Commands that end with a code, where not all do."""
