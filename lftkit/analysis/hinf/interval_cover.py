"""Intervals that cover a range of frequencies or angles, halved until a bound of the gain is below a level on each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lftkit.analysis.hinf.level_iteration import UndecidedError
from lftkit.arrays import FloatArray

MAX_INTERVALS = 40_000
PEAK_CUTS = 13  # first cuts around a peak: halvings of the distance of the nearest pole
INSIDE = 0.75  # an interval's half width over the distance of the nearest pole, at most: expansions converge

Bounds = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def above_level(
    bounds: Bounds, level: float, intervals: FloatArray, at_once: int = MAX_INTERVALS
) -> tuple[FloatArray, FloatArray] | None:
    """Centres of intervals at which a gain exceeds `level`, and those gains; None: it stays below on all intervals.

    Parameters
    ----------
    bounds : callable
        Of centres and half widths, both (N,): the gain at the centres, and a bound of it on the intervals, both (N,).
    level : float
    intervals : ndarray, shape (N, 2)
    at_once : int
        Intervals in one call of `bounds`.

    Raises
    ------
    UndecidedError
        More than `MAX_INTERVALS` intervals, or one that cannot be halved.
    """
    done = 0
    while len(intervals):
        done += len(intervals)
        if done > MAX_INTERVALS:
            raise UndecidedError(f"more than {MAX_INTERVALS} intervals")
        kept = []
        for start in range(0, len(intervals), at_once):
            part = intervals[start : start + at_once]
            centre, half = 0.5 * (part[:, 0] + part[:, 1]), 0.5 * (part[:, 1] - part[:, 0])
            gain, bound = bounds(centre, half)
            above = gain > level
            if above.any():
                return centre[above], gain[above]
            kept.append(part[~(bound <= level)])
        intervals = np.concatenate(kept)
        low, high = intervals.T
        middle = 0.5 * (low + high)
        if np.any((middle <= low) | (middle >= high)):
            raise UndecidedError("an interval cannot be halved")
        intervals = np.concatenate([np.column_stack([low, middle]), np.column_stack([middle, high])])
    return None
