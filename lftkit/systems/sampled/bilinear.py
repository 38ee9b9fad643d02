"""The bilinear (Tustin) map between continuous and discrete time, ``s = (2 / dt) (z - 1) / (z + 1)``.

It takes the unit circle to the imaginary axis and its inside to the left half plane, and keeps the response at
corresponding points: stability and H-infinity norms stay, frequencies are warped. With ``dt = 2``, the default where no
sampling period is of interest, it is ``s = (z - 1) / (z + 1)``.

Continuous states are those of :func:`to_discrete`, whose input is not scaled. With B times ``sqrt(dt)`` and C over
``sqrt(dt)`` on the continuous side, the Gramians of both sides are the same.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.regular_solve import lu_factors
from lftkit.support.scalars import as_positive

Point = TypeVar("Point", complex, ComplexArray)


def continuous_point(z: Point, dt: float = 2.0) -> Point:
    """The point s [rad/s] of `z`, for instance of a pole; ``z = -1`` has none.

    Examples
    --------
    >>> continuous_point(0.5 + 0.0j, 0.1)
    (-6.666666666666667+0j)
    """
    return 2.0 / dt * (z - 1.0) / (z + 1.0)


def discrete_point(s: Point, dt: float = 2.0) -> Point:
    """The point z of `s` [rad/s], for instance of a pole; ``s = 2 / dt`` has none.

    Examples
    --------
    >>> discrete_point(-0.5 + 0.0j)
    (0.3333333333333333+0j)
    """
    half = 0.5 * dt * s
    return (1.0 + half) / (1.0 - half)


def warped_frequency(omega: float, dt: float = 2.0) -> float:
    """Frequency [rad/s] in continuous time of `omega` [rad/s] in discrete time; infinite from ``pi / dt`` on.

    Examples
    --------
    >>> round(warped_frequency(0.5 * np.pi / 0.1, 0.1), 9), warped_frequency(np.pi / 0.1, 0.1)
    (20.0, inf)
    """
    half = 0.5 * dt * omega
    return 2.0 / dt * math.tan(half) if half < 0.5 * math.pi else math.inf


def unwarped_frequency(omega: float, dt: float = 2.0) -> float:
    """Frequency [rad/s] in discrete time of `omega` [rad/s] in continuous time.

    Examples
    --------
    >>> round(unwarped_frequency(20.0, 0.1) * 0.1 / np.pi, 12)
    0.5
    """
    return 2.0 / dt * math.atan(0.5 * dt * omega)


def to_discrete(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float, *, rcond: float = 1e-13
) -> Matrices:
    """Matrices of the discrete-time system of period `dt` [s]; shapes (n, n), (n, m), (p, n), (p, m) stay.

    A pole counts as one at 2 / dt where the reciprocal condition number of ``I - dt / 2 A`` is below `rcond`.

    Raises
    ------
    ValueError
        A period that is not positive, or a pole at 2 / dt, which has no image.

    Examples
    --------
    >>> [float(m.item()) for m in to_discrete(*(np.array([[v]]) for v in (-2.0, 2.0, 1.0, 0.0)), 1.0)]
    [0.0, 1.0, 0.5, 0.5]
    """
    as_positive(dt, "dt")
    n = len(A)
    if n == 0:
        return A, B, C, D
    factors = _factors(np.eye(n) - 0.5 * dt * A, f"s = 2 / dt = {2.0 / dt} rad/s", rcond)
    a = linalg.lu_solve(factors, np.eye(n) + 0.5 * dt * A)
    b = linalg.lu_solve(factors, B) * dt
    return a, b, linalg.lu_solve(factors, C.T, trans=1).T, D + 0.5 * C @ b


def to_continuous(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float = 2.0, *, rcond: float = 1e-13
) -> Matrices:
    """Matrices of the continuous-time system that :func:`to_discrete` takes to the given ones.

    Parameters
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, m), (p, n), (p, m), which stay.
    dt : float
        Sampling period [s]. With ``dt = 2`` the frequency is ``tan(theta / 2)``.
    rcond : float
        Reciprocal condition number of ``A + I`` below which a pole counts as one at -1; 0: no pole but an exact one.

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
    one = np.eye(n)
    factors = _factors(A + one, "z = -1", rcond)
    driven: FloatArray = linalg.lapack.dgetrs(*factors, np.concatenate([A - one, B], axis=1))[0]
    observed: FloatArray = linalg.lapack.dgetrs(*factors, C.T, trans=1)[0].T
    rate = 2.0 / dt
    return rate * driven[:, :n], rate * driven[:, n:], 2.0 * observed, D - observed @ B


def discrete_gradient(A: FloatArray, B: FloatArray, C: FloatArray, gradient: Matrices, dt: float = 2.0) -> Matrices:
    """Gradient with respect to discrete matrices of a function of those that :func:`to_continuous` makes of them.

    Parameters
    ----------
    A, B, C : ndarray, shapes (n, n), (n, m), (p, n)
        Of the discrete-time system.
    gradient : tuple of ndarray
        Derivatives of the function by the entries of the four continuous-time matrices.
    dt : float
        Sampling period [s].

    Raises
    ------
    ValueError
        A pole at exactly -1.
    """
    n = len(A)
    if n == 0:
        return gradient
    GA, GB, GC, GD = gradient
    rate = 2.0 / dt
    M = linalg.lapack.dgetrs(*_factors(A + np.eye(n), "z = -1", 0.0), np.eye(n))[0]
    # a = rate (I - 2 M), b = rate M B, c = 2 C M, d = D - C M B
    by_M = rate * GB @ B.T + 2.0 * C.T @ GC - C.T @ GD @ B.T - 2.0 * rate * GA
    return -M.T @ by_M @ M.T, M.T @ (rate * GB - C.T @ GD), (2.0 * GC - GD @ B.T) @ M.T, GD


def _factors(M: FloatArray, pole: str, rcond: float) -> tuple[FloatArray, NDArray[np.int32]]:
    """LU factors of a matrix that is singular where the system has the named pole."""
    factors = lu_factors(M, rcond)
    if factors is None:
        raise InputError(f"system must have no pole at {pole}, got one")
    return factors
