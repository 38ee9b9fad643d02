"""Transmissibility of a stage at the frequencies of the disturbance, measured and modelled.

The disturbance of a run is a set of tones, each on several of the 22 channels at once. For each tone

    measured = amplitude fitted to the recorded line of sight / amplitude of the disturbance
    model    = |H(i w) a| / |a|,  H the response of the implemented loop

with the norm of both axes above and the norm of the 22 channels below, **forces in N and torques in Nm
weighted equally**. Of the record the model uses the tones only.

H is exact: plant sampled with the tones integrated, commands one tick late, zero-order hold of the values of slower
sensors. The hold makes the loop periodic; the response to a tone is the tone times a function with the period of N
ticks, and H is the mean of that function, which is what a fit of the tone to the record gives.

H is the steady state, in which a run starts unless it is told to start at rest. The model is also simulated from the
start of the run, with the limits of the commands, and its record fitted in the same way (`expected`). It differs from H
after a start at rest, where a record of seconds shows the slow decay of lightly damped modes, and at the limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import NONE, Delays, SampledLoop
from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.metrics import samples_or_one
from pointing_analysis.indices.weights import rpe_discrete
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import exposure_of_run
from pointing_analysis.spectra.prediction import ToneComparison
from pointing_analysis.spectra.spectra import SpectralLine, background, lines
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import DT, FORCES, MIRROR, TRUTH
from titop_plant.simulation.build import PlantConfig, PlantFamily
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant_step import tone_step

SAME = 1e-12
"""Relative difference of frequencies up to which two tones are one: that of rounding, for instance of two wheels of
the same speed."""


@dataclass(frozen=True)
class StageTones:
    """One tone of the disturbance and the response of the line of sight.

    Parameters
    ----------
    omega : float
        rad/s.
    disturbance : float
        Norm of the amplitudes on the 22 channels [N, Nm].
    measured, expected, model : float
        Amplitude of the line of sight [rad], norm of both axes: in the record; in the simulated record from the
        same start; of the model in steady state.
    """

    omega: float
    disturbance: float
    measured: float
    expected: float
    model: float

    def as_dict(self) -> dict[str, float]:
        """Values for JSON: transmissibility in mas per N."""
        scale = self.disturbance * RAD_PER_MAS
        return {
            "rad_s": round(self.omega, 6),
            "disturbance_n": float(f"{self.disturbance:.6g}"),
            "measured_mas_per_n": float(f"{self.measured / scale:.5g}"),
            "model_same_start_mas_per_n": float(f"{self.expected / scale:.5g}"),
            "model_settled_mas_per_n": float(f"{self.model / scale:.5g}"),
        }


@dataclass(frozen=True)
class ToneModel:
    """The implemented loop with the tones of a run.

    Parameters
    ----------
    loop : SampledLoop
        Of this plant, in its coordinates.
    plant : ModalPlant
    omega : ndarray, shape (K,)
        Frequencies [rad/s], rising.
    amplitude : ndarray, shape (22, K), complex
        Phasors on the disturbance inputs [N, Nm].
    limits : ndarray, shape (u,)
        Largest commands: mirror [rad], other actuators [N, Nm].
    steady : bool
        Whether a run starts in the steady state of the loop, or at rest.
    """

    loop: SampledLoop
    plant: ModalPlant
    omega: FloatArray
    amplitude: ComplexArray
    limits: FloatArray
    steady: bool = True

    @classmethod
    def of(
        cls,
        family: PlantFamily,
        physical: PlantConfig,
        controllers: Mapping[str, SampledSystem],
        *,
        loop: str,
        authority: tuple[float, float],
        steady: bool = True,
        delays: Delays = NONE,
    ) -> ToneModel:
        """Model of a run. Tones of the same frequency are added up as phasors.

        Parameters
        ----------
        family : PlantFamily
            Of the telescope, with the sensors and actuators of the loop.
        physical : PlantConfig
            Member of the family and disturbance of the run.
        controllers : mapping
            ``k_fsm`` and ``k_pma``.
        loop : {"none", "isolator", "fsm", "fsm+pma"}
            Stage.
        authority : (float, float)
            Largest commands of the run: mirror [rad], actuators [N].
        steady : bool
            As the attribute.
        delays : Delays
            Of a rig.

        Raises
        ------
        ValueError
            A telescope outside its family.
        """
        data, tones = family.plant_and_tones(physical)
        plant = ModalPlant.of(data, family.ports.commands)
        sensitivity = family.telescope.fsm.los_sensitivity
        laws = ControlLaws(controllers["k_fsm"], controllers["k_pma"], loop, family.ports, sensitivity)
        closed = sampled_loop(plant, laws, delays=delays)
        limits = family.ports.limits
        for columns, limit in zip((MIRROR, FORCES), authority):
            limits[columns] = np.minimum(limits[columns], limit)
        return cls(closed, plant, *_together(tones), limits, steady)

    def with_tones(self, tones: Tones) -> ToneModel:
        """The same loop under other tones."""
        omega, amplitude = _together(tones)
        return replace(self, omega=omega, amplitude=amplitude)

    def forcing(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Forcing by unit phasors: of the next state with all sensors and none (n, K), of the line of sight."""
        drive, measured, through = self._entries()
        frame, hold = (drive + N @ measured for N in (self.loop.noise_frame, self.loop.noise_hold))
        return np.asarray(frame, complex), np.asarray(hold, complex), through

    def _entries(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """What unit phasors add to the next state of the plant (n, K), to what is sensed, to the line of sight."""
        n, size = self.plant.order, self.loop.hold.shape[0]
        zeros = np.zeros(self.omega.size)
        tones = Tones(self.omega, self.amplitude, zeros, zeros.astype(np.int64))
        moved, seen = tone_step(self.plant, tones)
        drive = np.zeros((size, self.omega.size), complex)
        drive[:n] = moved
        return drive, seen[:-TRUTH], seen[-TRUTH:]

    def _ticks(self) -> tuple[list[tuple[FloatArray, ComplexArray]], ComplexArray]:
        """Matrix and forcing of each tick of a period, and forcing of the line of sight."""
        drive, measured, through = self._entries()
        return self.loop.each_tick(lambda A, N: (A, np.asarray(drive + N @ measured, complex))), through

    def settled(self) -> ComplexArray:
        """Amplitudes of the line of sight in steady state [rad], shape (2, K), mean over a period."""
        _, total, through = self._period(self.phasors())
        return np.asarray(total / self.loop.frame_ticks + through, dtype=np.complex128)

    def relative_error(self, window: float) -> float:
        """Relative error in windows [s] in steady state: root mean square of both axes together [rad]."""
        amplitude = np.sqrt(np.sum(np.abs(self.settled()) ** 2, axis=0))
        weights = rpe_discrete(self.omega, samples_or_one(window, DT), DT)
        return float(np.sqrt(np.sum((weights * amplitude) ** 2) / 2.0))

    def phasors(self) -> ComplexArray:
        """State of the loop at tick 0 in steady state, shape (n, K): of tone k the imaginary part of column k.

        The period is solved exactly: no mode is left to decay. Computed once; the array cannot be written to.
        """
        return self._phasors

    @cached_property
    def _phasors(self) -> ComplexArray:
        loop, size = self.loop, self.loop.hold.shape[0]
        forced, _, _ = self._period(np.zeros((size, self.omega.size), complex))
        start = loop.steady_state(self.omega, forced)
        start.flags.writeable = False
        return start

    def _period(self, state: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """State after a period, sum of the line of sight over it, its direct part; per unit of the phasors."""
        ticks, through = self._ticks()
        turn, total = np.exp(1j * self.omega * DT), np.zeros((2, self.omega.size), complex)
        for k, (A, drive) in enumerate(ticks):
            total += _times(self.loop.truth, state) / turn**k
            state = _times(A, state) + drive * turn**k
        return state, total, through

    def record(self, ticks: int) -> FloatArray:
        """Line of sight [rad], shape (ticks, 2), from the start of a run, commands limited."""
        n, loop = self.plant.order, self.loop
        each, through = self._ticks()
        los = np.empty((ticks, 2))
        state = self.phasors().imag.sum(axis=1) if self.steady else np.zeros(loop.hold.shape[0])
        force = slice(n, n + self.limits.size)
        np.clip(state[force], -self.limits, self.limits, out=state[force])
        for k in range(ticks):
            phasor = np.exp(1j * self.omega * DT * k)
            los[k] = loop.truth @ state + (through @ phasor).imag
            A, forcing = each[k % loop.frame_ticks]
            state = A @ state + (forcing @ phasor).imag
            np.clip(state[force], -self.limits, self.limits, out=state[force])
        return los


def _times(matrix: FloatArray, columns: ComplexArray) -> ComplexArray:
    """Product of a real matrix and complex columns; numpy would make the matrix complex first."""
    return np.asarray((matrix @ np.ascontiguousarray(columns).view(float)).view(complex))


def _together(tones: Tones) -> tuple[FloatArray, ComplexArray]:
    """Frequencies (K,), rising, and phasors (22, K); tones of the same frequency, but for rounding, are added up."""
    every = np.unique(tones.frequency)
    omega = every[np.diff(every, prepend=-np.inf) > SAME * every]
    own = np.searchsorted(omega, tones.frequency, side="right") - 1
    amplitude = np.zeros((tones.amplitude.shape[0], omega.size), complex)
    for k in range(omega.size):
        amplitude[:, k] = tones.amplitude[:, own == k].sum(axis=1)
    present = (omega > 0) & (np.linalg.norm(amplitude, axis=0) > 0)
    return np.asarray(omega[present]), np.asarray(amplitude[:, present])


def compare_tones(
    run: Run, model: ToneModel, transient: float | None = None, stop: float = math.inf
) -> tuple[tuple[ToneComparison, ...], tuple[float, float]]:
    """Amplitudes in the record and in the simulated record from the same start, and the fitted part of the run [s].

    Both are fitted with Hann weights: drift, noise and the images of other tones in the camera's frames stay out of a
    tone. Tones that the run cannot resolve are fitted as one in both; those beyond half the sampling rate and those
    with less than 2.5 periods are omitted.

    Parameters
    ----------
    run : Run
        Its first sample is the first tick of the run.
    model : ToneModel
    transient : float, optional
        Seconds of start-up to omit.
    stop : float
        End of the fitted part [s]. The simulation costs a step of Python for each tick before it.
    """
    series = performance_error(run, transient)
    first = round(series.start / series.dt)
    measured = series.values[: max(0, round(min(stop, 1e9) / series.dt) - first)]
    if not len(measured):
        return (), (series.start, series.start)
    with one_thread(), np.errstate(all="ignore"):
        record = model.record(first + len(measured))[first:]
        if not np.isfinite(record).all():
            raise InputError("the model of the loop diverges")
        window = exposure_of_run(run)
        pairs = [lines(values, series.dt, model.omega, window) for values in (measured, record)]
        expected = {line.omega: line.phasor for line in pairs[1]}
        found = [line for line in pairs[0] if line.omega in expected]
        predicted = np.array([expected[line.omega] for line in found]).reshape(-1, 2)
        noise = background(measured - record, series.dt, [line.omega for line in found], predicted)
    seconds = (series.start, series.start + series.dt * len(measured))
    return _comparisons(found, predicted, noise), seconds


def _comparisons(
    found: Sequence[SpectralLine], predicted: ComplexArray, noise: FloatArray
) -> tuple[ToneComparison, ...]:
    """Measured lines, predicted phasors (k, 2) and noise along and across them (k, 2); without noise there is none."""
    tones = [
        ToneComparison(
            line.omega, line.merged, float(expected), float(np.linalg.norm(line.phasor)), *map(float, beside)
        )
        for line, expected, beside in zip(found, np.linalg.norm(predicted, axis=1), noise)
        if not np.isnan(beside).any()
    ]
    return tuple(sorted(tones, key=lambda tone: tone.omega))


def compare_settled(
    run: Run, omega: FloatArray, settled: ComplexArray, transient: float | None = None
) -> tuple[tuple[ToneComparison, ...], tuple[float, float]]:
    """Amplitudes in the record and of the settled loop, for a run whose start is not known; otherwise `compare_tones`.

    Parameters
    ----------
    run : Run
    omega : ndarray, shape (K,)
        Frequencies in the record [rad/s].
    settled : ndarray, shape (2, K), complex
        Amplitudes of the line of sight [rad]. Tones that the run cannot resolve are omitted.
    transient : float, optional
        Seconds of start-up to omit.
    """
    series = performance_error(run, transient)
    with one_thread():
        fitted = lines(series.values, series.dt, omega, exposure_of_run(run))
        found = [line for line in fitted if line.merged == 1]
        predicted = np.array([settled[:, np.argmin(np.abs(omega - line.omega))] for line in found]).reshape(-1, 2)
        noise = background(series.values, series.dt, [line.omega for line in found], predicted)
    return _comparisons(found, predicted, noise), (series.start, series.start + series.duration)


def tone_responses(run: Run, model: ToneModel, transient: float | None = None) -> tuple[StageTones, ...]:
    """Measured and modelled response at each tone of a run.

    Tones that the run cannot resolve are omitted, and those beyond half the sampling rate.
    """
    with one_thread():
        settled = np.linalg.norm(model.settled(), axis=0)
    disturbance = np.linalg.norm(model.amplitude, axis=0)
    found = []
    for tone in compare_tones(run, model, transient)[0]:
        k = int(np.argmin(np.abs(model.omega - tone.omega)))
        if tone.merged == 1:
            fitted = tone.measured, tone.predicted
            found.append(StageTones(float(model.omega[k]), float(disturbance[k]), *fitted, float(settled[k])))
    return tuple(found)
