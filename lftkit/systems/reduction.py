"""Balanced truncation: the states of a stable system that its inputs reach and its outputs see most.

With P and Q the controllability and observability Gramians, the states are scaled so that both are diag(s), the Hankel
singular values, and those of small s are left out. The H-infinity norm of the error is at most twice their sum. Source:
Moore, IEEE TAC 26 (1981); square-root form: Tombs and Postlethwaite, Int. J. Control 46 (1987).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.systems.system import System

LEAST = 1e-12  # of the largest Hankel singular value: states below it are not reached or not seen


def balanced_truncation(system: System, order: int) -> System:
    """The system of lower order with the largest Hankel singular values; D is kept.

    Parameters
    ----------
    system : System
        In continuous time, without uncertainty, stable.
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
        raise ValueError(f"{system.name}: order must be between 0 and {system.order}, got {order}")
    A, B, C, D = system.matrices
    kept = truncated(A, B, C, order)
    if kept is None:
        raise ValueError(f"{system.name}: must be stable with {order} states that are reached and seen, got others")
    return System(*kept, D, system.inputs, system.outputs, system.name)


def truncated(
    A: FloatArray, B: FloatArray, C: FloatArray, order: int
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A, B and C of the truncated system; None where that has no such order, or the system is not stable."""
    if order == 0:
        return np.zeros((0, 0)), np.zeros((0, B.shape[1])), np.zeros((len(C), 0))
    if float(linalg.eigvals(A).real.max()) >= 0.0 or order > len(A):
        return None
    P = linalg.solve_continuous_lyapunov(A, -B @ B.T)
    Q = linalg.solve_continuous_lyapunov(A.T, -C.T @ C)
    p, q = _root(np.asarray(P, dtype=float)), _root(np.asarray(Q, dtype=float))
    U, s, Vh = linalg.svd(q.T @ p)
    if not s[order - 1] > LEAST * s[0]:
        return None
    scale = 1.0 / np.sqrt(s[:order])
    right, left = p @ Vh[:order].T * scale, q @ U[:, :order] * scale
    return left.T @ A @ right, left.T @ B, C @ right


def _root(P: FloatArray) -> FloatArray:
    values, vectors = linalg.eigh(0.5 * (P + P.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
