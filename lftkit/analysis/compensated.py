"""Sums and products of matrices in twice the working precision, from exact parts (compensated arithmetic).

A matrix product is split as by Ozaki et al. (2012): the leading bits of both factors are multiplied without any
rounding, so that BLAS does all the work and the order of its sums does not matter for the leading part.
"""

from __future__ import annotations

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
    bits = (53 - int(np.ceil(np.log2(max(A.shape[1], 1)))) - 1) // 2
    first, second = _leading(A, bits, 1), _leading(X, bits, 0)
    return first @ second, first @ (X - second) + (A - first) @ X


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


def _leading(X: FloatArray, bits: int, axis: int) -> FloatArray:
    """`X` rounded to `bits` bits below the largest entry along `axis`."""
    exponent = np.frexp(np.abs(X).max(axis=axis, keepdims=True, initial=0.0))[1]
    shift = np.ldexp(1.5, exponent + 52 - bits)
    return np.asarray((X + shift) - shift)
