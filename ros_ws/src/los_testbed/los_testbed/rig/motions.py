"""Small test motions of a rig, all actuators at once at their own frequencies, and the response of its sensors."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.systems.ports import total_size
from los_testbed.parts.device_contract import Sample
from los_testbed.rig.supervisor import BEYOND_RANGE, NOT_FINITE, Supervisor
from los_testbed.run.loop.tick_clock import TickClock
from titop_plant.interface import COLUMNS, COMMAND_PORTS, DT, FORCES, MEASURED, MEASURED_PORTS, MIRROR, TICK_NS, TRUTH

LINES_EACH, FIRST_HZ, SPACING_HZ = 3, 5.0, 0.5
AXES = total_size(COMMAND_PORTS)
"""Actuators of a rig, each value of a command."""
FREQUENCIES: FloatArray = np.array([FIRST_HZ + SPACING_HZ * k for k in range(LINES_EACH * AXES)])
"""Lines [Hz]: actuator a moves at numbers a, a + 8 and a + 16. All are below half of the camera's usual rate."""

QUIET_S, RAMP_S, MOTION_S = 4.0, 0.5, 4.0
TICKS = round((QUIET_S + 2 * RAMP_S + MOTION_S) / DT)
MIRROR_SHARE, FORCE_SHARE = 0.01, 0.1
"""Largest motion over the limits of the actuators."""

SILENT_TICKS = 1000
FEWEST = 3 * (2 * LINES_EACH * AXES + 2) // 2
"""Samples that a fit of all lines takes at least."""

PHASES = 2 * np.pi * np.random.default_rng(7).random((AXES, LINES_EACH))


def lines_of(actuator: int) -> IntArray:
    """Numbers of the lines of an actuator, (3,)."""
    return np.array(range(actuator, LINES_EACH * AXES, AXES), int)


def motion(seconds: float, peaks: FloatArray) -> FloatArray:
    """Command (8,) [rad, N] at a time after the quiet part; `peaks` (8,) are not exceeded."""
    level = np.clip(min(seconds, 2 * RAMP_S + MOTION_S - seconds) / RAMP_S, 0.0, 1.0)
    angles = 2 * np.pi * FREQUENCIES.reshape(LINES_EACH, AXES).T * seconds + PHASES
    return np.asarray(level / LINES_EACH * peaks * np.sin(angles).sum(axis=1))


@dataclass(frozen=True)
class MotionRecord:
    """Commands and samples, times [s] from the beginning of the motion.

    Attributes
    ----------
    commands : times (n,), values (n, 8)
    samples : port to times of acquisition (m,), values (m, size), ages when they were read (m,) [s]
    not_finite : samples left out for a value that is not finite, by port
    beyond_range : samples left out for a value that no such sensor has, by port
    """

    commands: tuple[FloatArray, FloatArray]
    samples: dict[str, tuple[FloatArray, FloatArray, FloatArray]]
    not_finite: dict[str, int]
    beyond_range: dict[str, int]

    @property
    def longest_pause_ms(self) -> float:
        """Between two commands [ms]."""
        return float(1e3 * np.diff(self.commands[0]).max())


def record(
    supervisor: Supervisor, peaks: FloatArray, clock: Any = None, now: Callable[[], int] | None = None
) -> MotionRecord:
    """Excite an open device and record its sensors; it is closed afterwards, with mirror and forces at zero.

    Parameters
    ----------
    supervisor : Supervisor
    peaks : (8,) [rad, N]
    clock, now : TickClock, callable
        Clock of the ticks, and the steady clock [ns]; others for a device without real time.

    Raises
    ------
    DeviceError
        The device failed, gave no sample for a second, or could not be set to zero.
    """
    try:
        return _recorded(supervisor, peaks, clock, now)
    finally:
        supervisor.finish()


def _recorded(supervisor: Supervisor, peaks: FloatArray, clock: Any, now: Callable[[], int] | None) -> MotionRecord:
    """The motion itself."""
    ticks, steady = clock or TickClock(TICK_NS), now or time.monotonic_ns
    first = steady()
    ticks.begin(first)
    start = first + round(1e9 * QUIET_S)
    written: list[tuple[float, FloatArray]] = []
    samples: list[tuple[Sample, int]] = []
    silent = 0
    while (present := steady()) < first + TICKS * TICK_NS:
        command = motion((present - start) * 1e-9, peaks)
        supervisor.write(command, present)
        written.append(((present - start) * 1e-9, command))
        came = supervisor.samples(present)
        samples += [(sample, present) for sample in came]
        silent = 0 if came else silent + 1
        if silent > SILENT_TICKS:
            odd = [port for port in MEASURED if supervisor.counts[f"{NOT_FINITE}{port}"]]
            what = f"{', '.join(odd)} not finite, no other sample" if odd else "no sample"
            raise supervisor.failed(f"{what} for {SILENT_TICKS} ms")
        ticks.wait()
    supervisor.write(np.zeros(AXES), steady())
    return MotionRecord(
        (np.array([t for t, _ in written]), np.array([u for _, u in written])),
        {port: _of_port(samples, port, start) for port in MEASURED},
        {port: supervisor.counts[f"{NOT_FINITE}{port}"] + _empty_frames(samples, port) for port in MEASURED},
        {port: supervisor.counts[f"{BEYOND_RANGE}{port}"] for port in MEASURED},
    )


def _empty_frames(samples: Sequence[tuple[Sample, int]], port: str) -> int:
    """Frames without a value."""
    return sum(sample.port == port and not np.isfinite(sample.values).all() for sample, _ in samples)


