"""The telescope as a sampled simulation: one step a tick, nothing allocated.

The arithmetic of a tick, its coordinates and its order are those of :mod:`titop_plant.simulation.plant_step`.
:meth:`SampledPlant.step` computes them with numpy, or, after :meth:`SampledPlant.compile`, with the compiled code of
:mod:`titop_plant.simulation.kernel`, which also runs whole loops (:mod:`los_testbed.loop.compiled_loop`). **All of them
have the same bits.**
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.systems.sampled.ordered_product import OrderedProduct
from titop_plant.interface import CAMERA, COLUMNS, COMMANDS, MEASUREMENTS, TRUTH, sample_ticks
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.kernel_arrays import Course, SensorArrays, StepArrays
from titop_plant.simulation.plant_step import PlantStep

_NOISE_BLOCK = 64


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
    step : PlantStep
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
        step: PlantStep,
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
        self._step = step
        self._start = self.coordinates(state)
        self._sensors = sensors
        self._n, plain = step.order, len(step.own)
        self._outputs, self._block = OrderedProduct(step.outputs.T), OrderedProduct(step.block.T)
        self._values = self._outputs.values
        self._phasor = np.zeros(step.turn.size)
        self._terms = np.zeros((2 + len(step.driven), max(plain, 2)))
        self._later, self._sums = np.zeros(max(self._n, 2)), np.zeros(step.outputs.shape[1])
        self.sensed = np.zeros(self._sums.size - MEASUREMENTS - TRUTH)
        """Values of the further sensors at the last tick, without noise."""
        self._noise_block = np.zeros((_NOISE_BLOCK, MEASUREMENTS))
        self._frame = np.zeros(3)
        self._slow = slow_sensors(self.frame_ticks)
        self._arrays = self._numbers()
        self._compiled = False
        self.reset()

    def reset(self) -> None:
        """Back to tick 0: same seed, same bits."""
        noise, camera = np.random.SeedSequence(self._sensors.seed).spawn(2)
        self._noise, self._camera = np.random.default_rng(noise), np.random.default_rng(camera)
        self._values[:] = 0.0
        self._begin()
        self._values[: self._n] = self._start - self._steady
        self._noisy = self._disturbed = True
        self._dropout = self._sensors.dropout
        self.tick = 0

    def _begin(self) -> None:
        """Phasors at tick 0."""
        self._phasors[0::2] = 1.0

    def compile(self) -> None:
        """Step with compiled code from now on, if there is any: the same bits in less time."""
        self._compiled = kernel() is not None
        before = self._values.copy()
        self._propagate()  # numba reads or makes the code at the first call, which must not be a tick of a run
        self._values[:] = before

    @property
    def _phasors(self) -> FloatArray:
        """Phasors of this tick, real and imaginary parts in turn."""
        return self._values[self._n + COMMANDS :]

    @property
    def _steady(self) -> FloatArray:
        """Coordinates of the steady motion at this tick, shape (n,)."""
        return np.asarray((self._step.steady * self._phasors.view(complex)).imag.sum(axis=1))

    def coordinates(self, states: FloatArray) -> FloatArray:
        """States (n,) or (n, k) in the coordinates of :meth:`push`."""
        columns = states[:, None] if states.ndim == 1 else states
        return np.asarray(self._step.form.excited(columns).reshape(states.shape))

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
            moved = self._values[: self._n]
            if self._disturbed and not value:
                moved += self._steady  # what the tones have moved goes on freely
                self._phasor[:], self._phasors[:] = self._phasors, 0.0
            elif value and not self._disturbed:
                self._phasors[:] = self._phasor
                moved -= self._steady
            self._disturbed = bool(value)
        elif name == "camera_dropout":
            self._dropout = float(value)
        else:
            raise ValueError(f"name must be noise, disturbance or camera_dropout, got {name!r}")

    @property
    def state(self) -> FloatArray:
        """Present state, shape (n,)."""
        return np.asarray(self._step.form.basis @ (self._values[: self._n] + self._steady))

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) from this tick on; write `measurement` (22,) and `truth` (2,) of this tick.

        A sensor that is slower than the tick has its sample every so many ticks and NaN otherwise, the camera also for
        a frame that is lost. `truth` is the controlled line of sight without noise or filter [rad].
        """
        v = self._values[self._n : self._n + COMMANDS]
        np.minimum(command, self.limits, out=v)  # two ufuncs: np.clip takes five times as long
        np.maximum(v, self._lowest, out=v)
        self._propagate()
        row = self.tick % _NOISE_BLOCK
        if row == 0:
            self._draw()
        np.add(self._sums[:MEASUREMENTS], self._noise_block[row] if self._noisy else 0.0, out=measurement)
        measurement += self._sensors.bias
        truth[:], self.sensed[:] = self._sums[MEASUREMENTS : MEASUREMENTS + TRUTH], self._sums[MEASUREMENTS + TRUTH :]
        for columns, ticks in self._slow:
            if self.tick % ticks:
                measurement[columns] = np.nan
        if self.tick % self.frame_ticks or self._lost():
            measurement[CAMERA] = np.nan
        self._turn()
        self.tick += 1

    @property
    def values(self) -> FloatArray:
        """Coordinates, commands and phasors of this tick, for compiled loops, which write them."""
        return self._values

    @property
    def bias(self) -> FloatArray:
        """Constant part of the measurement (22,)."""
        return self._sensors.bias

    @property
    def arrays(self) -> StepArrays:
        """Numbers of a tick, for compiled code."""
        return self._arrays

    def ahead(self, rows: int) -> tuple[Course, SensorArrays] | None:
        """Course and sensors of the next `rows` ticks, which compiled code then does; None after a change."""
        if not (self._noisy and self._disturbed):
            return None
        noise, absent = np.empty((rows, MEASUREMENTS)), np.zeros((rows, MEASUREMENTS), bool)
        ticks = np.arange(self.tick, self.tick + rows)
        done = 0
        while done < rows:
            row = (self.tick + done) % _NOISE_BLOCK
            if row == 0:
                self._draw()
            some = min(_NOISE_BLOCK - row, rows - done)
            noise[done : done + some] = self._noise_block[row : row + some]
            done += some
        for columns, every in self._slow:
            absent[ticks % every != 0, columns] = True
        absent[:, CAMERA] = (ticks % self.frame_ticks != 0)[:, None]
        if self._dropout > 0.0:
            for row in np.flatnonzero(ticks % self.frame_ticks == 0):
                absent[row, CAMERA] = self._lost()
        self.tick += rows
        return self._course(ticks), SensorArrays(noise, self._sensors.bias, absent)

    def _numbers(self) -> StepArrays:
        step, none = self._step, np.zeros((0, 0, 0))
        return StepArrays(step.pairs, step.own, step.cross, step.driven, step.block, step.outputs, step.turn, none)

    def _course(self, ticks: IntArray) -> Course:
        """Places and phasors of these ticks, the next ones: none for constant parameters."""
        return Course(np.zeros(0), np.zeros((0, 0)))

    def push(self, moved: FloatArray) -> None:
        """Add to the present state, in :meth:`coordinates`: what an input beside the matrices did in the last tick."""
        self._values[: self._n] += moved

    def _draw(self) -> None:
        """Noise of the next ticks."""
        self._noise.standard_normal(out=self._noise_block)
        self._noise_block *= self._sensors.sigma

    def _lost(self) -> bool:
        """Whether the frame of this tick is lost."""
        if not self._dropout > 0.0:
            return False
        self._camera.random(out=self._frame)
        return bool(self._frame[0] < self._dropout)

    def _propagate(self) -> None:
        """Measurement and truth from the present coordinates, command and phasors, and the next coordinates."""
        step, n, values, later = self._step, self._n, self._values, self._later
        if self._compiled and (compiled := kernel()) is not None:
            compiled.advance(self._arrays, values, later[:n], self._sums)
            return
        plain, m, terms = len(step.own), step.pairs, self._terms
        self._sums[:] = self._outputs()
        np.multiply(step.own, values[:plain], out=terms[0, :plain])
        np.multiply(step.cross[:m], values[m : 2 * m], out=terms[1, :m])
        np.multiply(step.cross[m : 2 * m], values[:m], out=terms[1, m : 2 * m])
        np.multiply(step.driven, values[n : n + len(step.driven), None], out=terms[2:, :plain])
        if n > plain:
            self._block.values[:] = values[plain : plain + len(step.block)]
            later[plain:n] = self._block()
        values[:plain] = np.add.reduce(terms, axis=0)[:plain]
        values[plain:n] = later[plain:n]

    def _turn(self) -> None:
        """Phasors of the next tick."""
        phasors = self._phasors if self._disturbed else self._phasor
        re, im = phasors[0::2].copy(), phasors[1::2].copy()
        cos, sin = self._step.turn
        phasors[0::2] = re * cos - im * sin
        phasors[1::2] = re * sin + im * cos


__all__ = ["SampledPlant", "SensorModel", "slow_sensors"]
