"""A process that waits for another one, in which code of the user runs."""

from __future__ import annotations

import os
import subprocess
import sys

CODE = """
import os, sys
from pathlib import Path
from los_testbed.run.supervision import supervise
from los_testbed.run.results import RunError
try:
    supervise(["plant my:Plant"], Path("none"))
except RunError as error:
    sys.exit(f"RunError: {error}")
if os.fork() == 0:  # a worker of the user's code, until the test has seen the end of the others
    os.closerange(0, 3)
    os.read(int(sys.argv[1]), 1)
    os._exit(0)
{end}
"""


def ended(end: str) -> tuple[int, str]:
    """Exit code, and what was said, of a run whose code of the user leaves a process behind, while that one lives."""
    reading, writing = os.pipe()
    try:
        command = [sys.executable, "-c", CODE.replace("{end}", end), str(reading)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, pass_fds=[reading])
    finally:
        os.close(writing)
        os.close(reading)
    return done.returncode, done.stderr


def test_a_process_that_is_left_behind_is_not_waited_for() -> None:
    code, said = ended("os._exit(0)")
    assert code == 1 and "ended in user code (exit code 0): plant my:Plant" in said


def test_nor_is_it_after_an_end_in_order() -> None:
    assert ended("sys.exit(7)")[0] == 7
