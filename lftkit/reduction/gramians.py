"""Gramians as factors, so that small Hankel singular values keep their digits; the stable part of a system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS, balanced
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.support.state_units import in_balanced_units

ON_EDGE = 64.0 * EPS
"""Distance of a pole from the edge of the stable region, over the largest one or 1, that is no decay."""


@dataclass(frozen=True)
class StateParts:
    """A system as the sum of a stable one and one with all other poles; the feedthrough is in neither.

    Parameters
    ----------
    stable, other : tuple of ndarray
        A, B and C of each.
    """

    stable: tuple[FloatArray, FloatArray, FloatArray]
    other: tuple[FloatArray, FloatArray, FloatArray]


def state_parts(A: FloatArray, B: FloatArray, C: FloatArray, dt: float = 0.0) -> StateParts:
    """The stable part and the rest, by an ordered Schur form and a Sylvester equation.

    Poles on the edge of the stable region, to rounding, are in the rest.

    Parameters
    ----------
    A, B, C : ndarray
        Shapes (n, n), (n, m), (p, n).
    dt : float
        Sampling period [s]; 0: continuous time.

    Examples
    --------
    >>> found = state_parts(np.array([[1.0, 1.0], [0.0, -2.0]]), np.ones((2, 1)), np.ones((1, 2)))
    >>> found.stable[0].tolist(), found.other[0].tolist()
    ([[-2.0]], [[1.0]])
    """
    A, B, C = balanced(A, B, C)
    poles = np.asarray(linalg.eigvals(A) if len(A) else [], dtype=complex)
    edge = -ON_EDGE * float(np.abs(poles).max(initial=0.0))
    if bool(np.all(np.abs(poles) < 1.0 - ON_EDGE) if dt else np.all(poles.real < edge)):
        return StateParts((A, B, C), (A[:0, :0], B[:0], C[:, :0]))

    def decays(real: float, imaginary: float) -> bool:
        return bool(np.hypot(real, imaginary) < 1.0 - ON_EDGE if dt else real < edge)

    T, Q, count = linalg.schur(A, output="real", sort=decays)
    first, last = slice(0, count), slice(count, len(A))
    X = linalg.solve_sylvester(T[first, first], -T[last, last], -T[first, last]) if 0 < count < len(A) else None
    into, seen = Q.T @ B, C @ Q
    if X is None:
        X = np.zeros((count, len(A) - count))
    return StateParts(
        (T[first, first], into[first] - X @ into[last], seen[:, first]),
        (T[last, last], into[last], seen[:, first] @ X + seen[:, last]),
    )


def gramian_factor(A: FloatArray, B: FloatArray, dt: float = 0.0) -> FloatArray:
    """Square factor L of the controllability Gramian ``L L'`` of a stable system, without forming the Gramian.

    In continuous time ``A P + P A' + B B' = 0``, in discrete time ``A P A' - P + B B' = 0``; that of ``A'`` and ``C'``
    is the factor of the observability Gramian. An eigenvalue of the Gramian that is computed from its entries has an
    error of a rounding of the largest one, a singular value of the factor that of its own root. Source: Hammarling,
    IMA J. Numer. Anal. 2 (1982), in complex arithmetic.

    Parameters
    ----------
    A, B : ndarray
        Shapes (n, n), stable, and (n, m).
    dt : float
        Sampling period [s]; 0: continuous time.

    Examples
    --------
    A lag of unit gain has the Gramian 1/2:

    >>> round((gramian_factor(np.array([[-1.0]]), np.array([[1.0]])) ** 2).item(), 12)
    0.5
    """
    n = len(A)
    if n == 0:
        return np.zeros((0, 0))
    A, B, units = _in_balanced_units(A, B)
    T, Z = linalg.schur(A.astype(complex), output="complex")
    rest: ComplexArray = Z.conj().T @ B
    U = np.zeros((n, n), complex)
    for j in reversed(range(n)):
        pole, row = T[j, j], rest[j]
        size = float(linalg.norm(row))
        if size == 0.0:
            continue
        turn, root = row / size, np.sqrt(1.0 - abs(pole) ** 2) if dt else np.sqrt(-2.0 * pole.real)
        U[j, j] = size / root
        above, beside, driven = T[:j, :j], T[:j, j] * U[j, j], rest[:j] @ turn.conj()
        if dt:
            loop = np.conj(pole) * above - np.eye(j)
            column = linalg.solve_triangular(loop, -(np.conj(pole) * beside + root * driven))
            change = root * (above @ column + beside) - (1.0 + pole) * driven
        else:
            column = linalg.solve_triangular(above + np.conj(pole) * np.eye(j), -(beside + root * driven))
            change = -root * column
        U[:j, j] = column
        rest = rest[:j] + np.outer(change, turn)
    complete = units[:, None] * (Z @ U)
    return np.asarray(linalg.qr(np.hstack([complete.real, complete.imag]).T, mode="r")[0][:n].T)


def _in_balanced_units(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A and B in units of the states in which slow poles keep their digits beside large entries, and these units."""
    balanced_A, units = in_balanced_units(A)
    return balanced_A, np.asarray(B / units[:, None]), units
