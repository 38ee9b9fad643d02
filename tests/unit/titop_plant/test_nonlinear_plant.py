"""Limits of devices: rates, stroke, filter and quantisation, each by its own law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from titop_plant.interface import ACCELERATIONS, CAMERA, COMMANDS, DT, FORCES, FSM_ANGLE, MEASUREMENTS, MIRROR
from titop_plant.simulation.device_limits import DeviceLimits, LimitedDevices
from titop_plant.telescope.load import load_telescope

ACTUATOR = load_telescope().pma


LIMITS = np.array([5.3e-3] * 2 + [31.6] * 6)


class Recorder:
    """A telescope with device limits around a stand-in, which keeps the commands and measures a known signal."""

    def __init__(self, limits: DeviceLimits, accelerations: np.ndarray | None = None) -> None:
        self.devices = LimitedDevices(limits, ACTUATOR, LIMITS)
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


def run(limits: DeviceLimits, commands: np.ndarray, accelerations: np.ndarray | None = None) -> tuple:
    """Measurements (n, 22), and the telescope."""
    whole = Recorder(limits, accelerations)
    return np.array([whole.step(command) for command in commands]), whole


def test_commands_change_no_faster_than_their_actuator() -> None:
    commands = np.tile(LIMITS, (40, 1))
    commands[0] = 0.0
    limits = DeviceLimits(mirror_rate=0.5, force_rate=3e3, stroke=math.inf)
    _, whole = run(limits, commands)
    applied = np.array(whole.commands)
    steps = np.diff(applied, axis=0)
    assert steps[:, MIRROR].max() == pytest.approx(0.5e-3)
    assert steps[:, FORCES].max() == pytest.approx(3.0)
    assert applied[10, 0] == pytest.approx(5e-3) and applied[11, 0] == pytest.approx(5.3e-3)


def test_the_proof_mass_stays_within_its_stroke() -> None:
    """A constant force would displace it by u / k = 100 mm; at the stop its force on the structure is zero."""
    still, command = np.zeros((4000, 18)), np.zeros(COMMANDS)
    whole = Recorder(DeviceLimits(stroke=0.01), still)
    command[FORCES] = 7.0
    reached = []
    for _ in range(1000):
        whole.step(command)
        reached.append(whole.devices.displacement[0])
    assert max(reached) == 0.01
    first = reached.index(0.01)
    assert first * DT == pytest.approx(math.sqrt(2 * 0.01 * 2.5 / 7.0), rel=0.1)  # nearly free motion until then
    assert whole.commands[first + 1][FORCES.start] == 0.0
    _, unlimited = run(DeviceLimits(stroke=math.inf), np.tile(command, (4000, 1)), still)
    assert unlimited.devices.displacement[0] == pytest.approx(0.1, rel=0.01)


def test_accelerations_pass_the_filter_and_start_settled() -> None:
    limits = DeviceLimits(math.inf, math.inf, math.inf, 250.0, 0.0, 0.0, 0.0)
    seen, whole = run(limits, np.zeros((400, COMMANDS)))
    b, a = signal.butter(2, 250.0, fs=1000.0)
    start = signal.lfilter_zi(b, a)[:, None] * whole.accelerations[0]
    expected, _ = signal.lfilter(b, a, whole.accelerations, axis=0, zi=start)
    np.testing.assert_allclose(seen[:, ACCELERATIONS], expected, rtol=1e-9, atol=1e-12)


def test_measurements_are_multiples_of_their_step() -> None:
    limits = DeviceLimits(math.inf, math.inf, math.inf, 0.0, 1.5e-4, 5e-10, 1.6e-7)
    seen, whole = run(limits, np.full((100, COMMANDS), 1e-3))
    steps = seen[:, ACCELERATIONS] / 1.5e-4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(seen[:, ACCELERATIONS] - whole.accelerations[:100]).max() <= 0.75e-4 * (1 + 1e-9)
    assert seen[0, FSM_ANGLE.start] == pytest.approx(6250 * 1.6e-7)
    assert np.isnan(seen[1, CAMERA]).all() and seen[0, CAMERA.start] == pytest.approx(1.235e-7)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mirror_rate": 0.0}, "mirror_rate must be positive, got 0"),
        ({"stroke": -1.0}, "stroke must be positive"),
        ({"gauge_step": -1.0}, "gauge_step must be 0 or more"),
        ({"cut_off": 500.0}, "cut_off must be from 0 to 500 Hz, got 500"),
    ],
)
def test_mistakes(values: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DeviceLimits(**values)
