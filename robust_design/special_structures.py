"""Two more structures: controllers stable at every parameter value, and controllers side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from robust_design.model import Model
from robust_design.structures import Structure, total_size
from uncertain_systems.runtime import Port

FloatArray = NDArray[np.float64]
sl: Any = scipy.linalg


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
            raise ValueError(f"order must be at least 1 and min_decay positive, got {self.order} and {self.min_decay}")

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
        S[np.tril_indices(n, -1)], L[np.tril_indices(n)] = s, l
        A = S - S.T - L @ L.T - self.min_decay * np.eye(n)
        D = d.reshape(nu, ny) if self.feedthrough else np.zeros((nu, ny))
        return np.block([[A, b.reshape(n, ny)], [c.reshape(nu, n), D]])

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        n = self.order
        L = np.zeros((n, n))
        L[np.tril_indices(n)] = self._split(x)[1]
        GA = G[:n, :n]
        parts = [
            (GA - GA.T)[np.tril_indices(n, -1)],
            (-(GA + GA.T) @ L)[np.tril_indices(n)],
            G[:n, n:].ravel(),
            G[n:, :n].ravel(),
        ]
        if self.feedthrough:
            parts.append(G[n:, n:].ravel())
        return np.concatenate(parts)

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return rng.standard_normal(self.size)

    def parameters_of(self, model: Model) -> FloatArray:
        """Parameters of a stable `model`, after a change of state coordinates (same transfer function).

        Raises
        ------
        ValueError
            The model's poles do not all decay faster than min_decay.
        """
        n = self.order
        shifted = model.A + self.min_decay * np.eye(n)
        if model.order != n or np.any(sl.eigvals(shifted).real >= 0.0):
            raise ValueError(
                f"{model.name}: expected order {n} and every pole left of -{self.min_decay} rad/s, got order "
                f"{model.order} and poles {np.round(sl.eigvals(model.A), 6).tolist()}"
            )
        P = sl.solve_continuous_lyapunov(shifted, -np.eye(n))
        T = sl.cholesky(P, lower=True)
        A = sl.solve_triangular(T, model.A @ T, lower=True)
        L = sl.cholesky(-0.5 * (A + A.T) - self.min_decay * np.eye(n), lower=True)
        B = sl.solve_triangular(T, model.B, lower=True)
        S = 0.5 * (A - A.T)
        parts = [S[np.tril_indices(n, -1)], L[np.tril_indices(n)], B.ravel(), (model.C @ T).ravel()]
        return np.concatenate([*parts, model.D.ravel()] if self.feedthrough else parts)


@dataclass(frozen=True)
class Decentralised:
    """Several controllers side by side, each seeing its own measurements only.

    Parameters
    ----------
    parts : tuple of Structure
        Their ports must not overlap.
    """

    parts: tuple[Structure, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        for side in ("inputs", "outputs"):
            names = [p.name for part in self.parts for p in getattr(part, side)]
            if len(set(names)) < len(names):
                raise ValueError(f"decentralised parts must not share {side}, got {names}")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measurements of all parts."""
        return tuple(p for part in self.parts for p in part.inputs)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Commands of all parts."""
        return tuple(p for part in self.parts for p in part.outputs)

    @property
    def order(self) -> int:
        """Sum of the orders."""
        return sum(part.order for part in self.parts)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(part.size for part in self.parts)

    def _pieces(self) -> list[tuple[Structure, slice, Any]]:
        found, at, x, y, u = [], 0, 0, self.order, self.order
        for part in self.parts:
            ny, nu = total_size(part.inputs), total_size(part.outputs)
            rows = np.r_[x : x + part.order, u : u + nu]
            columns = np.r_[x : x + part.order, y : y + ny]
            found.append((part, slice(at, at + part.size), np.ix_(rows, columns)))
            at, x, y, u = at + part.size, x + part.order, y + ny, u + nu
        return found

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        K = np.zeros((self.order + total_size(self.outputs), self.order + total_size(self.inputs)))
        for part, piece, place in self._pieces():
            K[place] = part.gain_matrix(x[piece])
        return K

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        return np.concatenate([part.pullback(x[piece], G[place]) for part, piece, place in self._pieces()])

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return np.concatenate([part.start(rng) for part in self.parts])
