"""Supervision of a program in which user code can end the process with any exit code, or by a signal."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from los_testbed.run.bag_names import recorded
from los_testbed.run.loop.scheduling import end_with_parent
from los_testbed.run.results import RunError

FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def supervise(names: Sequence[str], bag: Path) -> None:
    """Continue in a child process; this one waits, and ends with its exit code if it ended in order.

    A process that user code ends (``os._exit``, a fault in a compiled module) leaves its bag unfinished without a
    message: exit code 0 would indicate a complete run. Returns in the child only.

    Parameters
    ----------
    names : sequence of str
        User code of the run, for the message.
    bag : Path
        Folder of the bag.

    Raises
    ------
    RunError
        In the parent: the child ended, but not in order.
    """
    reading, writing = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if not child:
        os.close(reading)
        os.setpgid(0, 0)  # signals of the terminal come once, from the parent
        end_with_parent(parent)
        atexit.register(os.write, writing, b"1")
        return
    os.close(writing)

    def forward(number: int, frame: Any) -> None:
        os.kill(child, number)  # it exists until it is waited for

    for number in FORWARDED:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, forward)
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
    for number in FORWARDED:
        signal.signal(number, signal.SIG_IGN)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.set_blocking(reading, False)  # a process left by user code may still have the other end
    with contextlib.suppress(BlockingIOError):
        if os.read(reading, 1):
            raise SystemExit(code)
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    raise RunError(f"the process of the run ended in user code ({how}): {', '.join(names)}{recorded(bag)}")
