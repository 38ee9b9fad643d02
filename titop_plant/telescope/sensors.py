"""The sensors of the loop: ports, noise, bias, which of them have frames, which are behind the washout, where they are.

Those of the reference are the entries of :mod:`titop_plant.sensor_table` with the values of the table ``sensors`` of a
parameter file, in the order of the measurement; further ones are the tables ``[[sensor]]`` of a user's file
(:mod:`titop_plant.telescope.devices`). Simulation, generalised plants, sampled loop, tuner and campaign take them from
the telescope.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant.sensor_table import MEASURED_SENSORS, SensorEntry


@dataclass(frozen=True)
class SensorMount:
    """Where a further sensor is, and along which axes it measures.

    Parameters
    ----------
    place : str
        Point of the structure.
    axes : ndarray, shape (k, 3)
        Unit vectors along which it measures, one to three, in the axes of the body.
    position : ndarray, shape (3,)
        From the point [m].
    angular : bool
        Whether it measures the angular acceleration.
    """

    place: str
    axes: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    angular: bool = False

    @property
    def rows(self) -> FloatArray:
        """Its values from the twist of its point, shape (k, 6)."""
        none = np.zeros_like(self.axes)
        if self.angular:
            return np.hstack([none, self.axes])
        return np.hstack([self.axes, np.cross(self.position, self.axes)])


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor of the loop: of the reference, or of a telescope's file.

    Parameters
    ----------
    port : Port
        Its part of the measurement.
    noise, bias : ndarray, shape (size,)
        Standard deviation of a sample (of a frame), and what is added to every sample, in the unit of the port.
    framed : bool
        Whether it has a value at some ticks only, which is held between them.
    washout : float
        Corner of the high-pass before the controllers [rad/s]; 0: none.
    low_pass : tuple of float
        ``c0, c1, c2`` of its low-pass ``c0 / (s^2 + c1 s + c2)``; empty: none.
    step, range : float
        Quantisation (0: none) and largest value (inf: none) of a further sensor, in the unit of the port. Those of the
        reference are limits of the devices (:mod:`titop_plant.simulation.device_limits`).
    mount : SensorMount, optional
        Of a further sensor; one of the reference measures an output of the assembled telescope.
    """

    port: Port
    noise: FloatArray
    bias: FloatArray
    framed: bool = False
    washout: float = 0.0
    low_pass: tuple[float, ...] = ()
    step: float = 0.0
    range: float = math.inf
    mount: SensorMount | None = None

    @property
    def name(self) -> str:
        """Name of its port."""
        return self.port.name


def port_alone(entry: SensorEntry) -> Sensor:
    """A sensor of no telescope: its noise and bias are unknown (NaN)."""
    unknown = np.full(entry.port.size, math.nan)
    return Sensor(entry.port, unknown, unknown, entry.framed)


def read_loop_sensors(table: Mapping[str, Any]) -> tuple[Sensor, ...]:
    """Sensors of the table ``sensors`` of a parameter file, in the order of the measurement.

    Raises
    ------
    ValueError
        A key of the table of sensors that the parameter file does not have.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> [(s.port.name, s.framed, s.washout > 0.0) for s in load_telescope().sensors][2:]
    [('accel_M2', False, True), ('camera_los', True, False), ('fsm_angle', False, False)]
    """

    def value(entry: SensorEntry, key: str) -> Any:
        if key and key not in table:
            raise ValueError(
                f"sensors.{key} of {entry.port.name} must be in the parameter file, got {', '.join(table)}"
            )
        return table[key] if key else 0.0

    def sensor(entry: SensorEntry) -> Sensor:
        size, washout = np.ones(entry.port.size), float(value(entry, entry.washout))
        noise, bias = (value(entry, key) * size for key in (entry.noise, entry.bias))
        low_pass = tuple(map(float, value(entry, entry.low_pass))) if entry.low_pass else ()
        return Sensor(entry.port, noise, bias, entry.framed, washout, low_pass)

    return tuple(sensor(entry) for entry in MEASURED_SENSORS)
