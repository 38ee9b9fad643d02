"""Frequency response of a state-space model to the last digits that its matrices hold.

Direct solution with balancing and iterative refinement. For inputs that are *internal* forces (a motor
between two parts, held by its own spring) the response of everything else is a tiny difference of large
numbers at low frequency. There the static and the steady-rate solutions are known to move one relative coordinate only;
they are solved for, cleaned of rounding and taken out exactly::

    (sI - A)^-1 B = E0 + s E1 - s^2 (sI - A)^-1 E1,     A E0 = -B,   A E1 = E0
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

#: Below this frequency internal forces are solved with their static response taken out [rad/s].
SLOW = 100.0
ROUNDING = 1e-9


def accurate_response(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, omega: Any, internal: Any = ()
) -> np.ndarray:
    """Response at each frequency, shape (k, outputs, inputs); `internal` are columns of internal forces."""
    columns = np.asarray(internal, dtype=int)
    A, (scale, _) = linalg.matrix_balance(A, permute=False, separate=True)
    B, C = B / scale[:, None], C * scale
    response = np.empty((len(omega), *D.shape), dtype=complex)
    if columns.size:
        E1, H0, H1 = _static(A, B[:, columns], C, D[:, columns], scale)
    for i, w in enumerate(omega):
        s = 1j * w
        matrix = s * np.eye(len(A)) - A
        factors = linalg.lu_factor(matrix)
        response[i] = C @ _solve(factors, matrix, B.astype(complex)) + D
        if columns.size and w < SLOW:
            response[i][:, columns] = H0 + s * H1 - s**2 * (C @ _solve(factors, matrix, E1.astype(complex)))
    return response


def extended_response(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, omega: Any) -> np.ndarray:
    """Response at each frequency by iterative refinement in extended precision, shape (k, outputs, inputs).

    Solution, residual and output are computed in ``np.longdouble`` (64 bits of mantissa on x86, 113 on others; where
    it is double precision the answer is no better than that). Shapes as usual; frequencies in rad/s.
    """
    A, (scale, _) = linalg.matrix_balance(A, permute=False, separate=True)
    B, C = B / scale[:, None], (C * scale).astype(np.longdouble)
    exact, response = A.astype(np.longdouble), np.empty((len(omega), *D.shape), dtype=complex)
    for i, w in enumerate(omega):
        factors = linalg.lu_factor(1j * w * np.eye(len(A)) - A)
        X = np.zeros(B.shape, dtype=np.clongdouble)
        for _ in range(6):
            residual = B - 1j * np.longdouble(w) * X + exact @ X.real + 1j * (exact @ X.imag)
            X = X + linalg.lu_solve(factors, residual.astype(complex))
        response[i] = C @ X + D
    return response


def _solve(factors: Any, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    x = linalg.lu_solve(factors, right)
    for _ in range(2):
        x = x + linalg.lu_solve(factors, right - matrix @ x)
    return np.asarray(x)


def _static(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """E1 and the outputs of E0 and E1 without rounding; refuses a column that is not an internal force."""
    factors = linalg.lu_factor(A)
    E0 = _clean(-_solve(factors, A, B), scale, 1)
    E1 = _clean(_solve(factors, A, E0), scale, 2)
    left = np.abs(A @ E0 + B) / (np.abs(A) @ np.abs(E0) + np.abs(B) + 1e-300)
    if left.max() > ROUNDING:
        raise ValueError(f"not a static equilibrium: relative residual {left.max():.1e}")
    H0, size0 = D + C @ E0, np.abs(D) + np.abs(C) @ np.abs(E0)
    H1, size1 = C @ E1, np.abs(C) @ np.abs(E1)
    return E1, np.where(np.abs(H0) < ROUNDING * size0, 0.0, H0), np.where(np.abs(H1) < ROUNDING * size1, 0.0, H1)


def _clean(E: np.ndarray, scale: np.ndarray, expected: int) -> np.ndarray:
    """Only `expected` states move in each column; all else must be rounding and is set to zero."""
    size = np.abs(E * scale[:, None])
    small = size < ROUNDING * size.max(axis=0)
    moving = (~small).sum(axis=0)
    if np.any(moving != expected):
        raise ValueError(f"expected {expected} moving state(s) for each internal force, got {moving.tolist()}")
    return np.where(small, 0.0, E)
