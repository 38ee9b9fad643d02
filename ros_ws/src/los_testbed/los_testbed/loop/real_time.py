"""Timing of the loop: real-time privileges of the process, and a clock with absolute deadlines."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import signal
import time

PRIORITIES = {"plant": 80, "estimator": 70, "controller": 60, "recorder": 1}
"""SCHED_FIFO priority per node: the plant owns time, the recorder only has to keep up on average."""

PLACES = {"plant": 0, "estimator": 1, "controller": 0, "recorder": 1}
"""Where a node runs: the n-th processor it may use. Neighbours in the chain of a tick sit on different
processors, so that one wakes up while the other still publishes; a thread that stays keeps its cache."""

SPIN_NS = 60_000
"""The last stretch before a deadline is spent polling the clock: a sleeping thread wakes up this late."""

_RESENDING = "dds.asyn"
"""Name of the thread of Fast DDS that sends again what a reliable reader misses.

It polls for a lock until it gets it. At the priority of the thread that holds the lock, on the same processor, it
would poll for ever: so it stays one below.
"""

RUNAWAY_S = 1.0
"""A real-time thread that computes this long without a pause is out of control, and nobody of lower priority could
end it: the kernel ends its process (SIGXCPU)."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29


def sharpen_timers() -> None:
    """Let sleeps of this process end within 1 ns instead of 50 us; to be called before threads start."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def end_with_parent() -> None:
    """Let the kernel send SIGTERM to this process when the one that started it is gone."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def keep_awake() -> bool:
    """Ask the kernel for processors that do not go to sleep while this process lives; whether it was granted.

    A sleeping processor of a virtual machine takes tens of microseconds to come back.
    """
    try:
        _awake.append(os.open("/dev/cpu_dma_latency", os.O_WRONLY))
        os.write(_awake[-1], bytes(4))  # 0 us; the kernel forgets it when the file is closed
    except OSError:
        return False
    return True


_awake: list[int] = []


def become_real_time(priority: int, place: int | None = None) -> list[str]:
    """Give all threads SCHED_FIFO and a processor, lock the memory, switch the collector off.

    Called when everything is built. Threads of the middleware exist by then, so each is raised by its
    number; later ones inherit.

    Parameters
    ----------
    priority : int
        SCHED_FIFO priority, 1 to 99.
    place : int, optional
        Run on the `place`-th processor this process may use, modulo their number; None: on any.

    Returns
    -------
    list of str
        What was not permitted; empty if all of it was.
    """
    refused = []
    gc.collect()
    gc.freeze()
    gc.disable()
    limit = int(RUNAWAY_S * 1e6)
    resource.setrlimit(resource.RLIMIT_RTTIME, (limit, 2 * limit))
    try:
        processors = sorted(os.sched_getaffinity(0))
        for thread in os.listdir("/proc/self/task"):
            with open(f"/proc/self/task/{thread}/comm") as name:
                level = priority - name.read().startswith(_RESENDING)
            os.sched_setscheduler(int(thread), os.SCHED_FIFO if level else os.SCHED_OTHER, os.sched_param(level))
            if place is not None:
                os.sched_setaffinity(int(thread), {processors[place % len(processors)]})
    except (OSError, AttributeError):
        refused.append("real-time scheduling")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        refused.append("locked memory")
    return refused


class TickClock:
    """Absolute deadlines on the steady clock, one per period.

    An overrun of a whole period or more is never caught up by hurrying: the schedule moves on by the
    periods that were lost, and they are counted.

    Parameters
    ----------
    period_ns : int
        Period [ns].

    Examples
    --------
    >>> clock = TickClock(1_000_000)
    >>> clock.begin(time.monotonic_ns())
    >>> for _ in range(3):
    ...     late = clock.wait()
    >>> clock.skipped < 100
    True
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.skipped = 0
        self._deadline = 0

    def begin(self, deadline_ns: int) -> None:
        """Set the first deadline (steady clock [ns])."""
        self._deadline = deadline_ns

    @property
    def slack_ns(self) -> int:
        """Time until the next deadline [ns]."""
        return self._deadline - time.monotonic_ns()

    def wait(self) -> int:
        """Return at the next deadline, with the lateness [ns]."""
        deadline = self._deadline
        now = time.monotonic_ns()
        rest = deadline - now - SPIN_NS
        if rest > 0:
            time.sleep(rest * 1e-9)
            now = time.monotonic_ns()
        while now < deadline:
            now = time.monotonic_ns()
        late = now - deadline
        if late >= self.period_ns:
            lost = late // self.period_ns
            self.skipped += lost
            deadline += lost * self.period_ns
        self._deadline = deadline + self.period_ns
        return late
