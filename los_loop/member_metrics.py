"""Metrics of a member of a family from its responses: gains, tones, noise, margins and stability, without a run.

Everything is read from the responses of :class:`los_loop.member_loop.MemberLoop` at about 300 frequencies:

* **Gains.** Largest singular values; between three points of the grid around a maximum the inverse square of the gain
  is a parabola (exactly so for one mode), whose vertex is the peak. Sidebands of the camera's frame rate are left out.
* **Noise.** That of the nominal loop is exact (:func:`los_loop.noise.noise_covariances`); what a member
  changes is the integral of the difference of the two power densities.
* **Stability.** The telescope without fine control is stable, so the loop is stable if the return difference
  ``det(I - K P) = 1 / det(S)`` does not encircle the origin. Where its angle turns by more than :data:`TURN` from one
  frequency to the next, or where it does encircle it, the eigenvalues of the sampled loop decide.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit import SampledSystem
from lftkit.analysis.batched_linalg import determinants, gains_above, largest_gains
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from los_loop.figures_of_merit import FigureOfMerit, figure, gain_figures
from los_loop.implemented_loop import ImplementedLoop
from los_loop.member_loop import MemberLoop
from los_loop.noise import noise_covariances, noise_rms
from los_loop.spec import LOS_ROWS
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import DT, MIRROR_STAGES, STAGES
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight, window_ratio
from titop_plant.telescope.window_noise import ON_AXIS, WindowNoise, combined_level

TURN = 2.0
"""Angle [rad] between neighbouring frequencies above which the return difference is not resolved."""

NEAR_MAXIMUM = 0.8
"""Share of the largest gain above which a local maximum is followed to its peak."""

CLIMBS = 8
"""Most steps over the grid from a maximum."""


NEAR_PEAK = 0.8
"""Share of the largest gain above which gains are exact; below, an upper bound stands in."""


def gain_column(row: FigureOfMerit) -> str:
    """Column of a gain: relative errors are in mas, sensitivities as they are, others over their limits.

    Examples
    --------
    >>> [gain_column(row) for row in gain_figures("fsm+pma")][2:5]
    ['fast_tone_mas', 'mirror_gain', 'sensitivity_mirror']
    """
    stem = re.sub("[^a-z0-9]+", "_", row.name.lower())
    return stem if row.is_sensitivity else f"{stem}_tone_mas" if row.is_error and row.relative else f"{stem}_gain"


def metric_names() -> tuple[str, ...]:
    """Columns: the gains of the last stage's figures; noise; the level of the worst tone and the noise."""
    rows = gain_figures(STAGES[-1])
    errors = [gain_column(row) for row in rows if row.is_error]
    others = [gain_column(row) for row in rows if not (row.is_error or row.is_sensitivity)]
    peaks = [gain_column(row) for row in rows if row.is_sensitivity]
    noise = "noise_ape_arcsec_rms", "noise_rpe_mas_rms"
    return (*errors, "rpe_fine_gain", *others, *noise, "total_mas", *peaks, "rpe_peak_rad_s")


