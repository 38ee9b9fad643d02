"""Watch over the nodes of a run: whether each of them answers, and whether the ticks go on."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

TOLD_S = 5.0
"""So long a node may be silent, or no tick be done, before a line says so."""

LOOK_S = 1.0
"""A program that has not looked for longer than this has not run itself: that time counts for nobody."""

LATER_S = 2.0
"""Ticks that stand still because of a node are noticed so much later than its silence, which says more."""

TICKS = "ticks"
"""What is watched beside the nodes."""


class AnswerWatch:
    """Who has been silent for how long, by what the nodes tell about once a second.

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
        """A node has told something, or a tick was done; a line where its silence was told before."""
        now = self._clock()
        silence = now - self._heard.get(name, now)
        self._heard[name] = now
        if name not in self._told:
            return ""
        self._told.discard(name)
        if name == TICKS:
            return f"the ticks go on after {silence:.0f} s"
        return f"{name} answers again after {silence:.0f} s"

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
        """What the plant says it waits for before the next tick; nothing where ticks are done."""
        self._waits_for = tuple(topics)

    def look(self) -> list[str]:
        """Lines about those whose silence is not told yet; to be called at least once a second."""
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
        """What is said of a run that is ended because of these."""
        now = self._clock()
        return ", ".join(self._line(name, now) for name in names)

    def _line(self, name: str, now: float) -> str:
        silence = now - self._heard[name]
        if name == TICKS:
            missing = f": nothing has come on {', '.join(self._waits_for)}" if self._waits_for else ""
            return f"no tick for {silence:.0f} s{missing}"
        return f"{name} has not answered for {silence:.0f} s"
