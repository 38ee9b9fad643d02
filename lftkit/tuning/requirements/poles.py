"""Locations of poles: of the closed loop and of the controller itself."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.sampled.bilinear import discrete_point
from lftkit.systems.sampled.image import rates
from lftkit.systems.system import System
from lftkit.tuning.requirements.requirement import CertifiedValue, TuningRequirement

if TYPE_CHECKING:
    from lftkit.tuning.requirements.assembled_loop import AssembledLoop

P = TypeVar("P", bound="Poles")


@dataclass(frozen=True)
class Poles(TuningRequirement):
    """Common fields of the two pole requirements.

    With a `period` [s] the poles are those of an image; values count over the `level` of a requirement that is held.
    """

    min_decay: float = 0.0
    min_damping: float = 0.0
    max_frequency: float = float("inf")
    hard: bool = True
    name: str = ""
    period: float = field(default=0.0, kw_only=True, repr=False)
    level: float = field(default=1.0, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        if not self.min_decay >= 0:
            raise InputError(f"min_decay must be zero or positive [rad/s], got {self.min_decay}")
        if not 0 <= self.min_damping < 1:
            raise InputError(f"min_damping must be in [0, 1), got {self.min_damping}")
        if not self.max_frequency > 0:
            raise InputError(f"max_frequency must be positive [rad/s], got {self.max_frequency}")
        if not (self.min_decay or self.min_damping or np.isfinite(self.max_frequency)):
            raise InputError("a pole requirement needs min_decay, min_damping or max_frequency")
        if not self.name:
            object.__setattr__(self, "name", type(self).__name__)

    def check(self, model: System) -> None:
        """Nothing: every model has poles."""

    def held(self: P, level: float) -> P:
        """The hard requirement that is just met where this one has the value `level`, above 0."""
        return replace(self, level=level * self.level, hard=True)

    def on_image(self: P, model: System) -> P:
        """The requirement for poles of the image, which count as ``log(z) / T``."""
        return replace(self, period=float(model.dt))

    def pieces(self, poles: ComplexArray) -> tuple[FloatArray, ComplexArray, IntArray]:
        """Values, derivatives and pole numbers of all bounds.

        A value v of pole s changes by ``Re(conj(derivative) ds)``. Bounds: 2 + Re s / min_decay,
        2 - damping / min_damping, |s| / max_frequency; each is 1 on its boundary, and counts over the `level`. With a
        `period` s is ``log(z) / T``.
        """
        if not self.period:
            return self._pieces(poles)
        half = 0.5 * self.period * poles
        half = np.where(np.abs(1.0 + half) < 1e-12, 1e-12 - 1.0, half)  # faster poles have no rate
        values, slopes, number = self._pieces(rates(discrete_point(half), self.period))
        return values, slopes * np.conj(1.0 / (1.0 - half**2))[number], number

    def _value(self, poles: ComplexArray) -> CertifiedValue:
        value = float(self.pieces(poles)[0].max(initial=-np.inf))
        return CertifiedValue(value, value)

    def _pieces(self, poles: ComplexArray) -> tuple[FloatArray, ComplexArray, IntArray]:
        values: list[FloatArray] = []
        slopes: list[ComplexArray] = []
        size = np.maximum(np.abs(poles), 1e-300)
        if self.min_decay:
            values.append(2.0 + poles.real / self.min_decay)
            slopes.append(np.full(len(poles), 1.0 / self.min_decay, dtype=complex))
        if self.min_damping:
            values.append(2.0 + poles.real / size / self.min_damping)
            # d(Re s / |s|) = (Im s)^2 / |s|^3 dRe - Re s Im s / |s|^3 dIm
            slope = (poles.imag**2 - 1j * poles.real * poles.imag) / size**3
            slopes.append(slope / self.min_damping)
        if np.isfinite(self.max_frequency):
            values.append(size / self.max_frequency)
            slopes.append(poles / size / self.max_frequency)
        number = np.tile(np.arange(len(poles)), len(values))
        return np.concatenate(values) / self.level, np.concatenate(slopes) / self.level, number


@checked
@dataclass(frozen=True)
class ClosedLoopPoles(Poles):
    """Location of the closed-loop poles, weights not counted.

    Parameters
    ----------
    min_decay : float
        Every real part at most -min_decay [rad/s].
    min_damping : float
        Every damping ratio at least this.
    max_frequency : float
        Every pole within this circle [rad/s].
    hard : bool
    name : str

    Notes
    -----
    Poles that the controller cannot move count too: a min_damping above the damping of an unreachable mode is
    infeasible, and the tuner says so.
    """

    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Value of the poles of the loop, without those of a delay's approximation."""
        return self._value(loop.poles)


@checked
@dataclass(frozen=True)
class ControllerPoles(Poles):
    """Location of the controller's own poles; ``ControllerPoles(min_decay=1e-3)`` asks for a stable controller."""

    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Value of the poles of the controller."""
        return self._value(loop.controller_poles)
