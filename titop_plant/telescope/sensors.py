"""The sensors of the loop: ports, noise, bias, which of them have frames, which are behind the washout.

One entry for each port of the measurement, in its order (:data:`titop_plant.interface.MEASURED_PORTS`); values are
those of the table ``sensors`` of the parameter file. Simulation, generalised plants, sampled loop, tuner and campaign
take them from here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit import Port
from lftkit.arrays import FloatArray
from titop_plant.interface import ACCELEROMETERS, MEASURED_PORTS
from titop_plant.telescope.parameters import Parameters

FRAMED = ("camera_los",)
"""Ports with a value at camera frames only, which is held between them."""

_NOISE = {"camera_los": "camera_noise", "fsm_angle": "strain_gauge_noise"}


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
        Whether it has a value at camera frames only, which is held between them.
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

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> [(s.port.name, s.framed, s.washout > 0.0) for s in sensors(load_parameters())][2:]
    [('accel_M2', False, True), ('camera_los', True, False), ('fsm_angle', False, False)]
    """
    table: Any = parameters["sensors"]

    def sensor(port: Port) -> Sensor:
        if port.name in ACCELEROMETERS:
            noise, bias, washout = table["accelerometer_noise"], table["accelerometer_bias"], table["washout"]
        else:
            noise, bias, washout = table[_NOISE[port.name]], 0.0, 0.0
        size = np.ones(port.size)
        return Sensor(port, noise * size, bias * size, port.name in FRAMED, float(washout))

    return tuple(sensor(port) for port in MEASURED_PORTS)


def noise_of_samples(parameters: Parameters) -> FloatArray:
    """Standard deviation of the samples, of a frame for the camera, shape (22,) [m/s2, rad/s2, rad]."""
    return np.concatenate([sensor.noise for sensor in sensors(parameters)])


def noise_of_ticks(parameters: Parameters, frame_ticks: int) -> FloatArray:
    """The same as if every tick had a frame: that of the camera is larger by the root of the ticks of a frame."""
    factors = (np.sqrt(frame_ticks) if sensor.framed else 1.0 for sensor in sensors(parameters))
    return np.concatenate([sensor.noise * factor for sensor, factor in zip(sensors(parameters), factors)])


def constant_error(parameters: Parameters) -> FloatArray:
    """Bias of the samples, shape (22,) [m/s2, rad/s2, rad]."""
    return np.concatenate([sensor.bias for sensor in sensors(parameters)])
