"""Metrics of a member from its matrices: gains, tones, noise, margins and stability, without a simulated run.

Everything is read from the responses of :class:`los_testbed.campaign.model_loop.ModelLoop` at about 300 frequencies:

* **Gains.** Largest singular values; between three points of the grid around a maximum the inverse square of the gain
  is a parabola (exactly so for one mode), whose vertex is the peak. Sidebands of the camera's frame rate are left out.
* **Noise.** That of the nominal loop is exact (:func:`los_loop.sampled_loop_norms.noise_metrics`); what a member
  changes is the integral of the difference of the two power densities.
* **Stability.** The telescope without fine control is stable, so the loop is stable if the return difference
  ``det(I - K P) = 1 / det(S)`` does not encircle the origin. Where its angle turns by more than :data:`TURN` from one
  frequency to the next, or where it does encircle it, the eigenvalues of the sampled loop decide.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lftkit import SampledSystem, UncertainSystem
from lftkit.analysis.batched_linalg import determinants, gains_above, largest_gains
from los_loop.implemented_loop import DISTURBANCE_IN, FORCE_IN, FORCE_OUT, LOS, MIRROR_IN, MIRROR_OUT
from los_loop.sampled_loop import sampled_loop
from los_loop.sampled_loop_norms import noise_metrics
from los_testbed.campaign.model_loop import ModelLoop
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import DT, FORCE_STAGES, FRAME_TICKS, MIRROR_STAGES
from titop_plant.telescope.budget import BAND_EDGE, combined_level
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import rpe_weight

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IndexArray = NDArray[np.intp]

TURN = 2.0
"""Angle [rad] between neighbouring frequencies above which the return difference is not resolved."""

NEAR_MAXIMUM = 0.8
"""Share of the largest gain above which a local maximum is followed to its peak."""

CLIMBS = 8
"""Most steps over the grid from a maximum."""

_TONES = np.concatenate([np.linspace(0.0, 6.0, 41), np.linspace(6.5, 20.0, 28)])

NEAR_PEAK = 0.8
"""Share of the largest gain above which gains are exact; below, an upper bound stands in."""

MODEL_METRICS = (
    "ape_gain",
    "slow_tone_mas",
    "fast_tone_mas",
    "rpe_fine_gain",
    "mirror_gain",
    "force_gain",
    "noise_ape_arcsec_rms",
    "noise_rpe_mas_rms",
    "total_mas",
    "sensitivity_mirror",
    "sensitivity_forces",
    "rpe_peak_rad_s",
)
"""Gains over the limits (errors, authorities); worst slow and fast tone of unit norm; noise; what 99.7 % of
the windows keep with the worst tone and the noise; peak sensitivities; frequency of the worst tone."""


@dataclass(frozen=True)
class ModelDepth:
    """Evaluates members of one stage.

    Parameters
    ----------
    model : ModelLoop
    system : UncertainSystem
    parameters : mapping
    controllers : (SampledSystem, SampledSystem)
    stage : {"none", "isolator", "fsm", "fsm+pma"}
    seen : ndarray, shape (F,)
        Weight of the relative error on the grid.
    sigma : ndarray, shape (22,)
        Noise of a sample; of the camera as if every tick had a frame.
    nominal : ndarray, shape (F,)
        Power density of the noise in the line of sight of the nominal loop, on the grid.
    noise : (float, float)
        Noise of the nominal loop [rad rms].
    """

    model: ModelLoop
    system: UncertainSystem
    parameters: Parameters
    controllers: tuple[SampledSystem, SampledSystem]
    stage: str
    seen: FloatArray
    sigma: FloatArray
    nominal: FloatArray
    noise: tuple[float, float]

    @classmethod
    def of(
        cls, system: UncertainSystem, parameters: Parameters, k_fsm: SampledSystem, k_pma: SampledSystem, stage: str
    ) -> ModelDepth:
        """Prepare what the members of a family share."""
        model = ModelLoop.of(system, parameters, k_fsm, k_pma, stage)
        table = parameters["sensors"]
        camera = np.full(2, table["camera_noise"]) * np.sqrt(FRAME_TICKS)
        sigma = np.r_[np.tile(table["accelerometer_noise"], 3), camera, np.full(2, table["strain_gauge_noise"])]
        seen = rpe_weight(model.omega, parameters["weights"]["rpe_window"])
        noise = _exact_noise(system, parameters, (k_fsm, k_pma), stage, {})
        everywhere = np.arange(model.omega.size)
        responses = model.at(model.W({}), everywhere)
        density = _noise_density(responses, model.K, sigma)
        return cls(model, system, parameters, (k_fsm, k_pma), stage, seen, sigma, density, noise)

    def metrics(self, values: Mapping[str, float]) -> dict[str, float]:
        """Metrics by the names of :data:`MODEL_METRICS`; infinite where the loop is unstable.

        Parameters
        ----------
        values : mapping
            Parameter values.

        Raises
        ------
        ValueError
            An LFT that is singular at these values.
        """
        W = self.model.W(values)
        index = self.model.looked_at(W)
        T = self.model.at(W, index)
        if self.stage in MIRROR_STAGES and not self._stable(T, values):
            return {**dict.fromkeys(MODEL_METRICS, float("inf")), "rpe_peak_rad_s": float("nan")}
        plain, noise = self._noise(T, index, values)
        peaks = self._peaks(W, index, T)
        slow, fast = peaks["slow"], peaks["fast"]
        worst, at = max(slow, fast)
        worst, noise = worst / RAD_PER_MAS, noise / RAD_PER_MAS
        weights = self.parameters["weights"]
        found = (
            peaks["los"][0] / weights["ape_limit"],
            slow[0] / RAD_PER_MAS,
            fast[0] / RAD_PER_MAS,
            worst * RAD_PER_MAS / weights["rpe_limit_fine"],
            peaks["mirror"][0] / self.parameters["fsm"]["authority"],
            peaks["force"][0] / self.parameters["pma"]["authority"],
            plain / RAD_PER_ARCSEC,
            noise,
            self.level(worst, noise),
            peaks["sensitivity_mirror"][0] if self.stage in MIRROR_STAGES else 0.0,
            peaks["sensitivity_forces"][0] if self.stage in FORCE_STAGES else 0.0,
            at,
        )
        return dict(zip(MODEL_METRICS, map(float, found)))

    def _gains(self, T: ComplexArray, index: IndexArray) -> dict[str, FloatArray]:
        """Gain of each metric at points of the grid, zero outside of its band."""
        los = largest_gains(T[:, LOS, DISTURBANCE_IN])
        relative, slow = los * self.seen[index], self.model.omega[index] < BAND_EDGE
        found = {"los": los, "slow": np.where(slow, relative, 0.0), "fast": np.where(slow, 0.0, relative)}
        found["mirror"] = largest_gains(T[:, MIRROR_OUT, DISTURBANCE_IN])
        found["force"] = gains_above(T[:, FORCE_OUT, DISTURBANCE_IN], NEAR_PEAK)
        found["sensitivity_mirror"] = largest_gains(T[:, MIRROR_OUT, MIRROR_IN])
        found["sensitivity_forces"] = gains_above(T[:, FORCE_OUT, FORCE_IN], NEAR_PEAK)
        return found

    def _peaks(self, W: FloatArray, index: IndexArray, T: ComplexArray) -> dict[str, tuple[float, float]]:
        """Largest gain of each metric and its frequency: from the highest points uphill over the grid."""
        gains = self._gains(T, index)
        for _ in range(CLIMBS):
            missing = np.unique(np.concatenate([_beside_maxima(index, gain) for gain in gains.values()]))
            missing = missing[(missing >= 0) & (missing < self.model.omega.size)]
            missing = np.setdiff1d(missing, index)
            if not missing.size:
                break
            further = self._gains(self.model.at(W, missing), missing)
            index = np.concatenate([index, missing])
            order = np.argsort(index)
            index = index[order]
            gains = {name: np.concatenate([gain, further[name]])[order] for name, gain in gains.items()}
        return {name: _peak(self.model.omega[index], gain) for name, gain in gains.items()}

    def level(self, tone: float, noise: float) -> float:
        """:func:`titop_plant.telescope.budget.combined_level`, interpolated."""
        if not 0.0 <= tone <= _TONES[-1] * noise:
            return combined_level(tone, noise)
        return noise * float(_levels()(tone / noise))

    def _stable(self, T: ComplexArray, values: Mapping[str, float]) -> bool:
        angle = -np.angle(determinants(T[:, 2:, MIRROR_IN.start :]))
        turn = np.diff(angle, prepend=0.0)
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        if np.abs(turn).max() < TURN and abs(turn.sum()) < np.pi:
            return True
        sensitivity = float(self.parameters["fsm"]["los_sensitivity"])
        closed = sampled_loop(
            self.system.data_at(values),
            *self.controllers,
            loop=self.stage,
            frame_ticks=FRAME_TICKS,
            los_sensitivity=sensitivity,
        )
        return closed.spectral_radius() < 1.0

    def _noise(self, T: ComplexArray, index: IndexArray, values: Mapping[str, float]) -> tuple[float, float]:
        if not np.isfinite(self.noise).all():  # the nominal loop is unstable
            return _exact_noise(self.system, self.parameters, self.controllers, self.stage, values)
        change = _noise_density(T, self.model.K[index], self.sigma) - self.nominal[index]
        omega = self.model.omega[index]
        width = np.diff(omega)

        def power(reference: float, density: FloatArray) -> float:
            return reference**2 + DT / np.pi * float(np.sum(0.5 * (density[1:] + density[:-1]) * width))

        powers = power(self.noise[0], change), power(self.noise[1], change * self.seen[index] ** 2)
        plain, relative = (float(np.sqrt(max(value, 0.0))) for value in powers)
        return plain, relative


def _exact_noise(
    system: UncertainSystem,
    parameters: Parameters,
    controllers: tuple[SampledSystem, SampledSystem],
    stage: str,
    values: Mapping[str, float],
) -> tuple[float, float]:
    loop = "isolator" if stage == "none" else stage
    return noise_metrics(system.data_at(values), *controllers, parameters, loop=loop, frame_ticks=FRAME_TICKS)


def _noise_density(T: ComplexArray, K: ComplexArray, sigma: FloatArray) -> FloatArray:
    """Sum of the squared responses of the line of sight to the noise of each sensor."""
    response = (T[:, LOS, MIRROR_IN.start :] @ K) * sigma
    return np.asarray(np.sum(response.real**2 + response.imag**2, axis=(1, 2)))


@lru_cache(maxsize=1)
def _levels() -> CubicSpline:
    """Level of a tone with noise of 1 rms: the level is homogeneous in both."""
    return CubicSpline(_TONES, [combined_level(float(tone), 1.0) for tone in _TONES])


def _beside_maxima(index: IndexArray, gain: FloatArray) -> IndexArray:
    """Neighbours on the grid of the local maxima above :data:`NEAR_MAXIMUM` of the largest."""
    padded = np.concatenate([[-1.0], gain, [-1.0]])
    top = (gain >= padded[:-2]) & (gain >= padded[2:]) & (gain > NEAR_MAXIMUM * gain.max())
    chosen = index[top]
    return np.concatenate([chosen - 1, chosen + 1])


def _peak(omega: FloatArray, gain: FloatArray) -> tuple[float, float]:
    """Largest gain and its frequency, with the parabola of the inverse square through the three points around it."""
    k = int(np.argmax(gain))
    if not 0 < k < gain.size - 1 or not gain[k] > 0.0:
        return float(gain[k]), float(omega[k])
    x = omega[k - 1 : k + 2] / omega[k] - 1.0
    y = (gain[k] / np.maximum(gain[k - 1 : k + 2], 1e-9 * gain[k])) ** 2 - 1.0
    left, right = y[0] / x[0], y[2] / x[2]
    bend = (right - left) / (x[2] - x[0])
    if not bend > 0.0:
        return float(gain[k]), float(omega[k])
    slope = left - bend * x[0]
    at = float(np.clip(-slope / (2.0 * bend), x[0], x[2]))
    depth = min(max(-(slope * at + bend * at**2), 0.0), 0.3)
    return float(gain[k] / np.sqrt(1.0 - depth)), float(omega[k] * (1.0 + at))
