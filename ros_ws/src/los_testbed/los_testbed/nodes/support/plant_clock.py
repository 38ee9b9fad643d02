"""The plant's clock as a node sees it."""

from __future__ import annotations

from los_testbed.run.loop.stamp_synchronizer import HORIZON_NS, NOT_KNOWN

AGREED = 20
"""Consecutive early samples, each later than the one before, that set the clock."""


class PlantClock:
    """Offset of the plant's stamps from the steady clock of this machine, from the least delayed sample.

    After a stall old samples come first, and must not make the newer ones appear early; so the clock is never set back.
    Nor may one wrong stamp far ahead set it forward: all correct ones after it would be late. But if the samples that
    set it were late themselves, every later one appears early. Those agree with each other, and set it again.

    Examples
    --------
    The first sample was 0.4 s late; those that follow are in time:

    >>> clock = PlantClock()
    >>> clock.note(5_000_000, 405_000_000)
    >>> for tick in range(406, 426):
    ...     clock.note(tick * 1_000_000, tick * 1_000_000)
    >>> clock.now(426_000_000) // 1_000_000
    426
    """

    def __init__(self) -> None:
        self._lead: int | None = None
        self._early: list[int] = []
        self._last_early = 0

    def note(self, stamp: int, now_ns: int) -> None:
        """Note a sample of the plant.

        Parameters
        ----------
        stamp : int
            Its stamp [ns].
        now_ns : int
            Steady clock when it was taken [ns].
        """
        lead = stamp - now_ns
        if self._lead is None:
            self._lead = lead
        elif lead <= self._lead + HORIZON_NS:
            self._lead = max(self._lead, lead)
            self._early.clear()
        elif not self._early or stamp > self._last_early:
            self._early.append(lead)
            self._last_early = stamp
            if len(self._early) == AGREED:
                self._lead = min(self._early)
                self._early.clear()

    def now(self, now_ns: int) -> int:
        """The plant's time [ns] at a time of the steady clock [ns]; NOT_KNOWN before the first sample."""
        return NOT_KNOWN if self._lead is None else now_ns + self._lead
