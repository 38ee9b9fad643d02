"""Controllers that are stable at every parameter value."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrix
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.structures.structures import total_size


@cache
def _triangles(n: int) -> tuple[Any, Any]:
    """Indices of the strictly lower and of the lower triangle of a matrix, which every gradient asks for."""
    return np.tril_indices(n, -1), np.tril_indices(n)


@checked
@dataclass(frozen=True)
class StableStateSpace:
    """Controller of fixed order that is stable at every parameter value.

    ``A_K = S - S' - L L' - min_decay I`` with S strictly lower and L lower triangular: A_K + A_K' is
    negative definite. Every stable
    controller with abscissa below -min_decay has such a realisation (change coordinates by its Lyapunov matrix).

    Parameters
    ----------
    inputs, outputs : tuple of Port
    order : int
    min_decay : float
        Every pole has real part at most -min_decay [rad/s].
    feedthrough : bool
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    order: int
    min_decay: float = 1e-3
    feedthrough: bool = True

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            ports = tuple(p if isinstance(p, Port) else Port(*p) for p in getattr(self, side))
            object.__setattr__(self, side, ports)
        if self.order < 1 or not self.min_decay > 0:
            raise InputError(f"order must be at least 1 and min_decay positive, got {self.order} and {self.min_decay}")

    @property
    def _sizes(self) -> tuple[int, int, int, int, int]:
        n, ny, nu = self.order, total_size(self.inputs), total_size(self.outputs)
        return n * (n - 1) // 2, n * (n + 1) // 2, n * ny, nu * n, nu * ny if self.feedthrough else 0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(self._sizes)

    def _split(self, x: FloatArray) -> list[FloatArray]:
        return np.split(x, np.cumsum(self._sizes)[:-1])

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        n, nu, ny = self.order, total_size(self.outputs), total_size(self.inputs)
        s, l, b, c, d = self._split(x)
        S, L = np.zeros((n, n)), np.zeros((n, n))
        below, lower = _triangles(n)
        S[below], L[lower] = s, l
        A = S - S.T - L @ L.T - self.min_decay * np.eye(n)
        D = d.reshape(nu, ny) if self.feedthrough else np.zeros((nu, ny))
        return np.block([[A, b.reshape(n, ny)], [c.reshape(nu, n), D]])

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        n = self.order
        L = np.zeros((n, n))
        below, lower = _triangles(n)
        L[lower] = self._split(x)[1]
        GA = G[:n, :n]
        parts = [
            (GA - GA.T)[below],
            (-(GA + GA.T) @ L)[lower],
            G[:n, n:].ravel(),
            G[n:, :n].ravel(),
        ]
        if self.feedthrough:
            parts.append(G[n:, n:].ravel())
        return np.concatenate(parts)

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return rng.standard_normal(self.size)

    def parameters_of(self, model: System) -> FloatArray:
        """Parameters of a stable `model`, after a change of state coordinates (same transfer function).

        Raises
        ------
        ValueError
            The model's poles do not all decay faster than min_decay.
        """
        n = self.order
        shifted = model.A + self.min_decay * np.eye(n)
        if model.order != n or np.any(cast("ComplexArray", linalg.eigvals(shifted)).real >= 0.0):
            raise InputError(
                f"{model.name}: expected order {n} and every pole left of -{self.min_decay} rad/s, got order "
                f"{model.order} and poles {np.round(linalg.eigvals(model.A), 6).tolist()}"
            )
        P = linalg.solve_continuous_lyapunov(shifted, -np.eye(n))
        T = linalg.cholesky(P, lower=True)
        A = linalg.solve_triangular(T, model.A @ T, lower=True)
        L = linalg.cholesky(cast("Matrix", -0.5 * (A + A.T) - self.min_decay * np.eye(n)), lower=True)
        B = linalg.solve_triangular(T, model.B, lower=True)
        S = 0.5 * (A - A.T)
        below, lower = _triangles(n)
        parts = [S[below], L[lower], B.ravel(), (model.C @ T).ravel()]
        return np.concatenate([*parts, model.D.ravel()] if self.feedthrough else parts)