@dataclass(frozen=True)
class MemberMetrics:
    """Evaluates members of one stage.

    Parameters
    ----------
    model : MemberLoop
    seen : ndarray, shape (F,)
        Weight of the relative error on the grid.
    sigma : ndarray, shape (measurements,)
        Noise of a sample; of the camera as if every tick had a frame.
    nominal : ndarray, shape (F,)
        Power density of the noise in the line of sight of the nominal loop, on the grid.
    noise : (float, float)
        Noise of the nominal loop [rad rms].
    """

    model: MemberLoop
    seen: FloatArray
    sigma: FloatArray
    nominal: FloatArray
    noise: tuple[float, float]

    @classmethod
    def of(cls, telescope: Telescope, k_fsm: SampledSystem, k_pma: SampledSystem, stage: str) -> MemberMetrics:
        """Prepare what the members of a telescope's family share.

        Parameters
        ----------
        telescope : Telescope
        k_fsm, k_pma : SampledSystem
            Also with further sensors and actuators of the telescope.
        stage : {"none", "isolator", "fsm", "fsm+pma"}
        """
        model = MemberLoop.of(telescope, k_fsm, k_pma, stage)
        sigma = model.loop.ports.noise_of_ticks
        seen = rpe_weight(model.omega, telescope.weights.rpe_window)
        noise = _exact_noise(model.loop, {})
        everywhere = np.arange(model.omega.size)
        responses = model.at(model.W({}), everywhere)
        density = _noise_density(responses, model.control, sigma)
        return cls(model, seen, sigma, density, noise)

    @property
    def telescope(self) -> Telescope:
        """Of the model."""
        return self.model.loop.telescope

    @property
    def stage(self) -> str:
        """Stage of the loop."""
        return self.model.loop.stage

    def metrics(self, values: Mapping[str, float]) -> dict[str, float]:
        """Metrics by the names of :func:`metric_names`; infinite where the loop is unstable.

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
            return {**dict.fromkeys(metric_names(), float("inf")), "rpe_peak_rad_s": float("nan")}
        plain, noise = self._noise(T, index, values)
        rows, peaks = gain_figures(STAGES[-1]), self._peaks(W, index, T)
        relative = [peaks[row.name] for row in rows if row.is_error and row.relative]
        worst, at = max(relative)
        noise, total = noise / RAD_PER_MAS, 0.0
        for peak, omega in sorted(relative, reverse=True):
            total = self.level(peak / RAD_PER_MAS, noise, omega, total)
        found = {
            **{gain_column(row): self._shown(row, peaks[row.name][0]) for row in rows},
            "rpe_fine_gain": worst / figure("RPE").limit(self.telescope, STAGES[-1]),
            "noise_ape_arcsec_rms": plain / RAD_PER_ARCSEC,
            "noise_rpe_mas_rms": noise,
            "total_mas": total,
            "rpe_peak_rad_s": at,
        }
        return {name: float(found[name]) for name in metric_names()}

    def _shown(self, row: FigureOfMerit, peak: float) -> float:
        """A gain as its column has it; a sensitivity of a loop that is not closed is zero."""
        if row.is_sensitivity:
            return peak if self.stage in row.stages else 0.0
        return peak / (RAD_PER_MAS if row.is_error and row.relative else row.limit(self.telescope, self.stage))

    def _gains(self, T: ComplexArray, index: IntArray) -> dict[str, FloatArray]:
        """Gain of each figure at points of the grid, zero outside of its band."""
        omega, found, plain = self.model.omega[index], {}, dict[tuple[str, ...], FloatArray]()
        ports = self.model.loop.ports
        for row in gain_figures(STAGES[-1]):
            place = (row.output, *row.inputs)
            if place not in plain:
                part = T[:, ports.rows_of(row.output), ports.columns_of(row.inputs[0])]
                plain[place] = largest_gains(part) if part.shape[1] <= 2 else gains_above(part, NEAR_PEAK)
            gain = plain[place] * self.seen[index] if row.relative else plain[place]
            low, high = row.band_of(self.telescope)
            found[row.name] = np.where((omega >= low) & (omega < high), gain, 0.0)
        return found

    def _peaks(self, W: FloatArray, index: IntArray, T: ComplexArray) -> dict[str, tuple[float, float]]:
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

    def level(self, tone: float, noise: float, omega: float, least: float = 0.0) -> float:
        """:func:`titop_plant.telescope.window_noise.combined_level` of windows with a weighted tone, `least` or more.

        The noise has the spectrum of the nominal member.
        """
        turn = omega * self.telescope.weights.rpe_window
        in_windows = tone * float(window_ratio(turn))
        return combined_level(
            in_windows, self._window_noise.changed(noise), self.telescope.window_probability, turn, least=least
        )

    @cached_property
    def _window_noise(self) -> WindowNoise:
        if not np.isfinite(self.noise).all() or not self.nominal.any():
            return WindowNoise(0.0)
        omega, power = self.model.omega, self.nominal * self.seen**2
        powers = 0.5 * (power[1:] + power[:-1]) * np.diff(omega)
        turns = 0.5 * (omega[1:] + omega[:-1]) * self.telescope.weights.rpe_window
        return WindowNoise.of_spectrum(self.noise[1], ON_AXIS, turns, powers)

    def _stable(self, T: ComplexArray, values: Mapping[str, float]) -> bool:
        ports = self.model.loop.ports
        angle = -np.angle(determinants(T[:, ports.applied, ports.added]))
        turn = np.diff(angle, prepend=0.0)
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        if np.abs(turn).max() < TURN and abs(turn.sum()) < np.pi:
            return True
        return self.model.loop.sampled_at(values)[1].spectral_radius() < 1.0

    def _noise(self, T: ComplexArray, index: IntArray, values: Mapping[str, float]) -> tuple[float, float]:
        if not np.isfinite(self.noise).all():  # the nominal loop is unstable
            return _exact_noise(self.model.loop, values)
        change = _noise_density(T, self.model.control[index], self.sigma) - self.nominal[index]
        omega = self.model.omega[index]
        width = np.diff(omega)

        def power(reference: float, density: FloatArray) -> float:
            return reference**2 + DT / np.pi * float(np.sum(0.5 * (density[1:] + density[:-1]) * width))

        powers = power(self.noise[0], change), power(self.noise[1], change * self.seen[index] ** 2)
        plain, relative = (float(np.sqrt(max(value, 0.0))) for value in powers)
        return plain, relative


def _exact_noise(loop: ImplementedLoop, values: Mapping[str, float]) -> tuple[float, float]:
    return noise_rms(noise_covariances(loop.system.at(values), *loop.pair, loop.telescope, loop=loop.stage))


def _noise_density(T: ComplexArray, K: ComplexArray, sigma: FloatArray) -> FloatArray:
    """Sum of the squared responses of the line of sight to the noise of each sensor."""
    response = (T[:, LOS_ROWS, -K.shape[1] :] @ K) * sigma
    return np.asarray(np.sum(response.real**2 + response.imag**2, axis=(1, 2)))


def _beside_maxima(index: IntArray, gain: FloatArray) -> IntArray:
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


__all__ = ["MemberMetrics", "gain_column", "metric_names"]
