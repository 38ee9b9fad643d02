"""The index of a sector as a requirement: largest gain of a linear fraction of the weighted transfer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lftkit.analysis.batched_linalg import solve
from lftkit.analysis.passivity import linear_fraction
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.systems.system import System
from lftkit.tuning.requirements.gains import HinfGain, peak_gain
from lftkit.tuning.requirements.requirement import CertifiedValue

if TYPE_CHECKING:
    from lftkit.tuning.requirements.assembled_loop import AssembledLoop


@dataclass(frozen=True)
class SectorGain(HinfGain):
    """Largest gain of ``F = (a T + b) (c T + d)^-1``, with the weighted transfer over the bound as T.

    At most 1 means that the signals of T are within a sector. Goals that make it are
    :class:`lftkit.tuning.goals.Passivity` and :class:`lftkit.tuning.goals.ConicSector`.

    Parameters
    ----------
    inputs, outputs, bound, weight_in, weight_out, hard, name, band
        As in :class:`lftkit.tuning.HinfGain`; as many inputs as outputs.
    fraction : (a, b, c, d)
        Numbers with ``a d - b c`` other than 0.

    Notes
    -----
    The value is that on the imaginary axis, of a stable T. Where the values of T with ``|F| <= 1`` are a disk or a
    half-plane, an index of at most 1 makes F stable, too: the values of T in the right half-plane are in the same set
    by the maximum principle, and ``-d / c``, where F is infinite, is not.
    """

    fraction: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.all(np.isfinite(self.fraction)) and self._determinant != 0.0):
            raise InputError(f"fraction must be finite numbers (a, b, c, d) with a d - b c != 0, got {self.fraction}")

    def held(self, level: float) -> SectorGain:
        """As of :meth:`lftkit.tuning.HinfGain.held`."""
        a, b, c, d = self.fraction
        return replace(self, fraction=(a / level, b / level, c, d), hard=True)

    @property
    def _determinant(self) -> float:
        a, b, c, d = self.fraction
        return a * d - b * c

    def indexed(self, T: ComplexArray, omega: FloatArray) -> ComplexArray:
        """F (N, z, z) for T (N, z, z) at frequencies (N,) [rad/s]: zero outside the band, not finite where singular."""
        (a, b, c, d), one = self.fraction, np.eye(T.shape[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            F = solve(c * T + d * one, a * T + b * one)  # numerator and denominator commute
        return np.where(self.counts(omega)[:, None, None], F, 0.0) if self.banded else F

    def slopes(self, F: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Factors (N, z, z) of ``dF = left dT right`` at the values F (N, z, z)."""
        a, _, c, _ = self.fraction
        left = np.asarray(a * np.eye(F.shape[-1]) - c * F)  # a - c F = (a d - b c) (c T + d)^-1
        return left, np.asarray(left / self._determinant)

    def realised(self, T: System) -> System | None:
        """F of a weighted closed loop that is not yet divided by the bound; None where its feedthrough is infinite."""
        index = linear_fraction((T.A, T.B, T.C / self.bound, T.D / self.bound), self.fraction)
        return None if index is None else System(*index, T.inputs, T.outputs, self.name, dt=T.dt)

    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Both sides of the index.

        An index whose system is unstable exceeds 1; its value is the largest gain on the axis or the circle.
        """
        index = self.realised(self.weighted(loop))
        if index is None:
            return CertifiedValue(np.inf, np.inf, np.inf)
        norm = peak_gain(index, self.band, rtol, stable=False)
        return CertifiedValue(norm.value, norm.upper, norm.omega)
