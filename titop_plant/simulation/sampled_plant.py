"""The telescope as a sampled simulation: one step a tick, nothing allocated.

Commands are held between ticks (zero-order hold). Disturbance tones are not held but integrated exactly
from tick to tick, so tones above half the sampling rate do not alias into the structure::

    x+ = e^(A h) x + B_h v + sum_k Im(G_k p_k),   G_k = (i w_k - A)^-1 (e^(i w_k h) - e^(A h)) B_d a_k
    y  = C x + D v + sum_k Im(D_d a_k p_k) + noise,   p_k+ = e^(i w_k h) p_k

**v is the command computed from the last tick's measurement, in force from this tick to the next.**
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from titop_plant.interface import CAMERA, COLUMNS, COMMANDS, MEASUREMENTS, TRUTH, sample_ticks

_NOISE_BLOCK = 64


@dataclass(frozen=True)
class Segment:
    """Matrices that hold for a stretch of time.

    Parameters
    ----------
    ticks : int
        Length; the last segment goes on for ever.
    step : ndarray, shape (n + 24, n + 8 + 2 K)
        Next state (n), then measurement (22) and
        truth (2) from state, command (8) and the phasors of K tones (real, imaginary in turn).
    turn : ndarray, shape (K,), complex
        e^(i w h) of each tone.
    """

    ticks: int
    step: FloatArray
    turn: ComplexArray


@dataclass(frozen=True)
class SensorModel:
    """Noise, bias and frame rate.

    Parameters
    ----------
    sigma : ndarray, shape (22,)
        Standard deviation of the samples (of a frame for the camera).
    bias : ndarray, shape (22,)
        Added to every sample.
    frame_ticks : int
        Ticks between camera frames; other sensors have the rate of their entry.
    dropout : float
        Probability that a frame is lost (read as NaN).
    seed : int
    """

    sigma: FloatArray
    bias: FloatArray
    frame_ticks: int
    dropout: float
    seed: int


def slow_sensors(frame_ticks: int) -> tuple[tuple[slice, int], ...]:
    """Columns of the sensors beside the camera that are slower than the tick, and their ticks.

    Parameters
    ----------
    frame_ticks : int
        Ticks between camera frames.
    """
    found = ((COLUMNS[name], ticks) for name, ticks in sample_ticks(frame_ticks).items())
    return tuple((columns, ticks) for columns, ticks in found if columns != CAMERA)


class SampledPlant:
    """Telescope with sensors and disturbances, one step a tick.

    Parameters
    ----------
    segments : sequence of Segment
    state : ndarray, shape (n,)
        Initial state.
    sensors : SensorModel
    limits : ndarray, shape (8,)
        Commands are clipped to [-limit, limit]: mirror [rad], actuators [N].
    dt : float
        Sampling period [s].
    tones : ndarray, shape (K,)
        Frequencies of the disturbance at the start [rad/s], for reports.
    parameters_hash : str
        Name of the configuration and its parameter values.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        state: FloatArray,
        sensors: SensorModel,
        limits: FloatArray,
        *,
        dt: float,
        tones: FloatArray,
        parameters_hash: str,
    ) -> None:
        self.dt = dt
        self.frame_ticks = sensors.frame_ticks
        self.tones = tones
        self.parameters_hash = parameters_hash
        self.limits = limits
        self._lowest = -limits
        self._segments = tuple(segments)
        self._start = state.copy()
        self._sensors = sensors
        self._n = n = state.size
        self._z = np.zeros(self._segments[0].step.shape[1])
        self._x, self._v = self._z[:n], self._z[n : n + COMMANDS]
        self._p = self._z[n + COMMANDS :].view(complex)
        self._out = np.zeros(n + MEASUREMENTS + TRUTH)
        self._phasor = np.zeros(self._p.size, complex)
        self._block = np.zeros((_NOISE_BLOCK, MEASUREMENTS))
        self._frame = np.zeros(3)
        self._slow = slow_sensors(self.frame_ticks)
        self.reset()

    def reset(self) -> None:
        """Back to tick 0: same seed, same bits."""
        noise, camera = np.random.SeedSequence(self._sensors.seed).spawn(2)
        self._noise, self._camera = np.random.default_rng(noise), np.random.default_rng(camera)
        self._x[:] = self._start
        self._p[:] = 1.0
        self._noisy = self._disturbed = True
        self._dropout = self._sensors.dropout
        self._v[:] = 0.0
        self.tick = 0
        self._index, self._left = 0, self._segments[0].ticks

    def change(self, name: str, value: float) -> None:
        """Change a setting from the next tick on; a reset undoes it.

        Parameters
        ----------
        name : {"noise", "disturbance", "camera_dropout"}
            Sensor noise (the bias stays); disturbance tones, whose phases go on; probability that a frame is lost.
        value : float
            0 or 1; for the drop-out a probability.

        Raises
        ------
        ValueError
            Another name.
        """
        if name == "noise":
            self._noisy = bool(value)
        elif name == "disturbance":
            if self._disturbed and not value:
                self._phasor[:], self._p[:] = self._p, 0.0
            elif value and not self._disturbed:
                self._p[:] = self._phasor
            self._disturbed = bool(value)
        elif name == "camera_dropout":
            self._dropout = float(value)
        else:
            raise ValueError(f"name must be noise, disturbance or camera_dropout, got {name!r}")

    @property
    def state(self) -> FloatArray:
        """Copy of the present state."""
        return self._x.copy()

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) from this tick on; write `measurement` (22,) and `truth` (2,) of this tick.

        A sensor that is slower than the tick has its sample every so many ticks and NaN otherwise, the camera also for
        a frame that is lost. `truth` is the controlled line of sight without noise or filter [rad].
        """
        n = self._n
        np.minimum(command, self.limits, out=self._v)  # two ufuncs: np.clip takes five times as long
        np.maximum(self._v, self._lowest, out=self._v)
        self._propagate()
        row = self.tick % _NOISE_BLOCK
        if row == 0:
            self._noise.standard_normal(out=self._block)
            self._block *= self._sensors.sigma
        np.add(self._out[n : n + MEASUREMENTS], self._block[row] if self._noisy else 0.0, out=measurement)
        measurement += self._sensors.bias
        truth[:] = self._out[n + MEASUREMENTS :]
        for columns, ticks in self._slow:
            if self.tick % ticks:
                measurement[columns] = np.nan
        if self.tick % self.frame_ticks:
            measurement[CAMERA] = np.nan
        elif self._dropout > 0.0:
            self._camera.random(out=self._frame)
            if self._frame[0] < self._dropout:
                measurement[CAMERA] = np.nan
        self._x[:] = self._out[:n]
        phasor = self._p if self._disturbed else self._phasor
        self._turn(phasor)
        self.tick += 1
        self._left -= 1
        if self._left == 0 and self._index + 1 < len(self._segments):
            self._index += 1
            self._left = self._segments[self._index].ticks

    def push(self, state: FloatArray) -> None:
        """Add `state` (n,) to the present state: what an input that the matrices do not hold did in the last tick."""
        self._x += state

    def _propagate(self) -> None:
        """Next state, measurement and truth from the present state, command and phasors."""
        np.matmul(self._segments[self._index].step, self._z, out=self._out)

    def _turn(self, phasor: ComplexArray) -> None:
        """Phasors of the next tick."""
        np.multiply(phasor, self._segments[self._index].turn, out=phasor)
