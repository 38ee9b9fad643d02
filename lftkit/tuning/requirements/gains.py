"""Gains between ports of the closed loop, with weights: H-infinity and H2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from lftkit.analysis.norms import HInfNorm, band_gain, h2_norm, hinf_norm, is_stable
from lftkit.arrays import BoolArray, FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.connection.feedback import cascade, close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.image import band_of_image, image_of, sampled_from_image
from lftkit.systems.system import System
from lftkit.tuning.requirements.requirement import CertifiedValue, TuningRequirement

if TYPE_CHECKING:
    from lftkit.tuning.requirements.assembled_loop import AssembledLoop

G = TypeVar("G", bound="Gain")
H = TypeVar("H", bound="HinfGain")


@dataclass(frozen=True)
class Gain(TuningRequirement):
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
                raise InputError(f"a gain requirement needs at least one port among its {side}")
            object.__setattr__(self, side, ports)
        if not (np.isfinite(self.bound) and self.bound > 0):
            raise InputError(f"the bound of a gain requirement must be positive, got {self.bound}")
        for side in ("weight_in", "weight_out"):
            object.__setattr__(self, side, as_weight(getattr(self, side), side))
        if not self.name:
            kind = type(self).__name__
            object.__setattr__(self, "name", f"{kind} {'+'.join(self.inputs)} -> {'+'.join(self.outputs)}")

    def check(self, model: System) -> None:
        """Raise a ValueError where a port does not exist or the inner side of a weight does not fit the ports."""
        for what, ports in (("weight_in", self.inputs), ("weight_out", self.outputs)):
            weight: System | None = getattr(self, what)
            inner = what == "weight_in"
            needed = len(model.input_indices(ports) if inner else model.output_indices(ports))
            if weight is None:
                continue
            size, side = weight.D.shape[0 if inner else 1], "outputs" if inner else "inputs"
            if size != needed:
                raise InputError(
                    f"{self.name}: {what} must have {needed} {side}, as many as {'+'.join(ports)}, got {size}"
                )

    def held(self: G, level: float) -> G:
        """The hard requirement that is just met where this one has the value `level`, above 0."""
        return replace(self, bound=level * self.bound, hard=True)

    def sampled(self: G, dt: float) -> G:
        """The gain with weights in continuous time as discrete ones of period `dt` [s]; 0: as it is."""
        weights = {name: getattr(self, name) for name in ("weight_in", "weight_out") if dt}
        moved: dict[str, Any] = {
            name: sampled_from_image(w, dt) for name, w in weights.items() if w is not None and w.order and not w.dt
        }
        return replace(self, **moved) if moved else self

    def weighted(self, loop: AssembledLoop) -> System:
        """Closed loop from ports to ports with the weights, not yet divided by the bound.

        Raises
        ------
        ValueError
            A weight whose inner side does not fit the ports.
        """
        self.check(loop.model)
        sampled = self.sampled(loop.dt)
        system = close_loop(loop.model, loop.controller, sampled.inputs, sampled.outputs)
        if sampled.weight_in is not None:
            system = cascade(sampled.weight_in, system)
        if sampled.weight_out is not None:
            system = cascade(system, sampled.weight_out)
        return system

    def _weights_on_image(self, model: System) -> dict[str, Any]:
        """Weights in continuous time for the image of the discrete `model`."""
        self.check(model)
        weights: dict[str, Any] = {}
        for name in ("weight_in", "weight_out"):
            weight: System | None = getattr(self, name)
            if weight is not None and weight.order and weight.dt:
                if weight.dt != model.dt:
                    raise InputError(
                        f"{self.name}: {name} must have the sampling period {model.dt} s, got {weight.dt} s"
                    )
                weight = image_of(weight)
            elif weight is not None:
                weight = System(*weight.matrices, weight.inputs, weight.outputs, weight.name)
            weights[name] = weight
        return weights


@checked
@dataclass(frozen=True)
class HinfGain(Gain):
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
            raise InputError(f"band must be a lowest and a higher highest frequency [rad/s], got ({low:g}, {high:g})")

    def counts(self, omega: FloatArray) -> BoolArray:
        """Which of the frequencies (N,) are in the band."""
        return np.asarray((omega >= self.band[0]) & (omega <= self.band[1]))

    @property
    def banded(self) -> bool:
        """Not all frequencies count."""
        return self.band != (0.0, np.inf)

    def on_image(self: H, model: System) -> H:
        """The gain of the image of the discrete `model`, whose band ends at pi / T."""
        dt, changes = float(model.dt), self._weights_on_image(model)
        if self.banded:
            if not self.band[0] < np.pi / dt:
                raise InputError(
                    f"{self.name}: band must begin below pi / T = {np.pi / dt:.6g} rad/s, got {self.band[0]:g}"
                )
            changes["band"] = band_of_image(self.band, dt)
        return replace(self, **changes)

    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Both sides of the norm of the weighted loop."""
        norm = peak_gain(self.weighted(loop), self.band, rtol)
        return CertifiedValue(norm.value / self.bound, norm.upper / self.bound, norm.omega)


