"""Samples of sensors that are slower than the tick: between them a law takes the last one. Needs numpy only."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from titop_plant.sensors import Sensor


class HeldSamples:
    """The last samples of the sensors of a vector that may lack one at a tick.

    A sample counts where all of its values are finite; before the first one they are zero.

    Parameters
    ----------
    sensors : iterable of Sensor
        Of the whole vector, in its order.

    Attributes
    ----------
    columns : ndarray of int, shape (h,)
        Columns of the values that are held.
    parts : ndarray of int, shape (sensors + 1,)
        Where each sensor that is held begins among them, and the end.
    values : ndarray, shape (h,)
        The last samples, the same array at every tick.

    Examples
    --------
    >>> from lftkit.systems.ports import Port
    >>> zero = np.zeros(1)
    >>> held = HeldSamples([Sensor(Port("a", 1), zero, zero), Sensor(Port("b", 1), zero, zero, framed=True)])
    >>> for sample in ([1.0, 2.0], [3.0, np.nan]):
    ...     vector = np.array(sample)
    ...     held.fill(vector)
    >>> vector.tolist()
    [3.0, 2.0]
    """

    def __init__(self, sensors: Iterable[Sensor]) -> None:
        parts: list[range] = []
        first = 0
        for sensor in sensors:
            if sensor.framed:
                parts.append(range(first, first + sensor.port.size))
            first += sensor.port.size
        self.columns: IntArray = np.array([column for part in parts for column in part], dtype=np.int64)
        self.parts: IntArray = np.cumsum([0, *map(len, parts)])
        ends = self.parts.tolist()
        self._parts = [tuple(zip(part, range(begin, end))) for part, begin, end in zip(parts, ends, ends[1:])]
        self.values = np.zeros(len(self.columns))

    def fill(self, vector: FloatArray) -> None:
        """Take the samples of a tick from a vector, and write the last ones where it has none, in place."""
        for part in self._parts:
            for column, _ in part:
                x = vector[column]
                if x - x != 0.0:  # 0 for a finite number only: cheaper than np.isfinite on two elements
                    break
            else:
                for column, kept in part:
                    self.values[kept] = vector[column]
        if self._parts:
            vector[self.columns] = self.values

    def fill_rows(self, vectors: FloatArray) -> None:
        """What :meth:`fill` does for each of some rows (k, n) in turn, in place."""
        for part in self._parts:
            columns, kept = [column for column, _ in part], [place for _, place in part]
            seen = np.vstack([self.values[kept], vectors[:, columns]])
            fresh = np.isfinite(seen).all(axis=1)
            newest = np.maximum.accumulate(np.where(fresh, np.arange(len(seen)), 0))
            vectors[:, columns] = seen[newest[1:]]
            self.values[kept] = seen[newest[-1]]


__all__ = ["HeldSamples"]
