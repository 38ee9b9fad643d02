"""Sums and products of matrices in twice the working precision, from exact parts (compensated arithmetic).

A matrix product is split as by Ozaki et al. (2012): the leading bits of both factors are multiplied without any
rounding, so that BLAS does all the work and the order of its sums does not matter for the leading part.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lftkit.arrays import FloatArray

_SPLITTER = 134217729.0  # 2^27 + 1 (Dekker 1971)


def matrix_product(A: FloatArray, X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``A @ X`` (n, k) times (k, m) as an unevaluated sum ``high + low``.

    The error is about k 2^-75 times the largest entries of the row and of the column: seven digits more than one
    product has. Infinite entries give NaN.

    Examples
    --------
    >>> high, low = matrix_product(np.array([[1.0, 2.0**-60, -1.0]]), np.ones((3, 1)))
    >>> float((high + low).item()) == 2.0**-60
    True
    """
    bits = _bits(A.shape[1])
    first, second = _leading(A, bits, 1), _leading(X, bits, 0)
    return first @ second, first @ (X - second) + (A - first) @ X


def fine_product(A: FloatArray, X: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    """``A @ X`` as three parts that are exact to a rest, which comes beside them.

    The error is about k 2^-97 times the largest entries of the row and of the column: for sums that cancel to less than
    the error of :func:`matrix_product`.
    """
    bits = _bits(A.shape[1])
    first, second = _leading(A, bits, 1), _leading(X, bits, 0)
    (right, rest), (left, more) = matrix_product(first, X - second), matrix_product(A - first, X)
    return [first @ second, right, left], rest + more


def two_sum(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``a + b`` rounded, and the rounding error (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def halves(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Leading and trailing 26 bits: their sum is `a`, and products of leading parts are exact (Dekker)."""
    t = _SPLITTER * a
    first = t - (t - a)
    return first, a - first


def two_product(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``a * b`` elementwise, rounded, and the rounding error (Dekker)."""
    product = a * b
    a1, a2 = halves(a)
    b1, b2 = halves(b)
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


def refined_solution(
    A: FloatArray,
    omega: float,
    right: FloatArray,
    solved: Callable[[FloatArray], FloatArray],
    *,
    fine: bool = False,
    steps: int = 8,
    refined: float = 1e-9,
) -> tuple[FloatArray, FloatArray, bool]:
    """Solution of ``(j omega - A) X = right`` by refinement, what is to be added to it, and whether it settled.

    `right` and the solution have real parts beside imaginary parts; `solved` is a rough solution. Residuals are in
    twice the working precision, `fine` ones have seven digits more. There are so many `steps` at most; at a relative
    correction of `refined` the next one would be rounding.
    """
    m = right.shape[1] // 2
    omega1, omega2 = halves(np.array(omega))
    X, last = np.zeros(right.shape), np.inf
    correction = solved(right)
    for _ in range(steps):
        X = X + correction
        first, second = halves(np.hstack([X[:, m:], -X[:, :m]]))
        if fine:
            (total, *parts), low = fine_product(A, X)
            parts += [first * omega1, right, first * omega2, second * omega1]
            rest = [second * omega2]
        else:
            total, low = matrix_product(A, X)
            parts, rest = [first * omega1, right], [first * omega2, second * omega]
        for part in parts:
            total, error = two_sum(total, part)
            low += error
        correction = solved(total + sum(rest, low))
        change, size = np.abs(correction).max(initial=0.0), np.abs(X).max(initial=0.0)
        if not change < 0.5 * last:  # rounding is all that is left
            return X, np.zeros_like(X), bool(change <= refined * size)
        if change <= refined * size:
            return X, correction, True
        last = change
    return X, correction, False


def _bits(count: int) -> int:
    """Leading bits of both factors of a sum of `count` products that is exact."""
    return (53 - int(np.ceil(np.log2(max(count, 1)))) - 1) // 2


def _leading(X: FloatArray, bits: int, axis: int) -> FloatArray:
    """`X` rounded to `bits` bits below the largest entry along `axis`."""
    exponent = np.frexp(np.abs(X).max(axis=axis, keepdims=True, initial=0.0))[1]
    shift = np.ldexp(1.5, exponent + 52 - bits)
    return np.asarray((X + shift) - shift)