def _of_port(samples: Sequence[tuple[Sample, int]], port: str, start: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    size = COLUMNS[port].stop - COLUMNS[port].start
    finite = [(s, read) for s, read in samples if s.port == port and np.isfinite(s.values).all()]
    times = np.array([(s.acquired_ns - start) * 1e-9 for s, _ in finite])
    values = np.array([s.values for s, _ in finite]).reshape(-1, size)
    ages = np.array([(read - s.acquired_ns) * 1e-9 for s, read in finite])
    order = np.argsort(times, kind="stable")
    return times[order], values[order], ages[order]


def amplitudes(times: FloatArray, values: FloatArray, start: float) -> ComplexArray:
    """Complex amplitudes (n, 24) at the lines, of values (m, n) from `start` [s] on for the length of the motion.

    Fit with a Hann window, beside a constant and a slope; NaN where there are too few samples. Amplitudes are those of
    ``Re(a exp(i w t))``.
    """
    inside = (times >= start) & (times <= start + MOTION_S)
    t = times[inside]
    if len(t) < FEWEST:
        return np.full((values.shape[1], len(FREQUENCIES)), np.nan + 0j)
    angles = 2 * np.pi * np.outer(t, FREQUENCIES)
    basis = np.hstack([np.cos(angles), -np.sin(angles), np.ones((len(t), 1)), (t[:, None] - start) / MOTION_S])
    window = np.sin(np.pi * (t - start) / MOTION_S)[:, None]
    fitted = linalg.lstsq(window * basis, window * values[inside])[0]
    n = len(FREQUENCIES)
    return np.asarray((fitted[:n] + 1j * fitted[n : 2 * n]).T)


def held(commands: tuple[FloatArray, FloatArray], start: float) -> tuple[FloatArray, FloatArray]:
    """Times and commands on the grid of the ticks, of commands that are held."""
    times = np.array([start + DT * k for k in range(round(MOTION_S / DT))])
    index = np.searchsorted(commands[0], times, side="right") - 1
    return times, commands[1][np.maximum(index, 0)]


def scatter(values: FloatArray) -> FloatArray:
    """Noise of a sample (n,), from third differences, which cancel slow motion."""
    if len(values) < 10:
        return np.full(values.shape[1], np.nan)
    third = np.diff(values, 3, axis=0) / np.sqrt(20.0)
    low, high = np.percentile(third, [15.87, 84.13], axis=0)
    return np.asarray((high - low) / 2)


def peaks_of(authority: tuple[float, float], scale: float = 1.0) -> FloatArray:
    """Peaks (8,) of the motion: shares of the limits of angle [rad] and force [N], times `scale`."""
    peaks = np.zeros(AXES)
    peaks[MIRROR], peaks[FORCES] = scale * MIRROR_SHARE * authority[0], scale * FORCE_SHARE * authority[1]
    return peaks


@dataclass(frozen=True)
class ModelResponse:
    """Response of the simulated telescope.

    Attributes
    ----------
    gains : (22, 8, 24), complex amplitude of each value over that of each command, at each line
    noise : (22,), noise of a sample alone
    disturbed : (22,), the same with the disturbance of the configuration
    """

    gains: ComplexArray
    noise: FloatArray
    disturbed: FloatArray


def model_response(plant: Any, peaks: FloatArray) -> ModelResponse:
    """Response of a :class:`los_testbed.parts.stepped_plant.SteppedPlant` that knows `change`."""
    gains = np.zeros((total_size(MEASURED_PORTS), AXES, len(FREQUENCIES)), complex)
    ticks = round((RAMP_S + MOTION_S) / DT)
    course = np.array([_all_lines(DT * k) for k in range(ticks)])
    times = np.array([DT * k for k in range(ticks)])
    moved = amplitudes(times, course[:, None], RAMP_S)[0]
    for b in range(AXES):
        unit = np.zeros(AXES)
        unit[b] = peaks[b]
        seen = simulated(plant, course[:, None] * unit, noise=0.0, disturbance=0.0)
        for port in MEASURED:
            there = np.isfinite(seen[:, COLUMNS[port]]).all(axis=1)
            gains[COLUMNS[port], b] = amplitudes(times[there], seen[there, COLUMNS[port]], RAMP_S) / (moved * peaks[b])
    still = np.zeros((round(QUIET_S / DT / 2), AXES))
    alone, disturbed = (simulated(plant, still, noise=1.0, disturbance=level) for level in (0.0, 1.0))
    return ModelResponse(gains, _scatters(alone), _scatters(disturbed))


def _all_lines(seconds: float) -> float:
    level = min(seconds / RAMP_S, 1.0) / len(FREQUENCIES)
    return float(level * np.sum(np.sin(2 * np.pi * FREQUENCIES * seconds + PHASES.T.ravel())))


def _scatters(seen: FloatArray) -> FloatArray:
    measured = [seen[np.isfinite(seen[:, COLUMNS[port]]).all(axis=1), COLUMNS[port]] for port in MEASURED]
    return np.concatenate([scatter(values) for values in measured])


def simulated(plant: Any, commands: FloatArray, noise: float, disturbance: float) -> FloatArray:
    """Measurements (n, 22) of a plant under commands (n, 8); NaN where a sensor has no sample."""
    plant.reset()
    plant.change("noise", noise)
    plant.change("disturbance", disturbance)
    seen, truth = np.empty((len(commands), total_size(MEASURED_PORTS))), np.empty(TRUTH)
    for command, row in zip(commands, seen):
        plant.step(command, row, truth)
    plant.reset()
    return seen
