"""Tuning in discrete time: loops on samples, controllers that run on samples, norms on the unit circle.

The bilinear map ``s = (2 / T) (z - 1) / (z + 1)`` takes the unit circle to the imaginary axis and keeps every gain at
corresponding frequencies, hence stability and H-infinity norms without any error. The descent works on the image; what
comes back, and its certificate, is of the discrete loop itself. An H2 norm of the loop is that of the image behind the
lag ``1 / (1 + s T / 2)``, whose gain is the root of the ratio of the frequencies' densities; a pole z counts as
``log(z) / T``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.band_gain import band_gain
from lftkit.analysis.norms import h2_norm, hinf_norm
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.systems.connection.feedback import cascade, close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.sampled.bilinear import (
    discrete_point,
    to_continuous,
    to_discrete,
    unwarped_frequency,
    warped_frequency,
)
from lftkit.systems.system import System
from lftkit.tuning.certificate import AGREEMENT, Certificate, weighted_loop
from lftkit.tuning.descent.starts import start_checked
from lftkit.tuning.goals import Goal
from lftkit.tuning.goals.goal import resolved
from lftkit.tuning.lexicographic import tuned_in_order
from lftkit.tuning.problem import MIN_DECAY
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain, Requirement, check_weights
from lftkit.tuning.result import TuningResult
from lftkit.tuning.sector_gain import SectorGain
from lftkit.tuning.status import TuningStatus, inaccurate
from lftkit.tuning.structures.on_image import StructureOnImage, required_period
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import AffineStructure, Structure
from lftkit.tuning.tuner import TuningOptions, tune

DEADBEAT = 1e-12  # magnitude of z below which a pole counts as this fast
RTOL = 1e-5  # of the gains of a certificate


def image_of(model: System) -> System:
    """Continuous system with the response of the discrete `model` at ``s = (2 / T) (z - 1) / (z + 1)``.

    Raises
    ------
    ValueError
        A pole at z = -1, which is at infinity in the image.
    """
    try:
        A, B, C, D = to_continuous(*model.matrices, model.dt)
    except ValueError as error:
        raise ValueError(f"{model.name}: {error}") from None
    root = float(np.sqrt(model.dt))  # the Gramians stay
    return System(A, root * B, C / root, D, model.inputs, model.outputs, model.name)


def sampled_from_image(model: System, dt: float) -> System:
    """Discrete system with period `dt` [s] whose image is `model`."""
    A, B, C, D = to_discrete(*model.matrices, dt)
    root = float(np.sqrt(dt))
    return System(A, B / root, root * C, D, model.inputs, model.outputs, model.name, dt=dt)


def tune_discrete(
    models: Sequence[System],
    requirements: Sequence[Requirement | Goal],
    structure: Structure,
    *,
    initial: Sequence[ArrayLike] = (),
    min_decay: float = MIN_DECAY,
    options: TuningOptions | None = None,
) -> TuningResult:
    """Tune a discrete controller on discrete models, as :func:`lftkit.tuning.tune` does in continuous time.

    Parameters
    ----------
    models : sequence of System
        All with the same sampling period.
    requirements : sequence
        As in :func:`lftkit.tuning.tune`. Weights have the same period, or are in continuous time, as those of goals,
        and count at ``s = (2 / T) (z - 1) / (z + 1)``. White noise of unit density (:class:`H2Gain`) has samples of
        variance 1 / T; poles z count as ``log(z) / T``, and bands end at pi / T.
    structure : Structure
        Of the discrete controller: entries are those of its matrices, also fixed and bounded ones. A PID has the
        sampling period (``pid(..., dt=0.1)``) and is that of the trapezoidal rule.
    initial, min_decay, options
        As in :func:`lftkit.tuning.tune`; initial parameters are those of discrete controllers, and
        the decay is that of the image, ``-log|z| / T`` for slow poles [rad/s].

    Returns
    -------
    TuningResult
        With a discrete controller; norms of the certificate are of the discrete loops, and decay rates are those of
        ``log|z| / T`` [rad/s].

    Raises
    ------
    ValueError
        A model in continuous time, another period, a requirement or a structure that is not among these.

    Examples
    --------
    x+ = 0.5 x + w + u with u = k x: the gain 1 / (1 - |0.5 + k|) is least at k = -0.5.

    >>> plant = System([[0.5]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)],
    ...               dt=0.1)
    >>> from lftkit.tuning.structures.structures import gain
    >>> result = tune_discrete([plant], [HinfGain("w", "z")], gain([("y", 1)], [("u", 1)]),
    ...                        options=TuningOptions(starts=2))
    >>> round(result.soft, 3), round(result.controller.D.item(), 2)
    (1.0, -0.5)
    """
    ready, needs = resolved(models, requirements)
    dt = _common_period(ready)
    if options is not None and options.lexicographic:

        def run(
            needs: Sequence[Requirement], structure: Structure, starts: Sequence[FloatArray], options: TuningOptions
        ) -> TuningResult:
            return tune_discrete(ready, needs, structure, initial=starts, min_decay=min_decay, options=options)

        given = [start_checked(x, structure) for x in initial]
        return tuned_in_order(run, needs, structure, given, options, AGREEMENT)
    law = _law(structure, dt)
    images = [image_of_requirement(r, ready[0]) for r in needs]
    starts = [start_checked(x, structure) for x in initial]
    if isinstance(law, AffineStructure):
        starts = [_parameters_of_image(law, x, dt) for x in starts]
    found = tune([image_of(m) for m in ready], images, law, initial=starts, min_decay=min_decay, options=options)
    K = law.sampled(found.x) if isinstance(law, StructureOnImage) else sampled_from_image(found.controller, dt)
    certificate = certified(ready, K, needs, dt)
    status, advice = found.status, found.advice
    if found.certificate is None and status is TuningStatus.NOT_STABILISED:
        return replace(found, controller=K)
    stable = bool(np.all(certificate.abscissae < 0.0))
    if stable and not np.allclose(certificate.values, found.values, rtol=AGREEMENT, atol=1e-9):
        status, advice = TuningStatus.INACCURATE, inaccurate(found.values, certificate.values)
    hard = np.array([r.hard for r in needs])
    return replace(
        found,
        status=status,
        advice=advice,
        controller=K,
        x=law.parameters_of(K) if law.order and isinstance(law, AffineStructure) else found.x,
        values=certificate.values,
        soft=float(certificate.values[~hard].max(initial=-np.inf)),
        hard=float(certificate.values[hard].max(initial=-np.inf)),
        peak_frequencies=certificate.peak_frequencies,
        abscissa=float(certificate.abscissae.max()),
        certificate=certificate if stable else None,
    )


def _gain(loop: System, r: HinfGain | H2Gain, dt: float) -> tuple[float, float, float]:
    """Value, upper bound and frequency of a gain of the weighted discrete loop."""
    if isinstance(r, H2Gain):
        value = h2_norm(*loop.matrices, dt=dt) / float(np.sqrt(dt)) / r.bound
        return value, value, 0.0
    bound, sector = r.bound, isinstance(r, SectorGain)
    if isinstance(r, SectorGain):
        index = r.realised(loop)
        if index is None:
            return np.inf, np.inf, np.inf
        loop, bound = System(*index.matrices, index.inputs, index.outputs, index.name, dt=dt), 1.0
    if r.banded:
        value, upper, omega = _gain_in_band(loop, r.band, stable=not sector)
    else:
        norm = hinf_norm(*loop.matrices, dt=dt, rtol=RTOL)
        value, upper, omega = norm.value, norm.upper, norm.omega
    return value / bound, upper / bound, omega


def _gain_in_band(loop: System, band: tuple[float, float], stable: bool) -> tuple[float, float, float]:
    """Gain in a band [rad/s], by the image; its value is that of the loop itself."""
    dt = float(loop.dt)
    try:
        image = image_of(loop)
    except ValueError:
        return np.inf, np.inf, np.inf
    found = band_gain(*image.matrices, _band_of_image(band, dt), rtol=RTOL, stable=stable)
    omega = unwarped_frequency(found.omega, dt)
    if not np.isfinite(found.value):
        return found.value, found.upper, omega
    value = float(linalg.svdvals(loop.response([omega])[0])[0])
    return value, max(found.upper, value), omega


def _band_of_image(band: tuple[float, float], dt: float) -> tuple[float, float]:
    return warped_frequency(band[0], dt), warped_frequency(band[1], dt)


def _common_period(models: Sequence[System]) -> float:
    for model in models:
        model.require_certain()
        if not model.dt:
            raise ValueError(f"{model.name}: system must be in discrete time, got one in continuous time")
        if model.dt != models[0].dt:
            raise ValueError(f"{model.name}: sampling period must be {models[0].dt} s, got {model.dt} s")
    return float(models[0].dt)


def _law(structure: Structure, dt: float) -> AffineStructure | StructureOnImage:
    """What the descent works on: the structure itself where its image is one of the same kind, else its image."""
    required_period(structure, dt)
    if isinstance(structure, StableStateSpace):
        raise ValueError("structure must have entries of discrete matrices, got StableStateSpace of continuous time")
    if isinstance(structure, AffineStructure):
        free = len(structure.parameters) == structure.base.size == structure.size and structure.bounds is None
        if not structure.order or (free and not structure.base.any()):
            return replace(structure, dt=None)
    return StructureOnImage(structure, dt)


@dataclass(frozen=True)
class _OnImage:
    """Poles of the image, which count as ``log(z) / period``."""

    period: float = 1.0

    def pieces(self, poles: ComplexArray) -> tuple[FloatArray, ComplexArray, IntArray]:
        """As those of the requirement in continuous time."""
        half = 0.5 * self.period * poles
        half = np.where(np.abs(1.0 + half) < DEADBEAT, DEADBEAT - 1.0, half)
        values, slopes, number = super().pieces(rates(discrete_point(half), self.period))  # type: ignore[misc]
        return values, slopes * np.conj(1.0 / (1.0 - half**2))[number], number


@dataclass(frozen=True)
class _ClosedLoopOnImage(_OnImage, ClosedLoopPoles):
    pass


@dataclass(frozen=True)
class _ControllerOnImage(_OnImage, ControllerPoles):
    pass


def rates(z: ComplexArray, dt: float) -> ComplexArray:
    """``log(z) / dt`` [rad/s]."""
    return np.asarray(np.log(np.where(np.abs(z) < DEADBEAT, DEADBEAT, z.astype(complex))) / dt)


def image_of_requirement(r: Requirement, model: System) -> Requirement:
    """The requirement on the image of the discrete `model`."""
    dt = float(model.dt)
    if isinstance(r, ClosedLoopPoles | ControllerPoles):
        kind = _ClosedLoopOnImage if isinstance(r, ClosedLoopPoles) else _ControllerOnImage
        return kind(**{field.name: getattr(r, field.name) for field in fields(r)}, period=dt)
    check_weights(r, model)
    changes: dict[str, Any] = {}
    for name in ("weight_in", "weight_out"):
        weight: System | None = getattr(r, name)
        if weight is not None and weight.order and weight.dt:
            if weight.dt != dt:
                raise ValueError(f"{r.name}: {name} must have the sampling period {dt} s, got {weight.dt} s")
            weight = image_of(weight)
        elif weight is not None:
            weight = System(*weight.matrices, weight.inputs, weight.outputs, weight.name)
        changes[name] = weight
    if isinstance(r, H2Gain):
        lag = transfer([1.0], [0.5 * dt, 1.0], len(model.input_indices(r.inputs)))
        changes["weight_in"] = lag if changes["weight_in"] is None else cascade(changes["weight_in"], lag)
    elif r.banded:
        if not r.band[0] < np.pi / dt:
            raise ValueError(f"{r.name}: band must begin below pi / T = {np.pi / dt:.6g} rad/s, got {r.band[0]:g}")
        changes["band"] = _band_of_image(r.band, dt)
    return replace(r, **changes)


def sampled_weights(r: HinfGain | H2Gain, dt: float) -> HinfGain | H2Gain:
    """The requirement with weights in continuous time as discrete ones."""
    weights = {name: getattr(r, name) for name in ("weight_in", "weight_out")}
    moved = {name: sampled_from_image(w, dt) for name, w in weights.items() if w is not None and w.order and not w.dt}
    return replace(r, **moved) if moved else r  # type: ignore[arg-type]


def _parameters_of_image(structure: AffineStructure, x: FloatArray, dt: float) -> FloatArray:
    if not structure.order:
        return x
    n, K = structure.order, structure.gain_matrix(x)
    sampled = System(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], structure.inputs, structure.outputs, "K", dt=dt)
    return structure.parameters_of(image_of(sampled))


def certified(models: Sequence[System], K: System, requirements: Sequence[Requirement], dt: float) -> Certificate:
    """Norms of the discrete loops with the discrete controller `K`; decays are those of ``log|z| / T`` [rad/s]."""
    shape = (len(requirements), len(models))
    values, upper, omega, decays = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(len(models))
    for k, model in enumerate(models):
        poles = linalg.eigvals(close_loop(model, K, (), ()).A)
        decays[k] = np.log(max(float(np.abs(poles).max(initial=0.0)), 1e-300)) / dt
        for i, r in enumerate(requirements):
            if isinstance(r, HinfGain | H2Gain):
                values[i, k], upper[i, k], omega[i, k] = _gain(weighted_loop(model, K, sampled_weights(r, dt)), r, dt)
            else:
                spectrum = np.asarray(poles if isinstance(r, ClosedLoopPoles) else K.poles(), dtype=complex)
                values[i, k] = upper[i, k] = r.pieces(rates(spectrum, dt))[0].max(initial=-np.inf)
    return Certificate(values, upper, omega, decays)
