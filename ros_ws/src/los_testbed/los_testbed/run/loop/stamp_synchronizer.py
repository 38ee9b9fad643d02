"""Samples of one tick from several topics, synchronized by stamp and never by order of arrival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, CodecError, stamp_of
from los_testbed.run.loop.slow_sensor import SlowSensor
from los_testbed.run.loop.source_guard import OURS
from titop_plant.interface import TICK_NS

HOLD_STAMP = 0
"""Stamp of the plant's messages before the run begins: no time has passed."""


HORIZON_NS = 50_000_000
"""A stamp may be this much ahead of the plant's time."""

NOT_KNOWN = 1 << 62
"""Time of the plant before the first sample: every stamp may come."""

SILENCE_NS = 50_000_000
"""A part that comes at every tick is silent when it is this far behind the others."""


class TickPart:
    """One topic's share of a tick: its bytes, its columns, and when it is due.

    Parameters
    ----------
    codec : Codec
        Bytes of the topic.
    columns : slice
        Columns in the joined vector.
    every : int
        Due on ticks whose number (stamp / 1 ms) is a multiple of this.
    intermittent : sequence of int
        Those of its values that may be NaN (a dropped camera frame, a sensor without a sample at this tick); a message
        with another one is rejected.
    frames : sequence of (int, int)
        Slow sensors whose samples come in this message: their number among the slow ones and the column of their age.
    topics : mapping of str to slice
        Names of what the message is made of and their columns in it, where it is the message of several topics.
    """

    def __init__(
        self,
        codec: Codec,
        columns: slice,
        every: int = 1,
        intermittent: Sequence[int] = (),
        frames: Sequence[tuple[int, int]] = (),
        topics: Mapping[str, slice] = MappingProxyType({}),
    ) -> None:
        self.codec = codec
        self.columns = columns
        self.period_ns = every * TICK_NS
        self.frames = tuple(frames)
        self._topics = dict(topics) or {"": slice(0, codec.size)}
        self._may_be_absent = set(intermittent)
        self._required = np.setdiff1d(np.arange(codec.size), intermittent) if len(intermittent) else None

    def valid(self, values: FloatArray) -> bool:
        """Whether all values are finite, but for NaN where that is allowed."""
        needed = values if self._required is None else values[self._required]
        # x - x is 0 for a finite number only; one product is cheaper than np.isfinite on each
        energy = float(needed.dot(needed))
        return energy - energy == 0.0 and (self._required is None or not np.isinf(values).any())

    def not_finite(self, values: FloatArray) -> list[str]:
        """Of which topics values are not finite that have to be; "" for the only one."""
        odd = [i for i, x in enumerate(values.tolist()) if np.isinf(x) or (x != x and i not in self._may_be_absent)]
        return [name for name, columns in self._topics.items() if any(columns.start <= i < columns.stop for i in odd)]


