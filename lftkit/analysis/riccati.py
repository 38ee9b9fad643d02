"""The continuous Riccati equation."""

from __future__ import annotations

import warnings

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.support.regular_solve import regular_solve

RESIDUAL = 1e-6  # of a Riccati equation, relative to its largest term


def riccati(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray | None = None
) -> FloatArray | None:
    """Stabilising solution of a continuous Riccati equation; None where there is none.

    Where the Hamiltonian matrix has eigenvalues on the imaginary axis, the solver can return a matrix that solves
    nothing, depending on rounding: the residual and the closed loop are checked. LAPACK's reordering of eigenvalues can
    fail on an equation that has a solution; it is then solved without balancing.
    """
    free = np.asarray(linalg.eigvals(A), dtype=complex)
    if not Q.any() and (S is None or not S.any()) and bool(np.all(free.real < 0.0)):
        return np.zeros_like(A)  # the solver's is rounding, which solves nothing to a part of its own size
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", linalg.LinAlgWarning)  # judged below by the residual
        try:
            X = _solution(A, B, Q, R, S)
            F = -regular_solve(R, B.T @ X + (0.0 if S is None else S.T))
        except (linalg.LinAlgError, ValueError):
            return None
    terms = A.T @ X, Q, F.T @ R @ F
    residual = terms[0] + terms[0].T + terms[1] - terms[2]
    solved = np.abs(residual).max(initial=0.0) <= RESIDUAL * max(np.abs(M).max(initial=0.0) for M in terms)
    poles = np.asarray(linalg.eigvals(A + B @ F))
    return X if solved and float(poles.real.max(initial=-np.inf)) < 0.0 else None


def _solution(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray | None) -> FloatArray:
    try:
        return np.asarray(linalg.solve_continuous_are(A, B, Q, R, s=S), dtype=float)
    except linalg.LinAlgError:  # a ValueError, too: there is no solution
        raise
    except ValueError:  # the reordering
        return np.asarray(linalg.solve_continuous_are(A, B, Q, R, s=S, balanced=False), dtype=float)
