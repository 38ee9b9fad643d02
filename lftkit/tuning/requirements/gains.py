"""What a design must do: gains between ports and locations of poles, each soft (minimised) or hard (at most 1).

Every requirement has one normalised value per model: 1 is "just met", smaller is better. The tuner minimises the
largest soft value subject to every hard value being at most 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy.linalg

from lftkit.analysis.norms import spectral_abscissa
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.systems.exchange import as_system
from lftkit.systems.system import System

G = TypeVar("G", bound="_Gain")
P = TypeVar("P", bound="_Poles")


@dataclass(frozen=True)
class _Gain:
    """Common fields of the two gain requirements."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    bound: float = 1.0
    weight_in: System | None = None
    weight_out: System | None = None
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            ports = getattr(self, side)
            ports = (ports,) if isinstance(ports, str) else tuple(ports)
            if not ports:
                raise ValueError(f"a gain requirement needs at least one port among its {side}")
            object.__setattr__(self, side, ports)
        if not (np.isfinite(self.bound) and self.bound > 0):
            raise ValueError(f"the bound of a gain requirement must be positive, got {self.bound}")
        for side in ("weight_in", "weight_out"):
            object.__setattr__(self, side, as_weight(getattr(self, side), side))
        if not self.name:
            kind = type(self).__name__
            object.__setattr__(self, "name", f"{kind} {'+'.join(self.inputs)} -> {'+'.join(self.outputs)}")

    def held(self: G, level: float) -> G:
        """The hard requirement that is just met where this one has the value `level`, above 0."""
        return replace(self, bound=level * self.bound, hard=True)


@dataclass(frozen=True)
class HinfGain(_Gain):
    """H-infinity norm of ``weight_out T weight_in / bound`` from ports to ports of the closed loop.

    Parameters
    ----------
    inputs, outputs : tuple of str (or one str)
        Ports of the plant, stacked in this order.
    bound : float
        Gain that counts as 1, in output unit per input unit.
    weight_in, weight_out : System, or what :func:`lftkit.systems.exchange.as_system` takes, optional
        Stable weights; their outer ports are free, their inner side has the size of the stacked ports.
    hard : bool
        At most 1 (True) or minimised (False).
    name : str
    band : (lowest, highest)
        Frequencies that count [rad/s], all by default.
    """

    band: tuple[float, float] = (0.0, float("inf"))

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.band
        if not 0.0 <= low < high:
            raise ValueError(f"band must be a lowest and a higher highest frequency [rad/s], got ({low:g}, {high:g})")

    def counts(self, omega: FloatArray) -> BoolArray:
        """Which of the frequencies (N,) are in the band."""
        return np.asarray((omega >= self.band[0]) & (omega <= self.band[1]))

    @property
    def banded(self) -> bool:
        """Not all frequencies count."""
        return self.band != (0.0, np.inf)


def band_edges(requirements: Sequence[object]) -> FloatArray:
    """Finite edges of the bands of gains [rad/s]."""
    edges = {w for r in requirements if isinstance(r, HinfGain) and r.banded for w in r.band}
    return np.array(sorted(w for w in edges if np.isfinite(w)), dtype=float)


@dataclass(frozen=True)
class H2Gain(_Gain):
    """H2 norm of ``weight_out T weight_in / bound``: rms of the outputs for white noise of unit two-sided density.

    Parameters
    ----------
    inputs, outputs, bound, weight_in, weight_out, hard, name
        As in :class:`HinfGain`; `bound` is an rms value, so that value^2 is the variance in units of bound^2.
        For samples of standard deviation sigma every dt seconds the density is sigma^2 dt: give
        ``weight_in = System.static(sigma * sqrt(dt) * I)``.
    """


