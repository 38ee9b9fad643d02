"""The sensors' description: order, noise, bias, frames and washout by port."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import Port
from titop_plant.interface import ACCELEROMETERS, COLUMNS, HELD, HELD_PARTS, MEASURED, period_ticks, sample_ticks
from titop_plant.sensors import MEASURED_SENSORS, SensorEntry
from titop_plant.telescope.load import load_telescope

TABLE: dict[str, Any] = {
    "accelerometer_noise": [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3],
    "accelerometer_bias": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    "camera_noise": 2e-3,
    "strain_gauge_noise": 5e-2,
    "washout": 0.7,
}


@pytest.fixture(scope="module")
def telescope():
    return load_telescope().changed({"sensors": TABLE})


def test_each_port_has_its_own_values_in_the_order_of_the_measurement(telescope) -> None:
    found = telescope.sensors
    assert tuple(sensor.port.name for sensor in found) == MEASURED
    noise, bias = telescope.loop_ports.reference.noise, telescope.loop_ports.reference.bias
    for sensor in found:
        part, name = COLUMNS[sensor.port.name], sensor.port.name
        accelerometer = name in ACCELEROMETERS
        assert (sensor.framed, sensor.washout) == (name == "camera_los", 0.7 if accelerometer else 0.0)
        kind = {"camera_los": 2e-3, "fsm_angle": 5e-2}.get(name, TABLE["accelerometer_noise"])
        assert np.array_equal(noise[part], np.broadcast_to(kind, sensor.port.size))
        assert np.array_equal(bias[part], TABLE["accelerometer_bias"] if accelerometer else np.zeros(2))


def test_noise_of_a_frame_is_larger_as_if_every_tick_had_one(telescope) -> None:
    """The mean of the samples of a frame's ticks has the frame's noise."""
    ratio = telescope.loop_ports.reference.noise_of_ticks(25) / telescope.loop_ports.reference.noise
    assert ratio[COLUMNS["camera_los"]].tolist() == [5.0, 5.0]
    assert np.sum(ratio != 1.0) == 2


def test_columns_and_ticks_follow_from_the_table() -> None:
    assert tuple(entry.port.name for entry in MEASURED_SENSORS) == MEASURED
    groups = [entry.group for entry in MEASURED_SENSORS]
    assert groups[: len(ACCELEROMETERS)] == ["accelerometers"] * len(ACCELEROMETERS)
    assert "accelerometers" not in groups[len(ACCELEROMETERS) :]
    assert HELD.tolist() == [18, 19] and HELD_PARTS["camera_los"] == slice(0, 2)
    assert sample_ticks() == {"camera_los": 20} and sample_ticks(7) == {"camera_los": 7} and period_ticks(7) == 7


@pytest.mark.parametrize(
    ("port", "rate", "message"),
    [
        (Port("a", 2), 300.0, "rate of a must divide 1000 Hz .* got 300 Hz"),
        (Port("a", 2), 0.0, "rate of a must divide 1000 Hz .* got 0 Hz"),
        (Port("a", 2), 2000.0, "rate of a must divide 1000 Hz .* got 2000 Hz"),
        (Port("a", 4), 10.0, "size of a must be 1 to 3, or 6 of a twist, got 4"),
    ],
)
def test_an_entry_that_no_loop_can_have_is_refused(port: Port, rate: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SensorEntry(port, "a", "a", "a", "a_noise", "camera_step", rate)
