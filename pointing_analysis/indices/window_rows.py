"""Samples of windows that are not a whole number of samples: each sample covers its period.

Sample k covers the time from k to k + 1 periods. A window takes of the samples at its edges the part of the period
that lies in it, so that the weights add up to its length in periods; where that is a whole number they are all one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.read.mapped_arrays import PART, release

ROUNDING = 1e-9
"""Part of a period that is nothing but rounding."""
STARTS = 20
"""Most windows over which what depends on their begins is averaged."""


def window_rows(starts: FloatArray, n: float) -> tuple[IntArray, FloatArray]:
    """Samples of windows, and the part of each that lies in the window.

    Parameters
    ----------
    starts : (m,) begin of each window [periods], zero or more
    n : length of a window [periods]

    Returns
    -------
    index : (m, k) of the samples; those without a part may lie beyond the record
    weight : (m, k), each row adds up to `n`

    Examples
    --------
    >>> index, weight = window_rows(np.array([0.0, 2.5]), 2.5)
    >>> index.tolist(), weight.tolist()
    ([[0, 1, 2, 3], [2, 3, 4, 5]], [[1.0, 1.0, 0.5, 0.0], [0.5, 1.0, 1.0, 0.0]])
    """
    first = np.floor(starts + ROUNDING).astype(np.int64)
    index = first[:, None] + np.arange(int(np.ceil(n)) + 1)
    stops = (starts + n)[:, None]
    weight = np.minimum(index + 1, stops) - np.maximum(index, starts[:, None])
    return index, np.where(weight > ROUNDING, np.minimum(weight, 1.0), 0.0)


def window_starts(n: float) -> FloatArray:
    """Begins of disjoint windows of n periods, in the period that each begins in, until they repeat.

    Examples
    --------
    >>> window_starts(12), window_starts(12.5)
    (array([0.]), array([0. , 0.5]))
    """
    return np.unique(np.round(n * np.arange(STARTS), 9) % 1.0)


def windows_of(e: FloatArray, starts: FloatArray, n: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Mean (m, 2) and mean square about it (m, 2) of windows, some at a time; NaN where a sample is missing.

    Parameters
    ----------
    e : (length, 2) record
    starts, n : begin of each window, and length [periods]
    """
    size = max(int(PART // (n + 2)), 1)
    for at in range(0, len(starts), size):
        index, weight = window_rows(starts[at : at + size], n)
        values = np.where(weight[..., None] > 0.0, e[np.minimum(index, len(e) - 1)], 0.0)
        mean = (weight[..., None] * values).sum(axis=1) / n
        square = np.square(values - mean[:, None, :])
        yield mean, (weight[..., None] * square).sum(axis=1) / n
        release()


def sliding_means(filled: FloatArray, starts: FloatArray, n: float) -> FloatArray:
    """Means (m, 2) of windows that begin at `starts` [periods] in a record (length, 2) without missing samples."""
    total = np.zeros((len(filled) + 1, 2))
    np.cumsum(filled, axis=0, out=total[1:])
    return (_integral(total, filled, starts + n) - _integral(total, filled, starts)) / n


def _integral(total: FloatArray, filled: FloatArray, at: FloatArray) -> FloatArray:
    """Sum over the record up to a time [periods], that of a sample in part."""
    whole = np.floor(at + ROUNDING).astype(np.int64)
    rest = np.maximum(at - whole, 0.0)
    return np.asarray(total[whole] + rest[:, None] * filled[np.minimum(whole, len(filled) - 1)])