@dataclass(frozen=True)
class _Poles:
    """Common fields of the two pole requirements."""

    min_decay: float = 0.0
    min_damping: float = 0.0
    max_frequency: float = float("inf")
    hard: bool = True
    name: str = ""

    def __post_init__(self) -> None:
        if not self.min_decay >= 0:
            raise ValueError(f"min_decay must be zero or positive [rad/s], got {self.min_decay}")
        if not 0 <= self.min_damping < 1:
            raise ValueError(f"min_damping must be in [0, 1), got {self.min_damping}")
        if not self.max_frequency > 0:
            raise ValueError(f"max_frequency must be positive [rad/s], got {self.max_frequency}")
        if not (self.min_decay or self.min_damping or np.isfinite(self.max_frequency)):
            raise ValueError("a pole requirement needs min_decay, min_damping or max_frequency")
        if not self.name:
            object.__setattr__(self, "name", type(self).__name__)

    def held(self: P, level: float) -> P:
        """The hard requirement that is just met where this one has the value `level`, above 0.

        Raises
        ------
        ValueError
            A level of 2 or more, that of poles which do not decay.
        """
        if level >= 2.0 and (self.min_decay or self.min_damping):
            raise ValueError(f"{self.name}: a level that is held must be below 2, got {level:g}")
        decay, damping = (2.0 - level) * self.min_decay, (2.0 - level) * self.min_damping
        largest = level * self.max_frequency
        return replace(self, min_decay=decay, min_damping=damping, max_frequency=largest, hard=True)

    def pieces(self, poles: ComplexArray) -> tuple[FloatArray, ComplexArray, IntArray]:
        """Values, derivatives and pole numbers of all bounds.

        A value v of pole s changes by ``Re(conj(derivative) ds)``. Bounds: 2 + Re s / min_decay,
        2 - damping / min_damping, |s| / max_frequency; each is 1 on its boundary.
        """
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
        return np.concatenate(values), np.concatenate(slopes), number


@dataclass(frozen=True)
class ClosedLoopPoles(_Poles):
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
    Poles that the controller cannot move count too: a min_damping above the damping of an unreachable mode
    is infeasible,
    and the tuner says so.
    """


@dataclass(frozen=True)
class ControllerPoles(_Poles):
    """Location of the controller's own poles; ``ControllerPoles(min_decay=1e-3)`` asks for a stable controller."""


@dataclass(frozen=True)
class ParameterBounds:
    """Bounds of the structure's parameters, kept by the descents as a hard requirement: not one that users give."""

    hard: bool = True
    name: str = "bounds of the parameters"


Requirement = HinfGain | H2Gain | ClosedLoopPoles | ControllerPoles


def as_weight(value: Any, what: str) -> System | None:
    """A weight as a system, None where there is none.

    Raises
    ------
    ValueError
        Another type, uncertain elements, or an unstable weight.
    """
    if value is None:
        return None
    try:
        weight = as_system(value)
        weight.require_certain()
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None
    if not _stable(weight):
        raise ValueError(f"weight {weight.name} must be stable: a weight is never stabilised by the loop")
    return weight


def check_weights(requirement: HinfGain | H2Gain, model: System) -> None:
    """Raise a ValueError where the inner side of a weight does not fit the ports of `model`, whose names it says."""
    for what, ports in (("weight_in", requirement.inputs), ("weight_out", requirement.outputs)):
        weight: System | None = getattr(requirement, what)
        if weight is None:
            continue
        inner = what == "weight_in"
        needed = len(model.input_indices(ports) if inner else model.output_indices(ports))
        found, side = weight.D.shape[0 if inner else 1], "outputs" if inner else "inputs"
        if found != needed:
            raise ValueError(
                f"{requirement.name}: {what} must have {needed} {side}, as many as {'+'.join(ports)}, got {found}"
            )


def _stable(weight: System) -> bool:
    """All poles in the open left half-plane, or in the open unit circle of discrete time."""
    if weight.dt:
        return bool(np.all(np.abs(scipy.linalg.eigvals(weight.A)) < 1.0)) if weight.order else True
    return spectral_abscissa(weight.A) < 0.0


def check_names(requirements: Sequence[Requirement]) -> None:
    """Refuse an empty list and names used twice.

    Raises
    ------
    ValueError
        Naming what is wrong.
    """
    if not requirements:
        raise ValueError("a design needs at least one requirement, got none")
    names = [r.name for r in requirements]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ValueError(f"requirement names must be unique, got {twice} twice")
