"""Samples of one tick from several topics, synchronized by stamp and never by order of arrival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, CodecError, stamp_of
from los_testbed.loop.source_guard import OURS
from titop_plant.interface import TICK_NS

HOLD_STAMP = 0
"""Stamp of the plant's messages before the run begins: no time has passed."""


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
    nan_allowed : bool
        Whether NaN is a value (a dropped camera frame); otherwise such a message is rejected.
    """

    def __init__(self, codec: Codec, columns: slice, every: int = 1, nan_allowed: bool = False) -> None:
        self.codec = codec
        self.columns = columns
        self.period_ns = every * TICK_NS
        self.nan_allowed = nan_allowed


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

    def __init__(self, parts: Sequence[TickPart], size: int) -> None:
        self.parts = tuple(parts)
        self.rejected: Counter[str] = Counter()
        self.gaps = 0
        self.stamp = HOLD_STAMP
        self.last = HOLD_STAMP
        self.gap = 0
        self.horizon = 1 << 62
        self._newest = HOLD_STAMP
        slots = self.SLOTS + 1  # the last one is for hold ticks, so that they share no slot with a tick
        self._stamps = [-1] * slots
        self._seen = [0] * slots
        self._rows = [np.full(size, np.nan) for _ in range(slots)]
        self._views = [[row[part.columns] for part in self.parts] for row in self._rows]
        self._always = sum(1 << i for i, part in enumerate(self.parts) if part.period_ns == TICK_NS)
        self._at_times = [(1 << i, part.period_ns) for i, part in enumerate(self.parts) if part.period_ns != TICK_NS]

    @property
    def waiting(self) -> bool:
        """Whether a tick newer than the last complete one is under way."""
        return self._newest > self.last

    def put(self, index: int, data: bytes, source: str = OURS) -> FloatArray | None:
        """Add one message of part `index`; the joined vector if that made its tick complete.

        `source` is what :class:`~los_testbed.loop.source_guard.SourceGuard` says of the message; it is the reason of a
        rejection unless it is empty.

        `stamp` then is the tick's, `gap` the number of ticks left out before it.
        """
        part = self.parts[index]
        try:
            stamp = stamp_of(data) if len(data) >= 12 else -1
            slot = (stamp // TICK_NS) % self.SLOTS if stamp else self.SLOTS
            if stamp < 0 or stamp % TICK_NS:
                self.rejected["off_grid" if stamp >= 0 else "size"] += 1
                return None
            if self.last and stamp > self.horizon:
                self.rejected["future"] += 1
                return None
            if source and stamp == HOLD_STAMP:  # repeated until they are answered
                return None
            if source:
                self.rejected[source] += 1
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
        # x - x is 0 for a finite number only; one product is cheaper than np.isfinite on each
        energy = float(values.dot(values))
        if energy - energy != 0.0 and not (part.nan_allowed and not np.isinf(values).any()):
            self.rejected["not_finite"] += 1
            return None
        if stamp > self._newest:
            self._newest = stamp
        seen = self._seen[slot] = self._seen[slot] | 1 << index
        if seen & self._always != self._always or not self._complete(seen, stamp):
            return None
        self._seen[slot] = 0
        if stamp == HOLD_STAMP:  # the plant holds: what came before belongs to another run
            self._stamps = [-1] * len(self._stamps)
            self._newest = HOLD_STAMP
        self.gap = (stamp - self.last) // TICK_NS - 1 if self.last and stamp else 0
        self.gaps += self.gap
        self.stamp = stamp
        self.last = stamp
        return self._rows[slot]

    def _complete(self, seen: int, stamp: int) -> bool:
        """Whether the parts that do not come at every tick have come, too; all are due at a hold tick."""
        return all(seen & bit or (stamp != HOLD_STAMP and stamp % period) for bit, period in self._at_times)
