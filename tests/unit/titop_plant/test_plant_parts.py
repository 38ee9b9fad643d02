"""Parts of a plant: superposition of its inputs, limits of devices by their own laws, resets, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from support.loop_rows import COMMANDS, MEASUREMENTS, ROWS

from lftkit import Port, System
from lftkit.arrays import FloatArray
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import ACCELERATIONS, CAMERA, DT, FORCES, FSM_ANGLE, MIRROR, TRUTH
from titop_plant.sensors import Sensor
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.device_limits import LimitedDevices
from titop_plant.simulation.driven_plant import DisturbanceInput
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.actuators import reference_actuators
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.placed.readings import SensorReadings
from titop_plant.telescope.sections import DeviceLimits

N, PLACED, TICKS = 5, 2, 200
MEASURED = MEASUREMENTS + PLACED
SIZE = MEASURED + TRUTH
AUTHORITY = np.array([5e-3] * 2 + [30.0] * 6)
ACTUATOR, LIMITS = load_telescope().pma, load_telescope().device_limits
NONE = replace(LIMITS, **dict.fromkeys(LIMITS.SETTINGS, 0.0))
SILENT = SensorModel(np.zeros(MEASUREMENTS), np.zeros(MEASUREMENTS), 1, 0.0, 0)
NOISY = SensorModel(np.full(MEASUREMENTS, 0.1), np.linspace(-1.0, 1.0, MEASUREMENTS), 4, 0.3, 7)
EACH = np.ones(PLACED)
SENSOR = Sensor(Port("s", PLACED, "m/s2"), 0.1 * EACH, 0.2 * EACH, step=0.01, range=50.0)
QUIET = Sensor(Port("s", PLACED, "m/s2"), 0.0 * EACH, 0.0 * EACH)
PORTS = LoopPorts((*ROWS.sensors, SENSOR), reference_actuators(5e-3, 30.0))


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
    """A small plant with a sensor at a place at rest, its tone of the given size."""
    rng = np.random.default_rng(2)
    A = np.diag([-2.0, -30.0, -5.0, -5.0, -0.5])
    A[2, 3], A[3, 2] = 40.0, -40.0
    B, C, D = (rng.standard_normal(shape) for shape in ((N, 30), (SIZE, N), (SIZE, 30)))
    data = System(A, B, C, D, (Port("u", 30),), (Port("y", SIZE),))
    tones = Tones(np.array([50.0]), np.full((22, 1), size + 0j), np.zeros(1), np.array([-1]))
    dynamics = ConstantStep(plant_step(data, tones), np.zeros(N), tones.frequency)
    return Plant(dynamics, sensors, AUTHORITY, "small", readings=SensorReadings([QUIET], 1, noise=True))


def held(seed: int, columns: int = 3) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((N + SIZE, columns))


def whole() -> Plant:
    """With every part."""
    inputs = (DisturbanceInput(held(3), Noise(3), "noise"),)
    plant = replace(telescope(NOISY, 1.0), inputs=inputs, readings=SensorReadings([SENSOR], 1, noise=True))
    devices = LimitedDevices(LIMITS, ACTUATOR, PORTS)
    return replace(plant, devices=devices, camera=Frames())


def response(plant: Plant, commands: FloatArray) -> FloatArray:
    """Measurement and truth of each tick."""
    rows = np.zeros((len(commands), SIZE))
    for row, command in zip(rows, commands):
        plant.step(command, row[:MEASURED], row[MEASURED:])
    return rows


def commanded() -> FloatArray:
    return np.asarray(2.0 * AUTHORITY * np.random.default_rng(5).standard_normal((TICKS, COMMANDS)))


def test_inputs_of_a_plant_add_up() -> None:
    """Tones, two disturbances and the actuators: each alone, and all of them together."""
    still, commands = np.zeros((TICKS, COMMANDS)), commanded()
    first, second = (DisturbanceInput(held(seed), Noise(seed), "noise") for seed in (3, 4))
    alone = [
        response(telescope(size=1.0), still),
        response(replace(telescope(), inputs=(first,)), still),
        response(replace(telescope(), inputs=(second,)), still),
        response(telescope(), commands),
    ]
    first.reset()
    second.reset()
    together = response(replace(telescope(size=1.0), inputs=(first, second)), commands)
    assert all(np.abs(one).max() > 1e-3 for one in alone)
    np.testing.assert_allclose(together, sum(alone), rtol=1e-9, atol=1e-10)


def test_a_force_beyond_its_authority_is_the_authority() -> None:
    plant, commands = telescope(), commanded()
    found = response(plant, commands)
    plant.reset()
    np.testing.assert_array_equal(found, response(plant, np.clip(commands, -AUTHORITY, AUTHORITY)))


def test_limits_of_devices_change_no_truth_of_slow_commands() -> None:
    """They filter and round the measurement; a command within rate and stroke is applied as it is."""
    plain = telescope(SILENT, 1.0)
    commands = np.zeros((TICKS, COMMANDS))
    commands[:, MIRROR], commands[:, FORCES] = 1e-3, 1.0
    limited = replace(plain, devices=LimitedDevices(LIMITS, ACTUATOR, PORTS))
    first, second = response(plain, commands), response(limited, commands)
    assert first[:, MEASURED:].tobytes() == second[:, MEASURED:].tobytes()
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
    plant, commands = whole(), commanded()
    first = response(plant, commands)
    for name in ("noise", "disturbance", "camera_dropout"):
        plant.change(name, 0.0)
    response(plant, commands)
    again(plant)
    second = response(plant, commands)
    assert (first.tobytes() == second.tobytes()) == (again is Plant.reset)


def test_mistakes() -> None:
    with pytest.raises(ValueError, match=f"held of an input must have {N + SIZE} rows, got {N}"):
        replace(telescope(), inputs=(DisturbanceInput(held(3)[:N], Noise(3), "n"),))
    twice = SensorReadings([SENSOR, SENSOR], 1, noise=True)
    with pytest.raises(ValueError, match=f"sensors and readings must have {MEASURED} values, got {MEASURED + PLACED}"):
        replace(telescope(), readings=twice)
    plant = whole()
    with pytest.raises(ValueError, match="name must be noise, disturbance or camera_dropout, got 'seed'"):
        plant.change("seed", 1.0)
    with pytest.raises(ValueError):
        telescope().step(np.zeros(COMMANDS + 1), np.zeros(MEASURED), np.zeros(TRUTH))


AUTHORITIES = np.array([5.3e-3] * 2 + [31.6] * 6)


class Recorder:
    """A telescope with device limits around a stand-in, which keeps the commands and measures a known signal."""

    def __init__(self, limits: DeviceLimits, accelerations: np.ndarray | None = None) -> None:
        self.devices = LimitedDevices(limits, ACTUATOR, ROWS)
        known = np.random.default_rng(1).standard_normal((400, 18))
        self.accelerations = known if accelerations is None else accelerations
        self.reset()

    def reset(self) -> None:
        self.devices.reset()
        self.commands: list[np.ndarray] = []

    def step(self, command: np.ndarray) -> np.ndarray:
        """Measurement (22,) of a tick."""
        k, measurement = len(self.commands), np.zeros(MEASUREMENTS)
        applied = self.devices.before(command).copy()
        self.commands.append(applied)
        measurement[ACCELERATIONS] = self.accelerations[k]
        measurement[CAMERA] = 1.234e-7 if k % 20 == 0 else np.nan
        measurement[FSM_ANGLE] = applied[MIRROR]
        self.devices.after(measurement)
        return measurement


def limited(limits: DeviceLimits, commands: np.ndarray, accelerations: np.ndarray | None = None) -> tuple:
    """Measurements (n, 22), and the telescope."""
    whole = Recorder(limits, accelerations)
    return np.array([whole.step(command) for command in commands]), whole


def test_commands_change_no_faster_than_their_actuator() -> None:
    commands = np.tile(AUTHORITIES, (40, 1))
    commands[0] = 0.0
    limits = replace(LIMITS, mirror_rate=0.5, force_rate=3e3, stroke=0.0)
    _, whole = limited(limits, commands)
    applied = np.array(whole.commands)
    steps = np.diff(applied, axis=0)
    assert steps[:, MIRROR].max() == pytest.approx(0.5e-3)
    assert steps[:, FORCES].max() == pytest.approx(3.0)
    assert applied[10, 0] == pytest.approx(5e-3) and applied[11, 0] == pytest.approx(5.3e-3)


def test_the_proof_mass_stays_within_its_stroke() -> None:
    """A constant force would displace it by u / k = 100 mm; at the stop its force on the structure is zero."""
    still, command = np.zeros((4000, 18)), np.zeros(COMMANDS)
    whole = Recorder(replace(LIMITS, stroke=0.01), still)
    command[FORCES] = 7.0
    reached = []
    for _ in range(1000):
        whole.step(command)
        reached.append(whole.devices.displacement[0])
    assert max(reached) == 0.01
    first = reached.index(0.01)
    assert first * DT == pytest.approx(math.sqrt(2 * 0.01 * 2.5 / 7.0), rel=0.1)  # nearly free motion until then
    assert whole.commands[first + 1][FORCES.start] == 0.0
    _, unlimited = limited(replace(LIMITS, stroke=0.0), np.tile(command, (4000, 1)), still)
    assert unlimited.devices.displacement[0] == pytest.approx(0.1, rel=0.01)


def test_accelerations_pass_the_filter_and_start_settled() -> None:
    limits = replace(NONE, cut_off=250.0)
    seen, whole = limited(limits, np.zeros((400, COMMANDS)))
    b, a = signal.butter(2, 250.0, fs=1000.0)
    start = signal.lfilter_zi(b, a)[:, None] * whole.accelerations[0]
    expected, _ = signal.lfilter(b, a, whole.accelerations, axis=0, zi=start)
    np.testing.assert_allclose(seen[:, ACCELERATIONS], expected, rtol=1e-9, atol=1e-12)


def test_measurements_are_multiples_of_their_step() -> None:
    limits = replace(NONE, acceleration_step=1.5e-4, camera_step=5e-10, gauge_step=1.6e-7)
    seen, whole = limited(limits, np.full((100, COMMANDS), 1e-3))
    steps = seen[:, ACCELERATIONS] / 1.5e-4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(seen[:, ACCELERATIONS] - whole.accelerations[:100]).max() <= 0.75e-4 * (1 + 1e-9)
    assert seen[0, FSM_ANGLE.start] == pytest.approx(6250 * 1.6e-7)
    assert np.isnan(seen[1, CAMERA]).all() and seen[0, CAMERA.start] == pytest.approx(1.235e-7)
