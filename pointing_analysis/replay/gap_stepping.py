"""How observers and controllers step over ticks whose samples are missing; nodes and replay do it alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointing_analysis.arrays import FloatArray, IntArray

GAP_LIMIT = 50
"""Longest gap, in ticks, that is stepped over on held samples; a longer one is left out."""


class GapStepper:
    """Step function of an observer or controller that first makes up for missing ticks.

    The state of a controller must advance with time. For every missing tick it is stepped on the last complete sample,
    held; values that come only now and then (camera) are NaN there. After a gap longer than :data:`GAP_LIMIT` the held
    sample says nothing, and the missing ticks are left out.

    Parameters
    ----------
    step : callable
        ``step(sample, out)``: one tick.
    size : int
        Length of a sample.
    intermittent : slice or ndarray of int
        Columns that are NaN in a held sample.

    Examples
    --------
    >>> seen = []
    >>> stepper = GapStepper(lambda sample, out: seen.append(sample.tolist()), 2, slice(1, 2))
    >>> for value, gap in ((1.0, 0), (4.0, 2)):
    ...     stepper(np.array([value, value]), gap, np.zeros(1))
    >>> seen
    [[1.0, 1.0], [1.0, nan], [1.0, nan], [4.0, 4.0]]
    """

    def __init__(
        self, step: Callable[[FloatArray, FloatArray], None], size: int, intermittent: slice | IntArray = slice(0)
    ) -> None:
        self._step = step
        self._held = np.zeros(size)
        self._intermittent = intermittent

    def __call__(self, sample: FloatArray, gap: int, out: FloatArray) -> None:
        """Step over `gap` missing ticks, then on `sample` (size,); the result is written into `out`."""
        if 0 < gap <= GAP_LIMIT:
            self._held[self._intermittent] = np.nan
            for _ in range(gap):
                self._step(self._held, out)
        self._step(sample, out)
        self._held[:] = sample
