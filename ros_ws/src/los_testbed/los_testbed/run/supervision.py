"""A program whose own end is not trusted: code of the user in it can end it with any exit code, or by a signal."""

from __future__ import annotations

import atexit
import os
import signal
from typing import Any

from los_testbed.config import RunConfig, is_code
from los_testbed.loop.scheduling import end_with_parent
from los_testbed.run.bag_names import recorded
from los_testbed.run.results import RunError

FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def code_of_user(config: RunConfig) -> list[str]:
    """Settings of a run that name code of the user, with their values."""
    found = {"plant": config.plant, "disturbance": config.disturbance_source if config.disturbance else ""}
    found |= {name: str(value) for name in ("k_fsm", "k_pma") if is_code(str((value := getattr(config, name)) or ""))}
    return [f"{name} {value}" for name, value in found.items() if value]


def supervise(config: RunConfig) -> None:
    """Go on in a child process; this one waits, and ends as it does if that was in order.

    A process that code of the user ends (``os._exit``, a fault in a compiled module) leaves its bag unfinished and can
    say nothing: exit code 0 would be taken for a whole run. Returns in the child only.

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
    if os.read(reading, 1):
        raise SystemExit(code)
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    names = ", ".join(code_of_user(config))
    raise RunError(f"the process of the run ended in code of the user ({how}): {names}{recorded(config.bag)}")
