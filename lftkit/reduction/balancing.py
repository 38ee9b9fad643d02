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

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.reduction.gramians import gramian_factor, state_parts
from lftkit.systems.system import System

LEAST = 1e-12
"""Part of the largest Hankel singular value below which a state counts as not reached or not seen."""


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
    def of(cls, reached: FloatArray, seen: FloatArray) -> Balancing:
        """From square factors of the controllability and of the observability Gramian, (n, n)."""
        U, s, Vh = linalg.svd(seen.T @ reached) if len(seen) else (seen, np.zeros(0), seen)
        count = int(np.sum(s > LEAST * s.max(initial=0.0)))
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
    found = balancing(*parts.stable)
    return None if found.order < order else found.coordinates(*parts.stable, order)
