"""Limits of real devices of the telescope: strokes, rates, quantisation, anti-alias filters.

In each tick, in this order:

1. The commands change by no more than the rate of their actuator allows (their size is limited by the telescope).
2. A proof mass that reaches its stroke rests at an end stop until the force points back: a motor that presses the
   mass on the stop has no net force on the structure. The displacement is that of the mass on its spring under the
   force alone (``m x'' + d x' + k x = u``, exact for a force held over a tick). Neglected: the acceleration of the
   mount, small beside it, and the impact.
3. The telescope moves (`titop_plant.simulation.plant`), with noise and bias.
4. Accelerations pass a Butterworth low-pass of second order (bilinear, prewarped at its cut-off), which delays slow
   signals by ``sqrt(2) / (2 pi cut-off)``. It starts settled on the first sample.
5. Every measurement is rounded to its quantisation step.

**The truth is that of the telescope: no sensor changes it.** Without any of these limits (all 0)
the plant is bit-identical to the linear one.
"""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from titop_plant.interface import ACCELERATIONS, COLUMNS, DT, FORCES, MIRROR
from titop_plant.sensors import MEASURED_SENSORS
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.sections import DeviceLimits, OscillatorTable


class LimitedDevices:
    """Actuators and sensors with device limits, a part of :class:`titop_plant.simulation.plant.Plant`.

    Parameters
    ----------
    limits : DeviceLimits
        :attr:`titop_plant.telescope.telescope.Telescope.device_limits`.
    actuator : OscillatorTable
        Of the proof-mass actuators.
    ports : LoopPorts
        Sensors and actuators of the plant. Actuators at places have no limit but their authority; sensors at places
        are quantised where they are read.
    dt : float
        Sampling period [s].

    Attributes
    ----------
    name : str
        Added to the name of the plant's values: the limits.

    Examples
    --------
    A filter of 250 Hz delays the accelerations by 0.9 ms at low frequency:

    >>> from titop_plant.telescope.load import load_telescope
    >>> round(1e3 * math.sqrt(2) / (2 * math.pi * load_telescope().device_limits.cut_off), 2)
    0.9
    """

    def __init__(self, limits: DeviceLimits, actuator: OscillatorTable, ports: LoopPorts, dt: float = DT) -> None:
        self.limits, self.name = limits, str(astuple(limits))
        self._authority = ports.limits
        self._most = np.full(ports.commands, np.inf)
        self._most[MIRROR] = (limits.mirror_rate or math.inf) * dt
        self._most[FORCES] = (limits.force_rate or math.inf) * dt
        self._stroke = limits.stroke or math.inf
        self._push, self._move = held_oscillator(actuator, dt)
        self._b, self._a = np.eye(1, 3)[0], np.eye(1, 3)[0]
        if limits.cut_off:
            from scipy import signal

            self._b, self._a = (np.asarray(c) for c in signal.butter(2, limits.cut_off, fs=1.0 / dt))
        self._filtered = bool(limits.cut_off)
        self._step = np.zeros(ports.measurements)
        for entry in MEASURED_SENSORS:
            self._step[COLUMNS[entry.port.name]] = getattr(limits, entry.step) if entry.step else 0.0
        self._coarse = self._step > 0.0
        self._command = np.zeros(ports.commands)
        self.reset()

    def reset(self) -> None:
        """Back to tick 0: masses at rest, filters that settle on the first sample."""
        self._last: FloatArray | None = None
        self._mass = np.zeros((2, FORCES.stop - FORCES.start))
        self._memory: FloatArray | None = None

    def change(self, name: str, value: float) -> None:
        """No setting of a run changes the limits."""

    @property
    def displacement(self) -> FloatArray:
        """Copy of the displacements of the six proof masses [m]."""
        return np.array(self._mass[0])

    def before(self, command: FloatArray) -> FloatArray:
        """Output of the actuators for `command` (c,) in this tick; the next call overwrites it."""
        v, stroke = self._command, self._stroke
        np.clip(command, -self._authority, self._authority, out=v)
        if self._last is not None:  # the first command is that of the start
            np.clip(v, self._last - self._most, self._last + self._most, out=v)
        forces = v[FORCES]
        forces[(np.abs(self._mass[0]) >= stroke) & (forces * self._mass[0] > 0.0)] = 0.0
        self._last = v.copy()
        self._mass = self._push @ self._mass + self._move[:, None] * forces
        at_stop = np.abs(self._mass[0]) > stroke
        self._mass[0, at_stop] = np.copysign(stroke, self._mass[0, at_stop])
        self._mass[1, at_stop] = 0.0
        return v

    def after(self, measurement: FloatArray) -> None:
        """Filter and round the measurement (m,) of this tick."""
        if self._filtered:
            self._low_pass(measurement[ACCELERATIONS])
        coarse = self._coarse
        measurement[coarse] = np.round(measurement[coarse] / self._step[coarse]) * self._step[coarse]

    def _low_pass(self, x: FloatArray) -> None:
        """Filter in place, transposed direct form II."""
        b, a = self._b, self._a
        if self._memory is None:
            z2 = (b[2] - a[2]) * x
            self._memory = np.array([(b[1] - a[1]) * x + z2, z2])
        y = b[0] * x + self._memory[0]
        self._memory[0] = b[1] * x - a[1] * y + self._memory[1]
        self._memory[1] = b[2] * x - a[2] * y
        x[:] = y


def held_oscillator(actuator: OscillatorTable, dt: float) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity of a proof mass one tick on: matrix (2, 2) of the state, vector (2,) of a held force.

    Examples
    --------
    A constant force ends at u / k:

    >>> actuator = OscillatorTable(2.5, 3.5, (1e-3, 1e-3, 1e-3), 70.0, 10.0, 31.6)
    >>> push, move = held_oscillator(actuator, 1e-3)
    >>> rest = linalg.solve(np.eye(2) - push, move * 7.0)
    >>> rest.round(12).tolist()
    [0.1, 0.0]
    """
    m, k, d = actuator.moving_mass, actuator.stiffness, actuator.damping
    generator = np.array([[0.0, 1.0, 0.0], [-k / m, -d / m, 1.0 / m], [0.0, 0.0, 0.0]])
    held = linalg.expm(generator * dt)
    return held[:2, :2], held[:2, 2]
