"""Frequency response of a controller given by its gain matrix, with the factors of its derivative."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.analysis.batched_linalg import solve
from lftkit.arrays import ComplexArray, FloatArray


@dataclass(frozen=True)
class ControllerFactors:
    """Controller at N frequencies, with the factors of its derivative ``dK(jw) = left dK right``.

    Parameters
    ----------
    response : ndarray, shape (N, u, y), complex
    output, state : ndarray, shapes (N, u, order) and (N, order, y), complex
        ``C_K (jw - A_K)^-1`` and ``(jw - A_K)^-1 B_K``: with unit matrices beside them they are the factors.
    turn : ndarray, shape (N, 1, 1), complex, or None
        Delay that multiplies the response.
    """

    response: ComplexArray
    output: ComplexArray
    state: ComplexArray
    turn: ComplexArray | None = None

    def rows(self, row: ComplexArray, index: Any = slice(None)) -> ComplexArray:
        """``row left`` (m, k, order + u) for `row` (m, k, u) at the frequencies `index`."""
        row = row if self.turn is None else row * self.turn[index]
        return np.concatenate([row @ self.output[index], row], axis=2)

    def columns(self, column: ComplexArray, index: Any = slice(None)) -> ComplexArray:
        """``right column`` (m, order + y, k) for `column` (m, y, k) at the frequencies `index`."""
        return np.concatenate([self.state[index] @ column, column], axis=1)


def controller_response(K: FloatArray, order: int, omega: FloatArray) -> ComplexArray:
    """``D_K + C_K (jw - A_K)^-1 B_K`` at the frequencies `omega` (N,): shape (N, u, y)."""
    return controller_at(K, order, omega).response


def controller_at(K: FloatArray, order: int, omega: FloatArray) -> ControllerFactors:
    """Controller with the gain matrix `K` (order + u, order + y) at the frequencies `omega` (N,), infinity allowed."""
    n = order
    if n == 0:
        response = np.broadcast_to(K, (len(omega), *K.shape)).astype(complex)
        return ControllerFactors(response, response[:, :, :0], response[:, :0])
    finite = np.isfinite(omega)
    w = np.where(finite, np.where(omega == 0.0, 1e-12, omega), 1.0)  # the limit of an integrator at zero frequency
    poles, residues = controller_modes(K, n)
    if residues is not None:
        r = 1.0 / (1j * w[:, None] - poles)
        r[~finite] = 0.0
        sums = (r @ residues.reshape(n, -1)).reshape(len(w), *K.shape)
        return ControllerFactors(K[n:, n:] + sums[:, n:, n:], sums[:, n:, :n], sums[:, :n, n:])
    resolvent = solve(
        1j * w[:, None, None] * np.eye(n) - K[:n, :n], np.broadcast_to(np.eye(n, dtype=complex), (len(w), n, n))
    )
    resolvent[~finite] = 0.0
    output, state = K[n:, :n] @ resolvent, resolvent @ K[:n, n:]
    return ControllerFactors(K[n:, n:] + K[n:, :n] @ state, output, state)


Modes = tuple[ComplexArray, ComplexArray | None]


def controller_modes(K: FloatArray, n: int) -> Modes:
    """Poles p_k (n,) and residues R_k (n, n + u, n + y); None for bad eigenvectors of A_K.

    ``[I; C_K] (jw - A_K)^-1 [I, B_K] = sum of R_k / (jw - p_k)``.
    """
    return _modes(np.ascontiguousarray(K).tobytes(), K.shape, n)


@lru_cache(maxsize=4)
def _modes(data: bytes, shape: tuple[int, int], n: int) -> Modes:
    """The same, kept for the models that have the same controller."""
    K = np.frombuffer(data).reshape(shape)
    poles, V = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(K[:n, :n]))
    values = linalg.svdvals(V)
    if values[-1] * 1e4 <= values[0]:  # the resolvent is solved for at every frequency
        return poles, None
    left, right = np.vstack([V, K[n:, :n] @ V]), linalg.solve(V, np.hstack([np.eye(n), K[:n, n:]]))
    return poles, left.T[:, :, None] * right[:, None, :]
