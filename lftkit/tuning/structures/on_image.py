"""Discrete controllers of any structure as the continuous ones that the descent works on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.structures.bounds import Bounds, bounds_of
from lftkit.tuning.structures.decentralised import Decentralised
from lftkit.tuning.structures.structures import AffineStructure, Structure

SINGULAR = 1e-12
"""Relative shift of a controller's pole from exactly z = -1, whose image is at infinity."""


@dataclass(frozen=True)
class StructureOnImage:
    """Image of a discrete controller at ``s = (2 / dt) (z - 1) / (z + 1)`` by the parameters of the discrete one.

    Parameters
    ----------
    discrete : Structure
        Its gain matrix is that of the discrete controller.
    dt : float
        Sampling period [s].
    """

    discrete: Structure
    dt: float

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measurements."""
        return self.discrete.inputs

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Commands."""
        return self.discrete.outputs

    @property
    def order(self) -> int:
        """Number of states."""
        return self.discrete.order

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.discrete.size

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(getattr(self.discrete, "names", [f"x[{k}]" for k in range(self.size)]))

    @property
    def bounds(self) -> Bounds | None:
        """Bounds of the parameters."""
        return bounds_of(self.discrete)

    def sampled(self, x: FloatArray, name: str = "K") -> System:
        """The discrete controller at `x` (size,)."""
        n, K = self.order, self.discrete.gain_matrix(x)
        return System(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], self.inputs, self.outputs, name, dt=self.dt)

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """``(A + I)^-1`` and B, C, D."""
        n, K = self.order, self.discrete.gain_matrix(x)
        moved = K[:n, :n] + np.eye(n)
        inverse, singular = _inverse(moved)
        if singular:
            inverse, _ = _inverse(moved + SINGULAR * max(float(np.abs(moved).max()), 1.0) * np.eye(n))
        return inverse, K[:n, n:], K[n:, :n], K[n:, n:]

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix of the image at `x` (size,)."""
        M, B, C, D = self._parts(x)
        rate, root = 2.0 / self.dt, 2.0 / self.dt**0.5
        return np.block([[rate * (np.eye(self.order) - 2.0 * M), root * M @ B], [root * C @ M, D - C @ M @ B]])

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        n, (M, B, C, _) = self.order, self._parts(x)
        rate, root = 2.0 / self.dt, 2.0 / self.dt**0.5
        GA, GB, GC, GD = G[:n, :n], G[:n, n:], G[n:, :n], G[n:, n:]
        by_inverse = root * (GB @ B.T + C.T @ GC) - C.T @ GD @ B.T - 2.0 * rate * GA
        of_A = -M.T @ by_inverse @ M.T
        of_B, of_C = M.T @ (root * GB - C.T @ GD), (root * GC - GD @ B.T) @ M.T
        return self.discrete.pullback(x, np.block([[of_A, of_B], [of_C, GD]]))

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Parameters of a random start."""
        return self.discrete.start(rng)


def _inverse(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Inverse, and whether the matrix is exactly singular."""
    if not len(matrix):
        return matrix, False
    factors, pivots, _ = linalg.lapack.dgetrf(matrix)
    inverse, info = linalg.lapack.dgetri(factors, pivots)
    return np.asarray(inverse), bool(info)


def required_period(structure: Structure, dt: float) -> None:
    """Refuse a structure that is made for another period than `dt` [s], 0 for continuous time, with a ValueError."""
    for part in structure.parts if isinstance(structure, Decentralised) else ():
        required_period(part, dt)
    own = structure.dt if isinstance(structure, AffineStructure) else None
    if own is not None and own != dt:
        asked, got = (f"sampling period {t:g} s" if t else "continuous time" for t in (dt, own))
        raise ValueError(f"structure of {structure.outputs[0].name} must be made for {asked}, got {got}")
