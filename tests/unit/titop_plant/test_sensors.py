"""The sensors' description: order, noise, bias, frames and washout by port."""

from __future__ import annotations

import numpy as np
import pytest

from titop_plant.interface import ACCELEROMETERS, COLUMNS, MEASURED
from titop_plant.telescope.parameters import load_parameters
from titop_plant.telescope.sensors import constant_error, noise_of_samples, noise_of_ticks, sensors

TABLE = {
    "accelerometer_noise": [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3],
    "accelerometer_bias": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    "camera_noise": 2e-3,
    "strain_gauge_noise": 5e-2,
    "washout": 0.7,
}


@pytest.fixture(scope="module")
def parameters():
    reference = load_parameters()
    return {**reference, "sensors": {**reference["sensors"], **TABLE}}


def test_each_port_has_its_own_values_in_the_order_of_the_measurement(parameters) -> None:
    found = sensors(parameters)
    assert tuple(sensor.port.name for sensor in found) == MEASURED
    noise, bias = noise_of_samples(parameters), constant_error(parameters)
    for sensor in found:
        part, name = COLUMNS[sensor.port.name], sensor.port.name
        accelerometer = name in ACCELEROMETERS
        assert (sensor.framed, sensor.washout) == (name == "camera_los", 0.7 if accelerometer else 0.0)
        kind = {"camera_los": 2e-3, "fsm_angle": 5e-2}.get(name, TABLE["accelerometer_noise"])
        assert np.array_equal(noise[part], np.broadcast_to(kind, sensor.port.size))
        assert np.array_equal(bias[part], TABLE["accelerometer_bias"] if accelerometer else np.zeros(2))


def test_noise_of_a_frame_is_larger_as_if_every_tick_had_one(parameters) -> None:
    """The mean of the samples of a frame's ticks has the frame's noise."""
    ratio = noise_of_ticks(parameters, 25) / noise_of_samples(parameters)
    assert ratio[COLUMNS["camera_los"]].tolist() == [5.0, 5.0]
    assert np.sum(ratio != 1.0) == 2
