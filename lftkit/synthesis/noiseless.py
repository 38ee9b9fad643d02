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
from lftkit.proofs.trusted.lower_bound import exact_constraints, follows, rational


def noiseless_combinations(
    A: FloatArray,
    B: FloatArray,
    seen: FloatArray,
    undisturbed: FloatArray | None = None,
    *,
    condition: float = 1e8,
) -> FloatArray:
    """All independent ones of the measurements ``y = C x + D w`` of a plant ``x' = A x + B w``, and of their rates.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n), (n, w)
        A sampled plant's are of the next state.
    seen : ndarray, shape (y, n + w)
        ``[C D]``.
    undisturbed : ndarray, shape (k, n), optional
        Those of :func:`undisturbed_states`.
    condition : float
        Condition of normalised rows above which they count as dependent.

    Returns
    -------
    ndarray, shape (r, y + k + r)
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
    n, states = len(A), np.zeros((0, len(A))) if undisturbed is None else undisturbed
    count = len(exact_constraints(A, B, seen, states, np.zeros((0, 0)))[1])
    chosen: FloatArray = np.zeros((0, count))
    while True:
        rows, before = exact_constraints(A, B, seen, states, chosen)[1], len(chosen)
        for factors in _null_rows(rows[:, n:]):
            size = count + len(chosen) + 1
            row = np.pad(factors, (0, size - len(factors)))[None]
            wider = np.vstack([np.pad(chosen, ((0, 0), (0, 1))), row])
            if all(_independent(part, condition) for part in exact_constraints(A, B, seen, states, wider)):
                chosen = wider
        if len(chosen) == before:
            return chosen


def undisturbed_states(
    A: FloatArray,
    B: FloatArray,
    seen: FloatArray,
    dt: float = 0.0,
    *,
    marginal: float = 1e-9,
    condition: float = 1e8,
) -> FloatArray:
    """Unit rows (k, n) of stable states that no w reaches while the measurements are zero, as those of a weight.

    Their rates are combinations of these states and the measurements, exactly. A mode counts as stable from a decay of
    `marginal` on, over the largest magnitude of one; `condition` is as in :func:`noiseless_combinations`.

    Examples
    --------
    ``x1' = -x1 + x2 + w1`` of the measurement ``x2 + w1``, while x2 has another disturbance:

    >>> A, B = np.array([[-1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [0.0, 1.0]])
    >>> undisturbed_states(A, B, np.array([[0.0, 1.0, 1.0, 0.0]]))
    array([[1., 0.]])
    """
    n, dynamics = len(A), np.hstack([A, B])
    states = list(range(n))
    while True:
        others = [k for k in range(dynamics.shape[1]) if k not in states]
        left = [j for j in states if _spanned(dynamics[j, others], seen[:, others])]
        if left == states or not left:
            break
        states = left
    if not left or len(left) == n:
        return np.zeros((0, n))
    factors = linalg.lstsq(seen[:, others].T, dynamics[np.ix_(states, others)].T)[0]
    poles = linalg.eigvals(A[np.ix_(states, states)] - factors.T @ seen[:, states])
    stable = np.abs(poles).max() < 1.0 - marginal if dt else poles.real.max() < -marginal * np.abs(poles).max()
    rows = np.eye(n)[states]
    apart = all(_independent(part, condition) for part in exact_constraints(A, B, seen, rows, np.zeros((0, 0))))
    return rows if stable and apart else np.zeros((0, n))


def _spanned(row: FloatArray, rows: FloatArray) -> bool:
    """Whether a row is a combination of others; exactly so where it is for rounding."""
    rest = row - linalg.lstsq(rows.T, row)[0] @ rows
    small = float(np.abs(rest).max(initial=0.0)) <= 1e-9 * float(np.abs(row).max(initial=0.0))
    return small and follows(rational(row), rational(rows))


def _independent(rows: Any, condition: float) -> bool:
    """Whether rows, in any units, are so beyond rounding."""
    values = rows.astype(float)
    if not len(values):
        return True
    sizes = np.asarray(linalg.norm(values, axis=1, keepdims=True))
    if len(values) > values.shape[1] or not np.all(sizes > 0.0):
        return False
    gains = linalg.svdvals(values / sizes)
    return float(gains[0]) < condition * float(gains[-1])


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
    vectors = [_floats(row[matrix.shape[1] :]) for row in rows]
    return [row for row in vectors if row is not None]


def _floats(values: list[Fraction]) -> FloatArray | None:
    """The row up to a factor, if exactly so in floating-point numbers."""
    common = math.lcm(*(value.denominator for value in values))
    whole = [int(value * common) for value in values]
    divisor = math.gcd(*whole)
    whole = [value // divisor for value in whole]
    if max(map(abs, whole)).bit_length() > 1000 or any(int(float(value)) != value for value in whole):
        return None
    row = np.array(whole, dtype=float)
    return np.asarray(row / 2.0 ** round(math.log2(np.abs(row).max())))
