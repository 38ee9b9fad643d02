"""The telescope in time: one step a tick, with its sensors, its disturbances and the limits of its devices.

A tick has these steps, in this order; all but the second and third are there where the plant has such a part:

1. The device limits change the command to what the actuators do (:mod:`titop_plant.simulation.device_limits`).
2. The state advances by one tick (:mod:`titop_plant.simulation.constant_step`,
   :mod:`titop_plant.simulation.ramped_step`), under the command and the tones of the disturbance.
3. The sensors without a mount add noise and bias (:mod:`titop_plant.simulation.sensor_samples`).
4. Each held input adds what it does over the tick: a disturbance given in time
   (:mod:`titop_plant.simulation.driven_plant`).
5. The sensors at places are read (:mod:`titop_plant.telescope.placed.readings`).
6. The device limits filter and round the measurement.
7. The camera replaces the angles by those of its images.

:meth:`Plant.step` computes the second step with numpy, or, after :meth:`Plant.compile`, with the compiled code of
:mod:`titop_plant.simulation.kernel`, which also runs whole loops (:mod:`los_testbed.run.loop.compiled_loop`). **All of
them are bit-identical.**
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.interface import TRUTH
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.device_limits import LimitedDevices
from titop_plant.simulation.kernel_arrays import Course, SensorArrays
from titop_plant.simulation.ramped_step import RampedStep
from titop_plant.simulation.sensor_samples import SensorModel, SensorSamples
from titop_plant.telescope.placed.readings import SensorReadings

CHANGES = ("noise", "disturbance", "camera_dropout")
"""Settings of a plant that may change between two ticks."""


class HeldInput(Protocol):
    """An input beside the commands, held over each tick: see :mod:`titop_plant.simulation.driven_plant`."""

    held: FloatArray
    """Effect of a unit value on the next state (n), measurement (m) and truth (2), shape (n + m + 2, values)."""
    name: str
    """Added to the name of the plant's values; empty: nothing is added."""
    lines: FloatArray
    """Frequencies of its tones [rad/s], of a disturbance; empty without any."""

    def value(self) -> FloatArray:
        """Values of this tick."""

    @property
    def acts(self) -> bool:
        """Whether its values are added."""

    def reset(self) -> None:
        """Back to tick 0."""

    def change(self, name: str, value: float) -> None:
        """A setting, see `Plant.change`; names that do not concern it have no effect."""


class ImageStage(Protocol):
    """A camera that takes images instead of the camera's measurement."""

    def after(self, measurement: FloatArray, truth: FloatArray) -> None:
        """Replace the camera's angles of a tick in `measurement` (m,) [rad]; `truth` (2,) is left alone."""

    def reset(self) -> None:
        """Back to tick 0."""

    def change(self, name: str, value: float) -> None:
        """A setting, see `Plant.change`; names that do not concern it have no effect."""


