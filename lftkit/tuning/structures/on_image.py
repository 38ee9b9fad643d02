"""Discrete controllers of any structure as the continuous ones that the descent works on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import discrete_gradient, to_continuous
from lftkit.systems.system import System
from lftkit.tuning.structures.bounds import Bounds, bounds_of
from lftkit.tuning.structures.decentralised import Decentralised
from lftkit.tuning.structures.structures import AffineStructure, Structure


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

    def _matrices(self, x: FloatArray) -> Matrices:
        """Matrices of the discrete controller at `x`, without a pole at exactly z = -1."""
        n, K = self.order, self.discrete.gain_matrix(x)
        A, moved = K[:n, :n], K[:n, :n] + np.eye(n)
        if n and linalg.lapack.dgetrf(moved)[2] > 0:
            # a pole at exactly z = -1 has its image at infinity
            A = A + 1e-12 * max(float(np.abs(moved).max()), 1.0) * np.eye(n)
        return A, K[:n, n:], K[n:, :n], K[n:, n:]

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix of the image at `x` (size,)."""
        A, B, C, D = to_continuous(*self._matrices(x), self.dt, rcond=0.0)
        root = self.dt**0.5  # the Gramians stay
        return np.block([[A, root * B], [C / root, D]])

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        n, root = self.order, self.dt**0.5
        of_image = G[:n, :n], root * G[:n, n:], G[n:, :n] / root, G[n:, n:]
        A, B, C, D = discrete_gradient(*self._matrices(x)[:3], of_image, self.dt)
        return self.discrete.pullback(x, np.block([[A, B], [C, D]]))

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Parameters of a random start."""
        return self.discrete.start(rng)


def required_period(structure: Structure, dt: float) -> None:
    """Refuse a structure that is made for another period than `dt` [s], 0 for continuous time, with a ValueError."""
    for part in structure.parts if isinstance(structure, Decentralised) else ():
        required_period(part, dt)
    stated = structure.dt if isinstance(structure, AffineStructure) else None
    if stated is not None and stated != dt:
        asked, got = (f"sampling period {t:g} s" if t else "continuous time" for t in (dt, stated))
        raise InputError(f"structure of {structure.outputs[0].name} must be made for {asked}, got {got}")
