"""Stepping of observers and controllers over ticks with missing samples, the same in nodes and replay."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray, IntArray

FILLS = LINE, HOLD = ("line", "hold")
"""Replacement for the samples of a gap: linear interpolation, or the sample before it held."""

GAP_LIMITS = {LINE: 8, HOLD: 50}
"""Longest gap, in ticks, that is stepped over; a longer one is left out.

Over half a period of a vibration the line is wrong, and observers integrate accelerations. With the tone of 60 Hz at
the worst point of the reference a line over 17 ticks costs 20 arcsec, leaving them out costs 6.
"""


class GapStepper:
    """Step function of an observer or controller that first makes up for missing ticks.

    The state of a controller must advance with time. When the sample after a gap has come, it is first stepped once for
    every missing tick, on samples of the straight line between the two complete ones, or on the first of them; values
    that come only now and then (camera) are NaN there. After a gap longer than that of :data:`GAP_LIMITS` neither says
    anything about the time between, and the missing ticks are left out.

    Parameters
    ----------
    step : callable
        ``step(sample, out)``: one tick.
    size : int
        Length of a sample.
    intermittent : slice or ndarray of int
        Columns that are NaN at a missing tick.
    fill : str
        One of :data:`FILLS`. Where a value of the line is not finite, the one before the gap is held.
    in_rows : callable, optional
        ``in_rows(samples)``: the outputs (k, p) of as many ticks, in less time than by `step`.

    Examples
    --------
    >>> seen = []
    >>> stepper = GapStepper(lambda sample, out: seen.append(sample.tolist()), 2, slice(1, 2))
    >>> for value, gap in ((1.0, 0), (4.0, 2)):
    ...     stepper(np.array([value, value]), gap, np.zeros(1))
    >>> seen
    [[1.0, 1.0], [2.0, nan], [3.0, nan], [4.0, 4.0]]
    """

    def __init__(
        self,
        step: Callable[[FloatArray, FloatArray], None],
        size: int,
        intermittent: slice | IntArray = slice(0),
        fill: str = LINE,
        in_rows: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        if fill not in FILLS:
            raise InputError(f"fill must be one of {', '.join(FILLS)}, got {fill!r}")
        self._step, self._in_rows = step, in_rows
        self._before = np.zeros(size)
        self._intermittent = intermittent
        self._line, self._limit = fill == LINE, GAP_LIMITS[fill]

    def __call__(self, sample: FloatArray, gap: int, out: FloatArray) -> None:
        """Step over `gap` missing ticks, then on `sample` (size,); the result is written into `out`."""
        if 0 < gap <= self._limit:
            missing = np.tile(self._before, (gap, 1))
            if self._line:
                with np.errstate(invalid="ignore", over="ignore"):
                    missing += np.arange(1, gap + 1)[:, None] / (gap + 1) * (sample - self._before)
                missing = np.where(np.isfinite(missing), missing, self._before)
            missing[:, self._intermittent] = np.nan
            for between in missing:
                self._step(between, out)
        self._step(sample, out)
        self._before[:] = sample

    def rows(self, samples: FloatArray, gaps: IntArray, out: FloatArray) -> None:
        """The same for the rows of `samples` (k, size) after `gaps` (k,) missing ticks each, into `out` (k, p)."""
        alone = np.ones(len(samples), bool) if self._in_rows is None else gaps > 0
        for first, last in itertools.pairwise([0, *(np.flatnonzero(alone)[:, None] + (0, 1)).ravel(), len(samples)]):
            if self._in_rows is not None and last > first and not alone[first]:
                out[first:last] = self._in_rows(samples[first:last])
                self._before[:] = samples[last - 1]
            elif last > first:
                self(samples[first], int(gaps[first]), out[first])
