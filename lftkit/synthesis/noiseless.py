"""Combinations of measurements without noise, found in rational numbers.

What a plant measures without noise, ``y = C x``, it measures with its rate, ``C A x + C B w``, whose combinations
without noise are measurements again.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.proofs.trusted.lower_bound import exact_constraints, rational

WORST = 1e8
"""Condition of normalised rows above which they count as dependent."""


def noiseless_combinations(A: FloatArray, B: FloatArray, seen: FloatArray) -> FloatArray:
    """All independent ones of the measurements ``y = C x + D w`` of a plant ``x' = A x + B w``, and of their rates.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n), (n, w)
        A sampled plant's are of the next state.
    seen : ndarray, shape (y, n + w)
        ``[C D]``.

    Returns
    -------
    ndarray, shape (r, y + r)
        Row k: factors of the measurements and of the rates of the k combinations before. Those whose factors are no
        floating-point numbers are left out.

    Examples
    --------
    The position of a mass on which a noisy force acts, and so its speed:

    >>> A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    >>> noiseless_combinations(A, B, np.array([[1.0, 0.0, 0.0]]))
    array([[1., 0., 0.],
           [0., 1., 0.]])
    """
    n, count = len(A), len(seen)
    chosen: FloatArray = np.zeros((0, count))
    while True:
        rows, before = exact_constraints(A, B, seen, chosen)[1], len(chosen)
        for factors in _null_rows(rows[:, n:]):
            size = count + len(chosen) + 1
            row = np.pad(factors, (0, size - len(factors)))[None]
            wider = np.vstack([np.pad(chosen, ((0, 0), (0, 1))), row])
            if all(_independent(part) for part in exact_constraints(A, B, seen, wider)):
                chosen = wider
        if len(chosen) == before:
            return chosen


def _independent(rows: Any) -> bool:
    """Whether rows, in any units, are so beyond rounding."""
    values = rows.astype(float)
    if not len(values):
        return True
    sizes = np.asarray(linalg.norm(values, axis=1, keepdims=True))
    if len(values) > values.shape[1] or not np.all(sizes > 0.0):
        return False
    gains = linalg.svdvals(values / sizes)
    return float(gains[0]) < WORST * float(gains[-1])


def _null_rows(matrix: Any) -> list[FloatArray]:
    """Combinations of rows of rational numbers that are zero, by Gaussian elimination."""
    size = len(matrix)
    rows = [[*left, *right] for left, right in zip(matrix.tolist(), rational(np.eye(size)).tolist())]
    for column in range(matrix.shape[1]):
        pivot = next((row for row in rows if row[column]), None)
        if pivot is not None:
            rows = [
                [a - row[column] / pivot[column] * b for a, b in zip(row, pivot)] if row[column] else row
                for row in rows
                if row is not pivot
            ]
    found = [_floats(row[matrix.shape[1] :]) for row in rows]
    return [row for row in found if row is not None]


def _floats(values: list[Fraction]) -> FloatArray | None:
    """The row up to a factor, if exactly so in floating-point numbers."""
    common = math.lcm(*(value.denominator for value in values))
    whole = [int(value * common) for value in values]
    divisor = math.gcd(*whole)
    whole = [value // divisor for value in whole]
    if max(map(abs, whole)).bit_length() > 1000:
        return None
    found = np.array(whole, dtype=float)
    return found / 2.0 ** round(math.log2(np.abs(found).max())) if all(map(_exact, whole)) else None


def _exact(value: int) -> bool:
    return int(float(value)) == value
