"""Balanced truncation: the states of a stable system that its inputs reach and its outputs see most.

With P and Q the controllability and observability Gramians, the states are scaled so that both are diag(s), the Hankel
singular values, and those of small s are left out. The H-infinity norm of the error is at most twice their sum.
Sources: Moore, IEEE TAC 26 (1981); square-root form: Tombs and Postlethwaite, Int. J. Control 46 (1987); discrete time:
Hinrichsen and Pritchard, IEEE TAC 35 (1990).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS, balanced
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.support.state_units import in_balanced_units
from lftkit.systems.system import System

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
    # A and B in units of the states in which slow poles keep their digits beside large entries, and these units
    A, units = in_balanced_units(A)
    B = np.asarray(B / units[:, None])
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


@dataclass(frozen=True)
class Balancing:
    """Coordinates in which two Gramians are diagonal and alike.

    Parameters
    ----------
    hankel : ndarray, shape (n,)
        Hankel singular values, falling.
    left, right : ndarray, shape (n, k)
        ``left' A right`` is A in the k coordinates that count; ``left' right`` is 1.
    """

    hankel: FloatArray
    left: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, reached: FloatArray, seen: FloatArray, least: float = 1e-12) -> Balancing:
        """From square factors of the controllability and of the observability Gramian, (n, n).

        A state counts as not reached or not seen below a Hankel singular value of `least` times the largest one.
        """
        U, s, Vh = linalg.svd(seen.T @ reached) if len(seen) else (seen, np.zeros(0), seen)
        count = int(np.sum(s > least * s.max(initial=0.0)))
        scale = 1.0 / np.sqrt(s[:count])
        return cls(s, seen @ U[:, :count] * scale, reached @ Vh[:count].T * scale)

    @property
    def order(self) -> int:
        """Number of states that are reached and seen."""
        return self.right.shape[1]

    def coordinates(
        self, A: FloatArray, B: FloatArray, C: FloatArray, order: int | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A, B and C in the first coordinates; all that count where no number is given."""
        left, right = self.left[:, :order], self.right[:, :order]
        return left.T @ A @ right, left.T @ B, C @ right


def balancing(A: FloatArray, B: FloatArray, C: FloatArray, dt: float = 0.0) -> Balancing:
    """Balancing of a stable system."""
    return Balancing.of(gramian_factor(A, B, dt), gramian_factor(A.T, C.T, dt))


def balanced_truncation(system: System, order: int) -> System:
    """The system of lower order with the largest Hankel singular values; D is kept.

    Parameters
    ----------
    system : System
        In continuous time, without uncertainty, stable; :func:`lftkit.reduction.balred` takes others, too, and bounds
        the error.
    order : int
        At most that of the system.

    Raises
    ------
    ValueError
        An order above that of the system or below 0, a system that is not stable, or one with fewer states that are
        reached and seen.

    Examples
    --------
    1 / (s + 1) + 0.01 / (s + 100): the fast part is next to nothing.

    >>> given = System([[-1.0, 0.0], [0.0, -100.0]], [[1.0], [0.1]], [[1.0, 0.1]], [[0.0]], [("u", 1)], [("y", 1)])
    >>> round(balanced_truncation(given, 1).A.item(), 2)
    -1.0
    """
    system.require_certain()
    system.require_continuous()
    if not 0 <= order <= system.order:
        raise InputError(f"{system.name}: order must be between 0 and {system.order}, got {order}")
    A, B, C, D = system.matrices
    kept = truncated(A, B, C, order)
    if kept is None:
        raise InputError(f"{system.name}: must be stable with {order} states that are reached and seen, got others")
    return System(*kept, D, system.inputs, system.outputs, system.name)


def truncated(
    A: FloatArray, B: FloatArray, C: FloatArray, order: int
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A, B and C of the truncated system; None where that has no such order, or the system is not stable."""
    if order == 0:
        return np.zeros((0, 0)), np.zeros((0, B.shape[1])), np.zeros((len(C), 0))
    parts = state_parts(A, B, C)
    if len(parts.other[0]) or order > len(A):
        return None
    of_stable = balancing(*parts.stable)
    return None if of_stable.order < order else of_stable.coordinates(*parts.stable, order)
