"""Samples of a sensor that is slower than the loop, used when they come, with their age.

No tick waits for such a sensor. A frame of a past tick is *old*: its treatment is configurable, and each kind of
irregular frame is counted under its name.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.counted_nouns import counted
from los_testbed.config.run_config import OLD_FRAMES
from titop_plant.interface import TICK_NS

CORRECT, _, DROP = OLD_FRAMES

NAMES = ("absent", "late", "early", "off_phase", "out_of_order")
"""Irregular frames: absent; later than the latency; with a future stamp; off the frame grid; out of order."""

AGREED = 5
"""Consecutive frames off the grid, consistent with each other, that define a new grid: the trigger was moved, or the
first frame was off the grid."""

MAX_AHEAD = 64
"""Frames buffered for their ticks: after a stall all its frames may arrive before the other samples."""

BEGINNING = "frames_"
"""Of the names of the counts in the statistics of a node."""


@dataclass
class SlowSensor:
    """Frames of one sensor: the newest one that waits for the next tick, and the counts.

    Parameters
    ----------
    name : str
        Topic.
    columns : slice
        Of its values in the vector of a tick.
    period_ns : int
        Time from one frame to the next [ns].
    latency_ns : int
        Age [ns] up to which a frame is not late.
    old : str
        One of :data:`~los_testbed.config.run_config.OLD_FRAMES`.
    gauge : slice, optional
        Columns of the mirror's angle, for an angle that the mirror changes; None for others.
    per_mirror : float
        Angle of the sensor per angle of the mirror.

    Examples
    --------
    A frame of tick 20 that comes after tick 26, while the mirror has moved by 1e-6 rad:

    >>> sensor = SlowSensor("camera/los", slice(0, 1), 20 * TICK_NS, gauge=slice(1, 2), per_mirror=0.1)
    >>> sensor.offer(20 * TICK_NS, np.array([5e-6]), last=26 * TICK_NS)
    >>> row, rows = np.array([np.nan, 3e-6]), {20 * TICK_NS: np.array([4e-6, 2e-6])}
    >>> sensor.place(row, 27 * TICK_NS, rows.get)
    >>> float(row[0].round(9)), sensor.counts["late"], sensor.statistics()["frames_camera/los_age_max_ms"]
    (5.1e-06, 1, '7')
    """

    name: str
    columns: slice
    period_ns: int
    latency_ns: int = 0
    old: str = CORRECT
    gauge: slice | None = None
    per_mirror: float = 0.0
    counts: Counter[str] = field(default_factory=Counter)
    waiting: int = -1
    _values: FloatArray = field(default_factory=lambda: np.zeros(0))
    _phase: int | None = None
    _other_phase: int = 0
    _agreed: int = 0
    _ahead: deque[tuple[int, FloatArray]] = field(default_factory=lambda: deque(maxlen=MAX_AHEAD))
    _newest: int = -1
    _ages: list[int] = field(default_factory=lambda: [0, 0, 0])
    _due: int = 0
    _last_tick: int = 0
    _silent_max: int = 0

    def note(self, stamp: int, tick: int, now: int, horizon: int) -> bool:
        """Count a frame that came; whether it may be used.

        Parameters
        ----------
        stamp, tick : time of acquisition as it was sent, and its tick [ns]
        now : time of the plant, as well as it is known here [ns]
        horizon : largest stamp that may come [ns]; a newest frame beyond it was none
        """
        if self._newest > horizon:
            self._newest = -1
            self._ahead = deque((one for one in self._ahead if one[0] <= horizon), MAX_AHEAD)
        if tick <= self._newest:
            self.counts["out_of_order"] += 1
            return False
        if self._newest >= 0:
            self._silent_max = max(self._silent_max, tick - self._newest)
        self._newest = tick
        self.counts["came"] += 1
        self._compare_phase(stamp)
        self.counts["early"] += tick > now + TICK_NS
        return True

    def _compare_phase(self, stamp: int) -> None:
        """Count a frame off the grid."""
        if self._phase is None:
            self._phase = stamp % self.period_ns
        off = self._from(self._phase, stamp)
        if abs(off) <= TICK_NS // 2:  # drift of a free-running clock
            self._phase += off
            self._agreed = 0
            return
        self.counts["off_phase"] += 1
        agrees = abs(self._from(self._other_phase, stamp)) <= TICK_NS // 2
        self._agreed = self._agreed + 1 if self._agreed and agrees else 1
        self._other_phase = stamp % self.period_ns
        if self._agreed == AGREED:
            self._phase, self._agreed = self._other_phase, 0

    def _from(self, phase: int, stamp: int) -> int:
        """Distance of a stamp from the nearest point of a grid [ns]."""
        return (stamp - phase + self.period_ns // 2) % self.period_ns - self.period_ns // 2

    def offer(self, tick: int, values: FloatArray, last: int) -> None:
        """Keep an old frame for the next tick; `last` is the newest tick that is over [ns]."""
        self.waiting, self._values = tick, values.copy()
        self.counts["late"] += last - tick >= self.latency_ns + (TICK_NS if self.latency_ns else 0)

    def keep(self, tick: int, values: FloatArray) -> None:
        """Keep a frame for its tick, which is not over; it is an old one if that lacks other samples."""
        self._ahead.append((tick, values.copy()))

    def place(self, row: FloatArray, tick: int, row_of: Callable[[int], FloatArray | None]) -> None:
        """Put the frame that waits into the vector of a tick, unless that has one.

        Parameters
        ----------
        row : vector of the tick; NaN in the sensor's columns
        tick : its time [ns]
        row_of : vector of an earlier tick; None where it is not known any more
        """
        self._last_tick = tick
        self._due += tick % self.period_ns == 0
        while self._ahead and self._ahead[0][0] <= tick:
            acquired, values = self._ahead.popleft()
            if acquired == tick:
                row[self.columns] = values
            elif acquired > self.waiting and np.isfinite(values).all():
                self.offer(acquired, values, tick - TICK_NS)
        if self.waiting < 0:
            return
        acquired, self.waiting = self.waiting, -1
        if self.old == DROP or row[self.columns.start] == row[self.columns.start]:
            return
        row[self.columns] = self._values
        then = row_of(acquired)
        if self.old == CORRECT and self.gauge is not None and then is not None:
            row[self.columns] += self.per_mirror * (row[self.gauge] - then[self.gauge])
        age = tick - acquired
        self._ages = [self._ages[0] + 1, self._ages[1] + age, max(self._ages[2], age)]

    def silent_ns(self) -> int:
        """Time since the newest frame, if more than three of them are missing; else 0."""
        silent = self._last_tick - self._newest if self._newest >= 0 else 0
        return silent if silent > 3 * self.period_ns + self.latency_ns else 0

    def begin_again(self) -> None:
        """Another run begins."""
        self.counts.clear()
        self.waiting = self._newest = -1
        self._ahead.clear()
        self._phase, self._agreed = None, 0
        self._ages, self._due, self._silent_max = [0, 0, 0], 0, 0

    def statistics(self) -> dict[str, str]:
        """Counts and ages that are not zero."""
        first = f"{BEGINNING}{self.name}_"
        pending = 1 if self.waiting >= 0 or self.latency_ns else 0  # the last frame may be on its way
        self.counts["absent"] = max(0, self._due - self.counts["came"] - pending)
        statistics = {f"{first}{name}": str(self.counts[name]) for name in NAMES if self.counts[name]}
        count, total, largest = self._ages
        if count:
            statistics |= {
                f"{first}old": str(count),
                f"{first}age_mean_ms": f"{total / count / TICK_NS:.3g}",
                f"{first}age_max_ms": f"{largest / TICK_NS:.3g}",
            }
        if (silent := max(self._silent_max, self.silent_ns())) > 3 * self.period_ns:
            statistics[f"{first}silent_max_s"] = f"{silent * 1e-9:.3g}"
        return statistics


def frames_in_words(statistics: dict[str, str]) -> list[str]:
    """A sentence about each sensor with irregular frames, from the statistics of a node.

    Examples
    --------
    >>> frames_in_words({"frames_camera/los_absent": "3", "frames_camera/los_silent_max_s": "0.4", "ticks": "9"})
    ['camera/los: 3 frames absent, silent for 0.4 s']
    >>> frames_in_words({"frames_camera/los_late": "2", "frames_camera/los_age_max_ms": "9"})
    ['camera/los: 2 frames late, used up to 9 ms old']
    """
    kinds = (*NAMES, "silent_max_s", "age_max_ms")
    by_sensor: dict[str, dict[str, str]] = {}
    for key, value in statistics.items():
        kind = next((kind for kind in kinds if key.startswith(BEGINNING) and key.endswith(f"_{kind}")), "")
        if kind:
            by_sensor.setdefault(key.removeprefix(BEGINNING).removesuffix(f"_{kind}"), {})[kind] = value
    lines = []
    for name, values in sorted(by_sensor.items()):
        words = [counted(int(values[kind]), "frame", f" {kind.replace('_', ' ')}") for kind in NAMES if kind in values]
        if "silent_max_s" in values:
            words.append(f"silent for {values['silent_max_s']} s")
        if "age_max_ms" in values and words:
            words.append(f"used up to {values['age_max_ms']} ms old")
        if words:
            lines.append(f"{name}: {', '.join(words)}")
    return lines