class StampSynchronizer:
    """Collects the parts of each tick; a tick is complete when every part that is due has come.

    Topics deliver in order, so when a tick is complete no earlier one can become complete: ticks are
    handed out in order, and those left out are counted as gaps.

    Parameters
    ----------
    parts : sequence of TickPart
        Topics to join.
    size : int
        Length of the joined vector; what is not due is NaN.
    slow : mapping of int to SlowSensor, optional
        In real time: parts that are used when they come, which no tick waits for; numbers behind those of the parts are
        of sensors whose samples come in the message of a part (:attr:`TickPart.frames`). Stamps of the others may then
        be off the grid, by a fixed part and less than half a tick of jitter: they count for the nearest tick.

    Examples
    --------
    >>> codec = Codec("geometry_msgs/msg/Vector3Stamped", 2, "fsm")
    >>> synchronizer = StampSynchronizer([TickPart(codec, slice(0, 2)), TickPart(codec, slice(2, 4))], 4)
    >>> message = bytes(codec.encode(5_000_000, np.array([1.0, 2.0])))
    >>> synchronizer.put(1, message) is None
    True
    >>> synchronizer.put(0, message).tolist()
    [1.0, 2.0, 1.0, 2.0]
    """

    SLOTS = 64

    def __init__(self, parts: Sequence[TickPart], size: int, slow: Mapping[int, SlowSensor] | None = None) -> None:
        self.parts = tuple(parts)
        self.slow = dict(slow or {})
        self.off_grid: Counter[int] = Counter()
        self.latest = [HOLD_STAMP] * (max([len(self.parts) - 1, *self.slow]) + 1)
        self._snaps = slow is not None
        self._phases: dict[int, int] = {}
        self.rejected: Counter[str] = Counter()
        self.not_finite: Counter[tuple[int, str]] = Counter()
        """Messages of a part that were rejected for a value of one of its topics."""
        self.gaps = 0
        self.stamp = HOLD_STAMP
        self.last = HOLD_STAMP
        self.gap = 0
        self.now = NOT_KNOWN
        self._newest = HOLD_STAMP
        slots = self.SLOTS + 1  # the last one is for hold ticks, so that they share no slot with a tick
        self._stamps = [-1] * slots
        self._seen = [0] * slots
        self._rows = [np.full(size, np.nan) for _ in range(slots)]
        self._views = [[row[part.columns] for part in self.parts] for row in self._rows]
        self._always = sum(1 << i for i, part in enumerate(self.parts) if part.period_ns == TICK_NS)
        self._at_times = [(1 << i, part.period_ns) for i, part in enumerate(self.parts) if part.period_ns != TICK_NS]
        self._own_time = sum(1 << i for i in self.slow)

    @property
    def horizon(self) -> int:
        """Largest stamp that may come [ns]; :attr:`now`, the plant's time, is set from outside."""
        return self.now + HORIZON_NS

    @property
    def waiting(self) -> bool:
        """Whether a tick newer than the last complete one is under way."""
        return self._newest > self.last

    def put(self, index: int, data: bytes, source: str = OURS) -> FloatArray | None:
        """Add one message of part `index`; the joined vector if that made its tick complete.

        `source` is what :class:`~los_testbed.run.loop.source_guard.SourceGuard` says of the message; unless it is empty
        it is the reason of a rejection.

        `stamp` then is the tick's, `gap` the number of ticks left out before it.
        """
        part = self.parts[index]
        try:
            sent = stamp = stamp_of(data) if len(data) >= 12 else -1
            if self._snaps and stamp > 0 and not source:
                stamp = self._nearest(index, stamp)
            slot = (stamp // TICK_NS) % self.SLOTS if stamp else self.SLOTS
            if stamp < 0 or stamp % TICK_NS:
                self.rejected["off_grid" if stamp >= 0 else "size"] += 1
                return None
            if stamp > self.horizon:
                self.rejected["future"] += 1
                if index in self.slow and not source:
                    self.slow[index].counts["early"] += 1
                return None
            if source and stamp == HOLD_STAMP:  # repeated until they are answered
                return None
            if source:
                self.rejected[source] += 1
                return None
            if stamp != HOLD_STAMP and index in self.slow:
                values = np.empty(part.columns.stop - part.columns.start)
                part.codec.decode(data, values)
                self._take_frame(index, sent, stamp, values)
                return None
            if stamp != HOLD_STAMP and (stamp <= self.last or self._stamps[slot] > stamp):
                self.rejected["late"] += 1
                return None
            if self._stamps[slot] != stamp:
                self._stamps[slot], self._seen[slot] = stamp, 0
                self._rows[slot].fill(np.nan)
            values = self._views[slot][index]
            part.codec.decode(data, values)
        except CodecError as error:
            self.rejected[error.reason] += 1
            return None
        if self._snaps and stamp != HOLD_STAMP:
            for number, age in part.frames:
                self._take_bundled(number, self._rows[slot], stamp, age)
        self._newest = max(self._newest, stamp)
        self.latest[index] = stamp
        if not part.valid(values):
            self.rejected["not_finite"] += 1
            self.not_finite.update((index, name) for name in part.not_finite(values))
            return None
        seen = self._seen[slot] = self._seen[slot] | 1 << index
        if seen & self._always != self._always or not self._complete(seen, stamp):
            return None
        self._seen[slot] = 0
        if stamp == HOLD_STAMP:  # the plant holds: what came before belongs to another run
            self._stamps = [-1] * len(self._stamps)
            self._newest = HOLD_STAMP
            self._phases.clear()
        for sensor in self.slow.values() if stamp else ():
            sensor.place(self._rows[slot], stamp, self._row_of)
        self.gap = (stamp - self.last) // TICK_NS - 1 if self.last and stamp else 0
        self.gaps += self.gap
        self.stamp = stamp
        self.last = stamp
        return self._rows[slot]

    def _complete(self, seen: int, stamp: int) -> bool:
        """Whether the parts that do not come at every tick have come, too; all are due at a hold tick."""
        return all(
            seen & bit or (stamp != HOLD_STAMP and (bit & self._own_time or stamp % period))
            for bit, period in self._at_times
        )

    def begin_again(self) -> None:
        """Another run begins, with counts of its own."""
        self.gaps = 0
        self.rejected.clear()
        self.not_finite.clear()
        self.off_grid.clear()
        for sensor in self.slow.values():
            sensor.begin_again()

    def silent(self) -> list[tuple[int, int]]:
        """Parts that are silent while others are not, and for how long [ns]."""
        quiet = [
            (index, self.slow[index].silent_ns() if index in self.slow else self._newest - latest)
            for index, latest in enumerate(self.latest)
        ]
        every = {index for index, part in enumerate(self.parts) if part.period_ns == TICK_NS}
        return [(i, t) for i, t in quiet if (i in self.slow and t > 0) or (i in every and t > SILENCE_NS)]

    def _nearest(self, index: int, stamp: int) -> int:
        """Tick of a stamp. How far the grid of a part is from that of the ticks, its first stamp says."""
        phase = self._phases.get(index)
        if phase is None:
            phase = self._phases[index] = (stamp + TICK_NS // 2) % TICK_NS - TICK_NS // 2
        self.off_grid[index] += stamp % TICK_NS != 0
        return (stamp - phase + TICK_NS // 2) // TICK_NS * TICK_NS

    def _take_bundled(self, index: int, row: FloatArray, stamp: int, age: int) -> None:
        """A frame that came with the samples of a tick, as old as the column `age` says; NaN: none came."""
        columns, seconds = self.slow[index].columns, row[age]
        values = row[columns].copy()
        row[columns] = np.nan
        if np.isinf(seconds):  # of no known time
            row[age] = np.nan
            self._refuse_frame(index)
        elif seconds == seconds:
            sent = stamp - round(seconds * 1e9)
            self._take_frame(index, sent, self._nearest(index, sent), values)

    def _take_frame(self, index: int, sent: int, tick: int, values: FloatArray) -> None:
        """A frame of a slow sensor is kept there for its tick or, where that is over, for the next one."""
        sensor = self.slow[index]
        if np.isinf(values).any():
            self._refuse_frame(index)
        elif sensor.note(sent, tick, self.now, self.horizon):
            self.latest[index] = tick
            if tick > self.last:
                sensor.keep(tick, values)
            elif np.isfinite(values).all():
                sensor.offer(tick, values, self.last)

    def _refuse_frame(self, index: int) -> None:
        """Count a frame with a value that is not finite."""
        self.rejected["not_finite"] += 1
        self.not_finite[index, ""] += 1

    def _row_of(self, tick: int) -> FloatArray | None:
        """Vector of an earlier tick, if it is still there and was complete."""
        slot = (tick // TICK_NS) % self.SLOTS
        complete = tick > 0 and self._stamps[slot] == tick and not self._seen[slot]
        return self._rows[slot] if complete else None
