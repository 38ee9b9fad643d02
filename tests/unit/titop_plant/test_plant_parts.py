"""Parts of a plant: superposition of its inputs, limits that limit nothing, resets, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lftkit import Port, System
from lftkit.arrays import FloatArray
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import CAMERA, COMMANDS, FORCES, MEASUREMENTS, MIRROR, TRUTH
from titop_plant.sensors import Sensor
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.device_limits import DeviceLimits, LimitedDevices
from titop_plant.simulation.driven_plant import ActuatorInput, DisturbanceInput
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.actuators import Actuator
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.placed.readings import SensorReadings

N, FURTHER, TICKS = 5, 2, 200
SIZE = MEASUREMENTS + TRUTH + FURTHER
AUTHORITY = np.array([5e-3] * 2 + [30.0] * 6)
ACTUATOR = load_telescope().pma
SILENT = SensorModel(np.zeros(MEASUREMENTS), np.zeros(MEASUREMENTS), 1, 0.0, 0)
NOISY = SensorModel(np.full(MEASUREMENTS, 0.1), np.linspace(-1.0, 1.0, MEASUREMENTS), 4, 0.3, 7)
EACH = np.ones(FURTHER)
SENSOR = Sensor(Port("s", FURTHER, "m/s2"), 0.1 * EACH, 0.2 * EACH, step=0.01, range=50.0)


class Noise:
    """A disturbance of random values, with a tone in its name."""

    lines = (77.0,)

    def __init__(self, seed: int, size: float = 1.0) -> None:
        self.seed, self.size = seed, size
        self.reset()

    def reset(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def step(self, out: FloatArray) -> None:
        out[:] = self.size * self.rng.standard_normal(out.size)


class Frames:
    """A camera whose angles are the tick and the true line of sight."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.tick = 0

    def change(self, name: str, value: float) -> None:
        """Nothing to change."""

    def after(self, measurement: FloatArray, truth: FloatArray) -> None:
        measurement[CAMERA] = self.tick, truth[0]
        self.tick += 1


def telescope(sensors: SensorModel = SILENT, size: float = 0.0) -> Plant:
    """A small plant with further sensors at rest, its tone of the given size."""
    rng = np.random.default_rng(2)
    A = np.diag([-2.0, -30.0, -5.0, -5.0, -0.5])
    A[2, 3], A[3, 2] = 40.0, -40.0
    B, C, D = (rng.standard_normal(shape) for shape in ((N, 30), (SIZE, N), (SIZE, 30)))
    data = System(A, B, C, D, (Port("u", 30),), (Port("y", SIZE),))
    tones = Tones(np.array([50.0]), np.full((22, 1), size + 0j), np.zeros(1), np.array([-1]))
    dynamics = ConstantStep(plant_step(data, tones), np.zeros(N), tones.frequency)
    return Plant(dynamics, sensors, AUTHORITY, "small")


def held(seed: int, columns: int = 3) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((N + SIZE, columns))


def actuator() -> Actuator:
    return Actuator(Port("a", 1, "N"), authority=3.0, scale=0.5)


def whole() -> Plant:
    """With every part."""
    inputs = DisturbanceInput(held(3), Noise(3), "noise"), ActuatorInput(held(4, 1), [actuator()])
    plant = replace(telescope(NOISY, 1.0), inputs=inputs, further_sensors=SensorReadings([SENSOR], 1, noise=True))
    devices = LimitedDevices(DeviceLimits(), ACTUATOR, plant.limits)
    return replace(plant, devices=devices, camera=Frames())


def response(plant: Plant, commands: FloatArray) -> FloatArray:
    """Measurement, truth and further sensors without noise of each tick."""
    rows = np.zeros((len(commands), SIZE))
    for row, command in zip(rows, commands):
        plant.step(command, row[:MEASUREMENTS], row[MEASUREMENTS : MEASUREMENTS + TRUTH])
        row[MEASUREMENTS + TRUTH :] = plant.sensed
    return rows


def commanded(columns: int = COMMANDS) -> FloatArray:
    scale = np.concatenate([AUTHORITY, np.full(columns - COMMANDS, 3.0)])
    return np.asarray(2.0 * scale * np.random.default_rng(5).standard_normal((TICKS, columns)))


