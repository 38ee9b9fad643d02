"""A system over the axis with what only the search for proofs needs: responses without bounds, and hints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop.coordinates import coordinates
from lftkit.proofs.trusted.axis import AxisSystem
from lftkit.proofs.trusted.proof import Strip


@dataclass(frozen=True)
class AxisModel(AxisSystem):
    """A system over a part of the axis, for those who search proofs and for the check; fields as there."""

    @property
    def slowest(self) -> float:
        """Smallest of the poles, in the unit of the variable."""
        size = np.abs(self.poles[self.poles != 0.0])
        return float((1.0 / size if self.beyond else size).min(initial=1.0 if not len(size) else np.inf))

    def amplitudes(self, x: float, /) -> tuple[float, FloatArray]:
        """Weight of the errors and amplitudes of the disturbances: ones."""
        return 1.0, np.ones(self.sizes[3])

    def at(self, x: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the errors by (w, d) at one value of the variable, (q, q + d) and (e, q + d), without bounds."""
        q, driven = self.sizes[0], self.X @ self.B
        states = x * driven / (1j - x * self.poles)[:, None] if self.beyond else driven / (1j * x - self.poles)[:, None]
        response = self.C @ (self.T @ states) + self.D
        return response[:q], response[q:]

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square."""
        return coordinates(self, strip, number, omega, level)
