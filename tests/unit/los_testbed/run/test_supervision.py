"""A process that waits for another one, in which code of the user runs."""

from __future__ import annotations

import subprocess
import sys
import time

CODE = """
import os, sys, time
from pathlib import Path
from los_testbed.run.supervision import supervise
from los_testbed.run.results import RunError
try:
    supervise(["plant my:Plant"], Path("none"))
except RunError as error:
    sys.exit(f"RunError: {error}")
if os.fork() == 0:  # a worker of the user's code
    os.closerange(0, 3)
    time.sleep(60)
    os._exit(0)
{end}
"""


def ended(end: str) -> tuple[int, str, float]:
    """Exit code, what was said, and how long it took [s], of a run whose code of the user leaves a process behind."""
    before = time.monotonic()
    done = subprocess.run([sys.executable, "-c", CODE.replace("{end}", end)], capture_output=True, text=True)
    return done.returncode, done.stderr, time.monotonic() - before


def test_a_process_that_is_left_behind_is_not_waited_for() -> None:
    code, said, spent = ended("os._exit(0)")
    assert code == 1 and "ended in user code (exit code 0): plant my:Plant" in said
    assert spent < 50.0


def test_nor_is_it_after_an_end_in_order() -> None:
    code, _, spent = ended("sys.exit(7)")
    assert code == 7 and spent < 50.0
