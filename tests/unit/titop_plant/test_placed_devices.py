"""Further sensors and actuators: kinematics of a rigid body, reciprocity, passivity, mass, refusals of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit import Port
from titop_plant.sensors import Sensor, SensorMount
from titop_plant.telescope.assembly import AssembledTelescope, build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.placed.readings import SensorReadings
from titop_plant.telescope.telescope import Telescope

ARM = [0.3, -0.2, 0.5]
SLANTED = [0.6, 0.0, 0.8]
SENSORS = f"""
[[sensor]]
name = "centre"
place = "bus"

[[sensor]]
name = "beside"
place = "bus"
position = {ARM}

[[sensor]]
name = "spin"
place = "bus"
kind = "angular_accelerometer"

[[sensor]]
name = "mirror"
place = "M1"
axes = [{SLANTED}]
"""
ACTUATORS = f"""
[[actuator]]
name = "one"
place = "A1"
axis = [0.0, 0.0, 1.0]

[[actuator]]
name = "two"
place = "detector"
axis = {SLANTED}

[[sensor]]
name = "at_one"
place = "A1"
axes = [[0.0, 0.0, 1.0]]

[[sensor]]
name = "at_two"
place = "detector"
axes = [{SLANTED}]
"""
SENSOR_NAMES, ACTUATOR_NAMES = ("at_one", "at_two"), ("one", "two")
OMEGA = np.array([0.3, 2.0, 5.3, 40.0, 170.0, 430.0, 900.0, 3000.0])


def read(folder: Path, text: str) -> Telescope:
    """Parameters of a file with this text."""
    path = folder / "own.toml"
    path.write_text('base = "reference"\n' + text)
    return load_telescope(path)


@pytest.fixture(scope="module")
def sensed(tmp_path_factory: pytest.TempPathFactory) -> AssembledTelescope:
    return build_telescope(read(tmp_path_factory.mktemp("sensed"), SENSORS))


@pytest.fixture(scope="module")
def actuated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Telescope, AssembledTelescope]:
    telescope = read(tmp_path_factory.mktemp("actuated"), ACTUATORS)
    return telescope, build_telescope(telescope, attitude_controlled=False, motors=True)


@given(st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12))
@settings(max_examples=16, deadline=None)
def test_an_accelerometer_measures_the_motion_of_its_point(values: list[float]) -> None:
    a, alpha, r, n = np.array(values).reshape(4, 3)
    axes = (n + 4.0)[None, :] / np.sqrt((n + 4.0) @ (n + 4.0))
    linear, angular = (SensorMount("bus", axes, r, angular=kind) for kind in (False, True))
    twist = np.concatenate([a, alpha])
    assert linear.rows @ twist == pytest.approx(axes @ (a + np.cross(alpha, r)), abs=1e-12)
    assert angular.rows @ twist == pytest.approx(axes @ alpha, abs=1e-12)


def test_sensors_measure_the_twists_of_the_telescope(sensed: AssembledTelescope) -> None:
    chosen = sensed.system.select(outputs=["centre", "beside", "spin", "mirror", "accel_G", "accel_M1"]).at({})
    for omega in OMEGA:
        found = chosen(1j * omega)
        read_off, twist, mirror = found[:10], found[10:16], found[16:]
        beside = twist[:3] + np.cross(twist[3:].T, ARM).T
        expected = np.vstack([twist[:3], beside, twist[3:], np.array([SLANTED]) @ mirror[:3]])
        assert np.abs(read_off - expected).max() <= 1e-10 * np.abs(expected).max()


def test_two_equal_actuators_are_reciprocal(actuated: tuple[Telescope, AssembledTelescope]) -> None:
    """A force at one moves the other as much as one at the other moves the first."""
    pair = actuated[1].system[SENSOR_NAMES, ACTUATOR_NAMES].at({})
    for omega in OMEGA:
        found = pair(1j * omega)
        assert abs(found[0, 1] - found[1, 0]) <= 1e-8 * np.abs(found).max()


def test_a_motor_between_mass_and_structure_is_passive(actuated: tuple[Telescope, AssembledTelescope]) -> None:
    """The relative velocity of structure and mass by the force between them has a non-negative real part."""
    table = actuated[0].pma
    m, k, d = table.moving_mass, table.stiffness, table.damping
    pair = actuated[1].system[SENSOR_NAMES, ACTUATOR_NAMES].at({})
    for omega in np.geomspace(0.1, 3000.0, 200):
        s = 1j * omega
        relative = s / (m * s**2 + d * s + k) * (m * pair(s) + np.eye(2))  # from the equation of the mass
        least = np.linalg.eigvalsh(relative + relative.conj().T).min()
        assert least >= -1e-9 * np.abs(relative).max()


def test_readings_have_noise_bias_range_and_step() -> None:
    noisy = Sensor(Port("n", 1, "m/s2"), np.array([0.1]), np.array([0.2]))
    coarse = Sensor(Port("c", 2, "m/s2"), np.zeros(2), np.zeros(2), step=0.3, range=2.0)
    readings, true = SensorReadings([noisy, coarse], seed=1, noise=True), np.array([0.5, -0.5, 9.0])
    rows = []
    for _ in range(4000):
        rows.append(true.copy())
        readings.read(rows[-1])
    values = np.array(rows)
    assert values[:, 0].mean() == pytest.approx(0.7, abs=5 * 0.1 / np.sqrt(4000))
    assert values[:, 0].std() == pytest.approx(0.1, rel=0.06)
    assert values[:, 1:] == pytest.approx(np.tile([-0.6, 2.1], (4000, 1)))  # 9 is limited to 2, then rounded
    readings.reset()
    readings.read(true)
    assert true.tolist() == rows[0].tolist()
