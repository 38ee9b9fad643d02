"""The model of a sampled loop with what only the search for proofs needs: responses without bounds, and hints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop import coordinates
from lftkit.proofs.trusted.loop import CHANGE, Loop
from lftkit.proofs.trusted.polynomials import Polynomial
from lftkit.proofs.trusted.proof import Box, Strip


@dataclass(frozen=True)
class LoopModel(Loop):
    """The loop of a proof, for those who search proofs and for the checker; fields are those of :class:`Loop`."""

    @property
    def slowest(self) -> float:
        """Smallest magnitude of the plant's poles [rad/s], at most 1 / dt."""
        return float(np.abs(self.poles).min(initial=1.0 / self.dt))

    def at(self, omega: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d) at one frequency, (q, q + d) and (rows, q + d), without bounds."""
        q, y, _, d, _ = self.sizes
        s, z = 1j * omega, np.exp(1j * omega * self.dt)
        growth, gain = (known.c[0] for known in self.growth)
        own = (self.C / (s - self.poles)) @ self.B[:, : q + d] + self.D[:, : q + d]
        if not len(self.K_C):
            return own[:q], np.asarray(own[q:][list(self.rows)])
        seen = (self.C[q:] * (gain / (z - growth))) @ self.B[:, q + d :] + self.D[q:, q + d :]
        felt = (self.C[:q] / (s - self.poles)) @ self.B[:, q + d :] + self.D[:q, q + d :]
        K = ((self.K_C / (z - self.K_poles)) @ self.K_B + self.K_D) / z
        K = K * np.array([np.mean(z ** -np.arange(n)) for n in self.frame])
        from lftkit.analysis.lft_response import feedback  # what reads a proof does without

        u = feedback((K @ seen[:y])[None], (K @ own[q : q + y] + self.entry)[None], balanced=True)[0]
        hold = (1.0 - 1.0 / z) / (s * self.dt)
        channels = own[:q] + hold * felt @ u
        if self.returned:
            u = (u - self.entry) * (1.0 - 1.0 / z if self.returned == CHANGE else 1.0)
        outputs = u if self.commands else own[q + y :] + seen[y:] @ u
        return channels, np.asarray(outputs[list(self.rows)])

    def amplitudes(self, omega: float, /) -> tuple[float, FloatArray]:
        """Weight of the bounded output (over the limit) and amplitudes of the disturbances, without bounds."""
        output, inputs = self.performance(omega, 0.0)
        return float(np.sqrt(output.c[0, 0].real)), np.asarray(inputs.c[0].real ** -0.5)

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square."""
        return coordinates.coordinates(self, strip, number, omega, level)

    def to_bisect(self, M: Polynomial, part: Box, /) -> int | None:
        """Parameter to bisect where the channels are M over a window, or None where a narrower window helps."""
        return coordinates.to_bisect(self, M, part)
