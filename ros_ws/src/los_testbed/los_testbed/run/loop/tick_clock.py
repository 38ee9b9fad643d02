"""Clock of the loop: absolute deadlines, one per period."""

from __future__ import annotations

import time

from los_testbed.run.loop.scheduling import Pauses

SPIN_NS = 60_000
"""Last part of a wait [ns] that is spent polling the clock: a sleeping thread wakes up this late."""


def wait_until(deadline_ns: int) -> int:
    """Return at the deadline (steady clock [ns]), with the lateness [ns]."""
    now = time.monotonic_ns()
    rest = deadline_ns - now - SPIN_NS
    if rest > 0:
        time.sleep(rest * 1e-9)
        now = time.monotonic_ns()
    while now < deadline_ns:
        now = time.monotonic_ns()
    return now - deadline_ns


class TickClock:
    """Absolute deadlines on the steady clock, one per period.

    The deadlines are on a grid that is fixed by the first one. After an overrun of a period or more the next deadline
    is the next one of the grid; the whole periods that were lost are counted, and no later period is shortened.

    Parameters
    ----------
    period_ns : int
        Period [ns].

    Examples
    --------
    >>> clock = TickClock(1_000_000)
    >>> clock.begin(time.monotonic_ns())
    >>> clock.wait() >= 0
    True
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.skipped = 0
        self.pauses = Pauses()
        self._first = self._deadline = 0

    def begin(self, deadline_ns: int) -> None:
        """Set the first deadline (steady clock [ns])."""
        self._first = self._deadline = deadline_ns

    def sleep(self, lead_ns: int) -> None:
        """Return `lead_ns` before the next deadline, or as much later as a sleeping thread wakes up."""
        rest = self._deadline - time.monotonic_ns() - lead_ns
        if rest > 0:
            time.sleep(rest * 1e-9)

    def wait(self) -> int:
        """Return at the next deadline, with the lateness [ns]."""
        self.pauses.take()  # a loop that is always late would never block
        late = wait_until(self._deadline)
        lost = late // self.period_ns
        self.skipped += lost
        self._deadline += (1 + lost) * self.period_ns
        return late

    @property
    def first(self) -> int:
        """First deadline (steady clock [ns])."""
        return self._first

    def present(self) -> int:
        """Number of the period that is now; the first deadline begins period 0."""
        return (time.monotonic_ns() - self._first) // self.period_ns

    def resume_at(self, number: int) -> None:
        """Wait for the deadline of this period next; those before it are given up and counted."""
        deadline = self._first + number * self.period_ns
        self.skipped += (deadline - self._deadline) // self.period_ns
        self._deadline = deadline
