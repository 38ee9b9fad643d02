"""The sensors of the loop: ports, noise, bias, which of them have frames, which are behind the washout.

The entries of :mod:`titop_plant.sensor_table` with the values of the table ``sensors`` of a parameter file, in the
order of the measurement. Simulation, generalised plants, sampled loop, tuner and campaign take them from here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit import Port
from lftkit.arrays import FloatArray
from titop_plant.interface import FRAME_TICKS, sample_ticks
from titop_plant.sensor_table import MEASURED_SENSORS, SensorEntry
from titop_plant.telescope.parameters import Parameters


@dataclass(frozen=True)
class Sensor:
    """A sensor of the loop.

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
    """

    port: Port
    noise: FloatArray
    bias: FloatArray
    framed: bool
    washout: float


def sensors(parameters: Parameters) -> tuple[Sensor, ...]:
    """Sensors in the order of the measurement.

    Raises
    ------
    ValueError
        A key of the table of sensors that the parameter file does not have.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> [(s.port.name, s.framed, s.washout > 0.0) for s in sensors(load_parameters())][2:]
    [('accel_M2', False, True), ('camera_los', True, False), ('fsm_angle', False, False)]
    """
    table: Any = parameters["sensors"]

    def value(entry: SensorEntry, key: str) -> Any:
        if key and key not in table:
            raise ValueError(
                f"sensors.{key} of {entry.port.name} must be in the parameter file, got {', '.join(table)}"
            )
        return table[key] if key else 0.0

    def sensor(entry: SensorEntry) -> Sensor:
        size, washout = np.ones(entry.port.size), float(value(entry, entry.washout))
        noise, bias = (value(entry, key) * size for key in (entry.noise, entry.bias))
        return Sensor(entry.port, noise, bias, entry.framed, washout)

    return tuple(sensor(entry) for entry in MEASURED_SENSORS)


def noise_of_samples(parameters: Parameters) -> FloatArray:
    """Standard deviation of the samples, of a frame for the camera, shape (22,) [m/s2, rad/s2, rad]."""
    return np.concatenate([sensor.noise for sensor in sensors(parameters)])


def noise_of_ticks(parameters: Parameters, frame_ticks: int = FRAME_TICKS) -> FloatArray:
    """The same as if every tick had a sample: that of a held value is larger by the root of the ticks it is held.

    Parameters
    ----------
    parameters : mapping
    frame_ticks : int
        Ticks of a frame of the camera.
    """
    ticks = sample_ticks(frame_ticks)
    found = (sensor.noise * np.sqrt(ticks.get(sensor.port.name, 1)) for sensor in sensors(parameters))
    return np.concatenate(list(found))


def constant_error(parameters: Parameters) -> FloatArray:
    """Bias of the samples, shape (22,) [m/s2, rad/s2, rad]."""
    return np.concatenate([sensor.bias for sensor in sensors(parameters)])
