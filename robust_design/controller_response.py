"""Frequency response of a controller given by its gain matrix, with the factors of its derivative."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lti.batched_linalg import solve

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ORIGIN = 1e-12  # [rad/s] frequency at which the limit of an integrator at zero frequency is taken


def controller_response(K: FloatArray, order: int, omega: FloatArray) -> ComplexArray:
    """``D_K + C_K (jw - A_K)^-1 B_K`` at the frequencies `omega` (N,): shape (N, u, y)."""
    n = order
    out = np.broadcast_to(K[n:, n:], (len(omega), *K[n:, n:].shape)).astype(complex)
    finite = np.isfinite(omega)
    if n == 0 or not finite.any():
        return out
    out[finite] += K[n:, :n] @ _resolvent(K[:n, :n], omega[finite]) @ K[:n, n:]
    return out


def controller_factors(K: FloatArray, order: int, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Response (N, u, y) and the factors of ``dK(jw) = left dK right``: (N, u, order + u), (N, order + y, y)."""
    n, N = order, len(omega)
    nu, ny = K.shape[0] - n, K.shape[1] - n
    left = np.zeros((N, nu, n + nu), dtype=complex)
    right = np.zeros((N, n + ny, ny), dtype=complex)
    left[:, :, n:], right[:, n:, :] = np.eye(nu), np.eye(ny)
    finite = np.isfinite(omega)
    if n and finite.any():
        Phi = _resolvent(K[:n, :n], omega[finite])
        left[finite, :, :n] = K[n:, :n] @ Phi
        right[finite, :n, :] = Phi @ K[:n, n:]
    return K[n:, n:] + K[n:, :n] @ right[:, :n, :], left, right


def _resolvent(A: FloatArray, omega: FloatArray) -> ComplexArray:
    n = len(A)
    w = np.where(omega == 0.0, ORIGIN, omega)
    shifted = 1j * w[:, None, None] * np.eye(n) - A
    return solve(shifted, np.broadcast_to(np.eye(n, dtype=complex), shifted.shape))
