"""The bilinear (Tustin) map between continuous and discrete time, ``s = (2 / dt) (z - 1) / (z + 1)``.

It keeps stability and norms; frequencies are warped, ``w = (2 / dt) tan(theta / 2)`` for ``z = exp(j theta)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices


def to_discrete(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> Matrices:
    """Matrices of the discrete-time system of period `dt` [s]; shapes (n, n), (n, m), (p, n), (p, m) stay.

    Raises
    ------
    ValueError
        A period that is not positive, or a pole at 2 / dt, which has no image.

    Examples
    --------
    >>> [float(m.item()) for m in to_discrete(*(np.array([[v]]) for v in (-2.0, 2.0, 1.0, 0.0)), 1.0)]
    [0.0, 1.0, 0.5, 0.5]
    """
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt must be positive, got {dt}")
    n = len(A)
    if n == 0:
        return A, B, C, D
    factors = _factors(np.eye(n) - 0.5 * dt * A, f"2 / dt = {2.0 / dt} rad/s")
    a = linalg.lu_solve(factors, np.eye(n) + 0.5 * dt * A)
    b = linalg.lu_solve(factors, B) * dt
    return a, b, linalg.lu_solve(factors, C.T, trans=1).T, D + 0.5 * C @ b


def to_continuous(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float = 2.0) -> Matrices:
    """Matrices of the continuous-time system that :func:`to_discrete` takes to the given ones.

    With ``dt = 2`` the frequency is ``tan(theta / 2)``.

    Raises
    ------
    ValueError
        A pole at -1, which has no image.

    Examples
    --------
    >>> there = to_discrete(*(np.array([[v]]) for v in (-2.0, 3.0, 1.0, 0.5)), 0.1)
    >>> [round(float(m.item()), 12) for m in to_continuous(*there, 0.1)]
    [-2.0, 3.0, 1.0, 0.5]
    """
    n = len(A)
    if n == 0:
        return A, B, C, D
    factors = _factors(A + np.eye(n), "-1")
    seen = linalg.lu_solve(factors, C.T, trans=1).T
    return (
        (2.0 / dt) * linalg.lu_solve(factors, A - np.eye(n)),
        (2.0 / dt) * linalg.lu_solve(factors, B),
        2.0 * seen,
        D - seen @ B,
    )


def _factors(M: FloatArray, pole: str) -> tuple[FloatArray, NDArray[np.int32]]:
    """LU factors of a matrix that is singular where the system has the named pole."""
    lu, pivots, info = linalg.lapack.dgetrf(M)
    if info > 0:
        raise ValueError(f"poles must not be at {pole}, got one there")
    return lu, pivots