def test_inputs_of_a_plant_add_up() -> None:
    """Tones, two disturbances and an actuator: each alone, and all of them together."""
    still, commands = np.zeros((TICKS, COMMANDS)), commanded(COMMANDS + 1)
    commands[:, :COMMANDS] = 0.0
    first, second = (DisturbanceInput(held(seed), Noise(seed), "noise") for seed in (3, 4))
    force = ActuatorInput(held(6, 1), [actuator()])
    alone = [
        response(telescope(size=1.0), still),
        response(replace(telescope(), inputs=(first,)), still),
        response(replace(telescope(), inputs=(second,)), still),
        response(replace(telescope(), inputs=(force,)), commands),
    ]
    first.reset()
    second.reset()
    together = response(replace(telescope(size=1.0), inputs=(first, second, force)), commands)
    assert all(np.abs(one).max() > 1e-3 for one in alone)
    np.testing.assert_allclose(together, sum(alone), rtol=1e-9, atol=1e-10)


def test_a_force_beyond_its_authority_is_the_authority() -> None:
    plant = replace(telescope(), inputs=(ActuatorInput(held(6, 1), [actuator()]),))
    assert plant.limits.tolist() == [*AUTHORITY, 3.0]
    commands = commanded(COMMANDS + 1)
    found = response(plant, commands)
    plant.reset()
    np.testing.assert_array_equal(found, response(plant, np.clip(commands, -plant.limits, plant.limits)))


def test_limits_of_devices_change_no_truth_of_slow_commands() -> None:
    """They filter and round the measurement; a command within rate and stroke is applied as it is."""
    plain = telescope(SILENT, 1.0)
    commands = np.zeros((TICKS, COMMANDS))
    commands[:, MIRROR], commands[:, FORCES] = 1e-3, 1.0
    limited = replace(plain, devices=LimitedDevices(DeviceLimits(), ACTUATOR, plain.limits))
    first, second = response(plain, commands), response(limited, commands)
    assert first[:, MEASUREMENTS:].tobytes() == second[:, MEASUREMENTS:].tobytes()
    assert not np.array_equal(first[:, :MEASUREMENTS], second[:, :MEASUREMENTS])


def test_the_time_of_a_disturbance_goes_on_while_it_is_off() -> None:
    """Of one that the sensors feel and the state does not: the same values as if it had never been off."""
    felt = np.vstack([np.zeros((N, 3)), held(3)[N:]])
    always, cut = (replace(telescope(), inputs=(DisturbanceInput(felt, Noise(3), "n"),)) for _ in range(2))
    still = np.zeros((50, COMMANDS))
    response(always, still)
    cut.change("disturbance", 0.0)
    assert not response(cut, still).any()
    cut.change("disturbance", 1.0)
    expected = response(always, still)
    assert expected.any()
    np.testing.assert_array_equal(response(cut, still), expected)


@pytest.mark.parametrize("again", [Plant.reset, lambda plant: None])
def test_a_reset_gives_the_same_bits(again: Callable[[Plant], None]) -> None:
    """After changes of all settings too; a plant that goes on has others."""
    plant, commands = whole(), commanded(COMMANDS + 1)
    first = response(plant, commands), plant.readings.copy()
    for name in ("noise", "disturbance", "camera_dropout"):
        plant.change(name, 0.0)
    response(plant, commands)
    again(plant)
    second = response(plant, commands), plant.readings.copy()
    same = again is Plant.reset
    assert (first[0].tobytes() == second[0].tobytes()) == same
    assert np.array_equal(first[1], second[1]) == same


def test_mistakes() -> None:
    with pytest.raises(ValueError, match=f"held of an input must have {N + SIZE} rows, got {N}"):
        replace(telescope(), inputs=(DisturbanceInput(held(3)[:N], Noise(3), "n"),))
    twice = SensorReadings([SENSOR, SENSOR], 1, noise=True)
    with pytest.raises(ValueError, match=f"further_sensors must have {FURTHER} values, got {2 * FURTHER}"):
        replace(telescope(), further_sensors=twice)
    plant = whole()
    with pytest.raises(ValueError, match="name must be noise, disturbance or camera_dropout, got 'seed'"):
        plant.change("seed", 1.0)
    with pytest.raises(ValueError):
        telescope().step(np.zeros(COMMANDS + 1), np.zeros(MEASUREMENTS), np.zeros(TRUTH))