def band_edges(requirements: Sequence[object]) -> FloatArray:
    """Finite edges of the bands of gains [rad/s]."""
    edges = {w for r in requirements if isinstance(r, HinfGain) and r.banded for w in r.band}
    return np.array(sorted(w for w in edges if np.isfinite(w)), dtype=float)


@checked
@dataclass(frozen=True)
class H2Gain(Gain):
    """H2 norm of ``weight_out T weight_in / bound``: rms of the outputs for white noise of unit two-sided density.

    Parameters
    ----------
    inputs, outputs, bound, weight_in, weight_out, hard, name
        As in :class:`HinfGain`; `bound` is an rms value, so that value^2 is the variance in units of bound^2.
        For samples of standard deviation sigma every dt seconds the density is sigma^2 dt: give
        ``weight_in = System.static(sigma * sqrt(dt) * I)``.
    """

    def on_image(self, model: System) -> H2Gain:
        """The norm of the image behind ``1 / (1 + s T / 2)``, the root of the ratio of the frequencies' densities."""
        changes = self._weights_on_image(model)
        unlagged = replace(self, **changes)
        lag = transfer([1.0], [0.5 * model.dt, 1.0], len(model.input_indices(self.inputs)))
        changes["weight_in"] = lag if changes["weight_in"] is None else cascade(changes["weight_in"], lag)
        values = {f.name: getattr(self, f.name) for f in fields(self)} | changes
        return SampledH2Gain(**values, unlagged=unlagged, period=float(model.dt))

    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Norm of the weighted loop; samples of white noise of unit density have the variance 1 / T."""
        weighted = self.weighted(loop)
        A, B, C, D = weighted.matrices
        if weighted.dt:
            value = h2_norm(A, B, C, D, dt=weighted.dt) / float(np.sqrt(weighted.dt)) / self.bound
        else:  # feedthrough is zero by construction; what rounding leaves of it must not make the norm infinite
            # of a loop without a feedthrough it is rounding
            D = np.where(np.abs(D) <= 1e-12 * max(1.0, float(np.abs(C).max(initial=0.0))), 0.0, D)
            value = h2_norm(A, B, C, D) / self.bound
        return CertifiedValue(value, value)


@dataclass(frozen=True)
class SampledH2Gain(H2Gain):
    """Image of the H2 norm of a loop on samples.

    Parameters
    ----------
    unlagged : H2Gain
        The gain without the lag of its image, whose plant the bilinear map takes back to that on samples.
    period : float
        [s].
    """

    unlagged: H2Gain | None = None
    period: float = 0.0


def peak_gain(system: System, band: tuple[float, float], rtol: float, *, stable: bool = True) -> HInfNorm:
    """Largest gain of a system over a band [rad/s]; without `stable` unstable ones have one, too."""
    dt = float(system.dt) or None
    if band == (0.0, np.inf) and (stable or is_stable(system.A, system.dt)):
        return hinf_norm(*system.matrices, dt=dt, rtol=rtol)
    return band_gain(*system.matrices, band, dt=dt, rtol=rtol, stable=stable)


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
        raise InputError(f"{what}: {error}") from None
    if not is_stable(weight.A, weight.dt):
        raise InputError(f"weight {weight.name} must be stable: a weight is never stabilised by the loop")
    return weight
