"""Processes of a program that a test has started, by a variable that it gave them."""

from __future__ import annotations

import contextlib
from pathlib import Path


def processes_with(variable: str, command: str = "") -> list[int]:
    """Numbers of the processes with ``NAME=VALUE`` in their environment and this in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError):
            number, marked = int(entry.name), variable.encode() in (entry / "environ").read_bytes().split(b"\0")
            if marked and command.encode() in (entry / "cmdline").read_bytes():
                found.append(number)
    return found
