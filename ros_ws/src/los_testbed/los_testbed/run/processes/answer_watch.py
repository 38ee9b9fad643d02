"""Watchdog of the nodes of a run: whether each of them responds, and whether ticks are done."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

TOLD_S = 5.0
"""Silence of a node, or time without a tick, before a warning."""

LOOK_S = 1.0
"""Longest interval of calls that counts: after a longer one this program itself was stalled."""

LATER_S = 2.0
"""Extra delay of the warning about ticks: the silence of a node that stops them is reported first."""

TICKS = "ticks"
"""Name of the ticks, which are watched besides the nodes."""


class AnswerWatch:
    """Silence of the nodes, from their heartbeats about once a second.

    Parameters
    ----------
    clock : callable
        Monotonic clock [s].

    Examples
    --------
    >>> watch = AnswerWatch(iter([0.0, 0.0, 0.0, 9.0, 9.0]).__next__)
    >>> watch.heard("estimator")
    ''
    >>> watch.look(), watch.look()  # of the 9 s in which this program did not run one counts
    ([], [])
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._heard: dict[str, float] = {}
        self._told: set[str] = set()
        self._waits_for: tuple[str, ...] = ()
        self._looked: float | None = None

    def heard(self, name: str) -> str:
        """An event of a node, or a tick; a line if its silence was reported before."""
        now = self._clock()
        silence = now - self._heard.get(name, now)
        self._heard[name] = now
        if name not in self._told:
            return ""
        self._told.discard(name)
        if name == TICKS:
            return f"the ticks continue after {silence:.0f} s"
        return f"{name} responds again after {silence:.0f} s"

    def knows(self, name: str) -> bool:
        """Whether it is watched."""
        return name in self._heard

    def forget(self, name: str) -> None:
        """A node has ended, or ticks are not expected."""
        self._heard.pop(name, None)
        self._told.discard(name)
        if name == TICKS:
            self._waits_for = ()

    def waits_for(self, topics: Collection[str]) -> None:
        """Topics that the plant waits for before the next tick; empty while ticks are done."""
        self._waits_for = tuple(topics)

    def look(self) -> list[str]:
        """Lines about silences that are not yet reported; call it at least once a second."""
        now = self._clock()
        if self._looked is not None and (missed := now - self._looked - LOOK_S) > 0:
            self._heard = {name: heard + missed for name, heard in self._heard.items()}
        self._looked = now
        news = [name for name in self.silent() if name not in self._told]
        self._told.update(news)
        return [self._line(name, now) for name in news]

    def silent(self, limit: float = TOLD_S) -> list[str]:
        """Nodes that are silent for longer than this [s]; :data:`TICKS` where all answer and no tick is done."""
        now = self._clock()
        nodes = [name for name, heard in self._heard.items() if name != TICKS and now - heard > limit]
        if nodes or now - self._heard.get(TICKS, now) <= limit + LATER_S:
            return nodes
        return [TICKS]

    def in_words(self, names: Collection[str]) -> str:
        """Message about a run that is ended because of these."""
        now = self._clock()
        return ", ".join(self._line(name, now) for name in names)

    def _line(self, name: str, now: float) -> str:
        silence = now - self._heard[name]
        if name == TICKS:
            missing = f": no message on {', '.join(self._waits_for)}" if self._waits_for else ""
            return f"no tick for {silence:.0f} s{missing}"
        return f"{name} has not responded for {silence:.0f} s"