@dataclass(eq=False, repr=False)
class Plant:
    """Telescope with sensors and disturbances, one step a tick.

    ``dataclasses.replace`` gives a plant other parts. The new plant begins at tick 0; parts that were stepped before
    need its `reset`.

    Parameters
    ----------
    dynamics : ConstantStep or RampedStep
        Start and next state (n,).
    sensors : SensorModel
    authority : ndarray, shape (c,)
        Commands are clipped to [-authority, authority]: mirror [rad], other actuators [N, Nm].
    name : str
        Of the configuration and its parameter values.
    inputs : tuple of HeldInput
        Disturbances given in time.
    readings : SensorReadings, optional
        Sensors with a mount, whose values are the last of the measurement.
    devices : LimitedDevices, optional
    camera : ImageStage, optional

    Attributes
    ----------
    dt : float
        Sampling period [s].
    frame_ticks : int
        Ticks from one frame of the camera to the next.
    tones : ndarray
        Frequencies of the disturbances at the start [rad/s], for reports.
    parameters_hash : str
        `name`, and the names of the parts.
    tick : int
        Number of the next tick.
    values : ndarray, shape (n + c + 2 K,)
        Coordinates, commands and phasors of this tick; compiled loops write them.

    Raises
    ------
    ValueError
        A held input of a plant of another order, or sensors of another number of values.
    """

    dynamics: ConstantStep | RampedStep
    sensors: SensorModel
    authority: FloatArray
    name: str = ""
    inputs: tuple[HeldInput, ...] = ()
    readings: SensorReadings | None = None
    devices: LimitedDevices | None = None
    camera: ImageStage | None = None
    dt: float = field(init=False)
    frame_ticks: int = field(init=False)
    tones: FloatArray = field(init=False)
    parameters_hash: str = field(init=False)
    tick: int = field(init=False)
    values: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        dynamics, numbers = self.dynamics, self.dynamics.numbers
        self.dt, self.frame_ticks, self.tones = dynamics.dt, self.sensors.frame_ticks, dynamics.tones
        for one in self.inputs:
            if one.lines.size:
                self.tones = np.union1d(self.tones, one.lines)
        names = [one.name for one in self.inputs] + ([] if self.devices is None else [self.devices.name])
        self.parameters_hash = " with ".join([self.name, *filter(None, names)])
        self._samples = SensorSamples(self.sensors)
        self._order, self._lowest = numbers.order, -self.authority
        self.values, self._sums = np.zeros(len(numbers.outputs)), np.zeros(numbers.outputs.shape[1])
        self._kept = np.zeros(numbers.turn.size)
        self._sampled, self._measured = self.sensors.sigma.size, self._sums.size - TRUTH
        read = self._sampled + (0 if self.readings is None else self.readings.size)
        if read != self._measured:
            raise InputError(f"sensors and readings must have {self._measured} values, got {read}")
        self._start = self.coordinates(dynamics.start)
        self._responses = [self._response(one) for one in self.inputs]
        self._restart()

    def _response(self, held_input: HeldInput) -> FloatArray:
        """Contribution of a unit value of an input, with the coordinates instead of the states."""
        n, rows = self._order, self._order + self._sums.size
        if len(held_input.held) != rows:
            raise InputError(f"held of an input must have {rows} rows, got {len(held_input.held)}")
        return np.ascontiguousarray(np.vstack([self.coordinates(held_input.held[:n]), held_input.held[n:]]))

    @property
    def _parts(self) -> tuple[HeldInput | SensorReadings | LimitedDevices | ImageStage, ...]:
        """All parts that have a state of their own."""
        single = (self.readings, self.devices, self.camera)
        return (*self.inputs, *(part for part in single if part is not None))

    @property
    def is_plain(self) -> bool:
        """Whether the plant has no part beside its state, its tones and the sensors without a mount."""
        return not self._parts

    @property
    def motion(self) -> Mapping[str, Any] | None:
        """Motion for reports, see `RampedStep.motion`; None for constant parameters."""
        return self.dynamics.motion

    def reset(self) -> None:
        """Return to tick 0: same seed, bit-identical outputs."""
        self._restart()
        for part in self._parts:
            part.reset()

    def _restart(self) -> None:
        """State, phasors and samples of tick 0."""
        self._samples.reset()
        self.values[:] = 0.0
        self.dynamics.begin(self._phasors)
        self.values[: self._order] = self._start - self._steady
        self._disturbed = True
        self.tick = 0

    def compile(self) -> None:
        """Step with compiled code from now on, if there is any: bit-identical and faster."""
        self.dynamics.compiled = kernel() is not None
        before, kept = self.values.copy(), self._kept.copy()
        # numba reads or makes the code at the first call, which must not be a tick of a run
        self.dynamics.advance(self.tick, self.values, self._sums)
        self.dynamics.turn(self.tick, self._kept)
        self.values[:], self._kept[:] = before, kept

    @property
    def _phasors(self) -> FloatArray:
        """Phasors of this tick, real and imaginary parts in turn."""
        return self.values[self._order + self.authority.size :]

    @property
    def _steady(self) -> FloatArray:
        """Coordinates of the steady motion at this tick, shape (n,)."""
        return np.asarray((self.dynamics.numbers.steady * self._phasors.view(complex)).imag.sum(axis=1))

    def coordinates(self, states: FloatArray) -> FloatArray:
        """States (n,) or (n, k) in the coordinates of the step."""
        columns = states[:, None] if states.ndim == 1 else states
        return np.asarray(self.dynamics.numbers.form.excited(columns).reshape(states.shape))

    def change(self, name: str, value: float) -> None:
        """Change a setting from the next tick on; a reset undoes it.

        Parameters
        ----------
        name : {"noise", "disturbance", "camera_dropout"}
            Noise of sensors and images (the bias stays); disturbances, whose phases continue; probability that a frame
            of the camera is lost.
        value : float
            0 or 1; for the drop-out a probability.

        Raises
        ------
        ValueError
            Another name.
        """
        if name not in CHANGES:
            raise InputError(f"name must be noise, disturbance or camera_dropout, got {name!r}")
        if name == "disturbance":
            self._switch(bool(value))
        self._samples.change(name, value)
        for part in self._parts:
            part.change(name, value)

    def _switch(self, on: bool) -> None:
        """Switch the tones: the excited motion continues freely, and their phases advance."""
        moved = self.values[: self._order]
        if self._disturbed and not on:
            moved += self._steady
            self._kept[:], self._phasors[:] = self._phasors, 0.0
        elif on and not self._disturbed:
            self._phasors[:] = self._kept
            moved -= self._steady
        self._disturbed = on

    @property
    def state(self) -> FloatArray:
        """Present state, shape (n,)."""
        return np.asarray(self.dynamics.numbers.form.basis @ (self.values[: self._order] + self._steady))

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` from this tick on; write `measurement` (m,) and `truth` (2,) of this tick.

        The camera has NaN between its frames and for one that is lost. `truth` is the controlled line of sight without
        noise or filter [rad].

        Parameters
        ----------
        command : ndarray, shape (c,)
            Mirror [rad], other actuators [N, Nm].
        measurement : ndarray, shape (m,)
            [m/s2, rad/s2, rad].
        truth : ndarray, shape (2,)
        """
        applied = command if self.devices is None else self.devices.before(command)
        added = [one.value() for one in self.inputs]
        n, m, sampled, sums = self._order, self._measured, self._sampled, self._sums
        acting = self.values[n : n + self.authority.size]
        np.minimum(applied, self.authority, out=acting)  # two ufuncs: np.clip takes five times as long
        np.maximum(acting, self._lowest, out=acting)
        self.dynamics.advance(self.tick, self.values, sums)
        self._samples.write(self.tick, sums[:sampled], measurement[:sampled])
        measurement[sampled:], truth[:] = sums[sampled:m], sums[m:]
        self.dynamics.turn(self.tick, self._phasors if self._disturbed else self._kept)
        self.tick += 1
        for one, response, value in zip(self.inputs, self._responses, added):
            if one.acts:
                self._add(response @ value, measurement, truth)
        if self.readings is not None:
            self.readings.read(measurement[sampled:])
        if self.devices is not None:
            self.devices.after(measurement)
        if self.camera is not None:
            self.camera.after(measurement, truth)

    def _add(self, added: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Add what an input does in this tick to the next state, and to what is measured now."""
        n, m = self._order, self._measured
        self.values[:n] += added[:n]
        measurement += added[n : n + m]
        truth += added[n + m :]

    def ahead(self, rows: int) -> tuple[Course, SensorArrays] | None:
        """Course and sensors of the next `rows` ticks, which compiled code then does; None after a change."""
        if not (self._samples.noisy and self._disturbed):
            return None
        ticks = np.arange(self.tick, self.tick + rows)
        self.tick += rows
        return self.dynamics.course(ticks), self._samples.ahead(ticks)


__all__ = ["CHANGES", "HeldInput", "ImageStage", "Plant"]
