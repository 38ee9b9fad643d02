"""Limits of devices around a linear plant: rates, stroke, filter and quantisation, each by its own law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from titop_plant.interface import ACCELERATIONS, CAMERA, COMMANDS, DT, FORCES, FSM_ANGLE, MEASUREMENTS, MIRROR
from titop_plant.simulation.nonlinear_plant import DeviceLimits, NonlinearPlant

ACTUATOR = {"moving_mass": 2.5, "stiffness": 70.0, "damping": 10.0}
NONE = DeviceLimits(math.inf, math.inf, math.inf, 0.0, 0.0, 0.0, 0.0)


class Recorder:
    """Stands for the telescope: keeps the commands, and measures a known signal."""

    dt, frame_ticks = DT, 20
    tones = np.array([1.0])
    limits = np.array([5.3e-3] * 2 + [31.6] * 6)
    parameters_hash = "linear"

    def __init__(self, accelerations: np.ndarray | None = None) -> None:
        self.accelerations = (
            np.random.default_rng(1).standard_normal((400, 18)) if accelerations is None else accelerations
        )
        self.reset()

    def reset(self) -> None:
        self.commands: list[np.ndarray] = []

    def step(self, command: np.ndarray, measurement: np.ndarray, truth: np.ndarray) -> None:
        k = len(self.commands)
        self.commands.append(command.copy())
        measurement[ACCELERATIONS] = self.accelerations[k]
        measurement[CAMERA] = 1.234e-7 if k % self.frame_ticks == 0 else np.nan
        measurement[FSM_ANGLE] = command[MIRROR]
        truth[:] = 1.234567e-9 * k


def run(
    limits: DeviceLimits, commands: np.ndarray, plant: Recorder | None = None
) -> tuple[np.ndarray, Recorder, NonlinearPlant]:
    inner = plant or Recorder()
    whole = NonlinearPlant(inner, limits, ACTUATOR)  # type: ignore[arg-type]
    y, truth, seen = np.zeros(MEASUREMENTS), np.zeros(2), []
    for k, command in enumerate(commands):
        whole.step(command, y, truth)
        seen.append(y.copy())
        assert truth[0] == 1.234567e-9 * k
    return np.array(seen), inner, whole


def test_without_limits_it_is_the_linear_plant() -> None:
    commands = np.random.default_rng(2).standard_normal((100, COMMANDS)) * Recorder.limits
    seen, inner, _ = run(NONE, commands)
    np.testing.assert_array_equal(np.array(inner.commands), np.clip(commands, -Recorder.limits, Recorder.limits))
    np.testing.assert_array_equal(seen[:, ACCELERATIONS], inner.accelerations[:100])


def test_commands_change_no_faster_than_their_actuator() -> None:
    commands = np.tile(Recorder.limits, (40, 1))
    commands[0] = 0.0
    limits = DeviceLimits(mirror_rate=0.5, force_rate=3e3, stroke=math.inf)
    _, inner, _ = run(limits, commands)
    applied = np.array(inner.commands)
    steps = np.diff(applied, axis=0)
    assert steps[:, MIRROR].max() == pytest.approx(0.5e-3)
    assert steps[:, FORCES].max() == pytest.approx(3.0)
    assert applied[10, 0] == pytest.approx(5e-3) and applied[11, 0] == pytest.approx(5.3e-3)


def test_the_proof_mass_stays_within_its_stroke() -> None:
    """A constant force would displace it by u / k = 100 mm; at the stop its force on the structure is zero."""
    still = Recorder(np.zeros((4000, 18)))
    whole = NonlinearPlant(still, DeviceLimits(stroke=0.01), ACTUATOR)  # type: ignore[arg-type]
    command, y, truth = np.zeros(COMMANDS), np.zeros(MEASUREMENTS), np.zeros(2)
    command[FORCES] = 7.0
    reached = []
    for _ in range(1000):
        whole.step(command, y, truth)
        reached.append(whole.displacement[0])
    assert max(reached) == 0.01
    first = reached.index(0.01)
    assert first * DT == pytest.approx(math.sqrt(2 * 0.01 * 2.5 / 7.0), rel=0.1)  # nearly free motion until then
    assert still.commands[first + 1][FORCES.start] == 0.0
    free, _, unlimited = run(DeviceLimits(stroke=math.inf), np.tile(command, (4000, 1)), Recorder(np.zeros((4000, 18))))
    assert unlimited.displacement[0] == pytest.approx(0.1, rel=0.01)
    assert len(free) == 4000


def test_a_force_that_points_back_is_applied() -> None:
    commands = np.zeros((600, COMMANDS))
    commands[:300, FORCES], commands[300:, FORCES] = 7.0, -7.0
    _, inner, _ = run(DeviceLimits(stroke=0.005, force_rate=math.inf), commands, Recorder(np.zeros((600, 18))))
    assert np.array(inner.commands)[300, FORCES.start] == -7.0


def test_accelerations_pass_the_filter_and_start_settled() -> None:
    plant = Recorder()
    limits = DeviceLimits(math.inf, math.inf, math.inf, 250.0, 0.0, 0.0, 0.0)
    seen, _, _ = run(limits, np.zeros((400, COMMANDS)), plant)
    b, a = signal.butter(2, 250.0, fs=1000.0)
    start = signal.lfilter_zi(b, a)[:, None] * plant.accelerations[0]
    expected, _ = signal.lfilter(b, a, plant.accelerations, axis=0, zi=start)
    np.testing.assert_allclose(seen[:, ACCELERATIONS], expected, rtol=1e-9, atol=1e-12)


def test_measurements_are_multiples_of_their_step() -> None:
    limits = DeviceLimits(math.inf, math.inf, math.inf, 0.0, 1.5e-4, 5e-10, 1.6e-7)
    plant = Recorder()
    seen, _, _ = run(limits, np.full((100, COMMANDS), 1e-3), plant)
    steps = seen[:, ACCELERATIONS] / 1.5e-4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(seen[:, ACCELERATIONS] - plant.accelerations[:100]).max() <= 0.75e-4 * (1 + 1e-9)
    assert seen[0, FSM_ANGLE.start] == pytest.approx(6250 * 1.6e-7)
    assert np.isnan(seen[1, CAMERA]).all() and seen[0, CAMERA.start] == pytest.approx(1.235e-7)


def test_a_reset_gives_the_same_bits() -> None:
    commands = np.random.default_rng(3).standard_normal((200, COMMANDS))
    first, inner, whole = run(DeviceLimits(), commands)
    whole.reset()
    y, truth = np.zeros(MEASUREMENTS), np.zeros(2)
    again = []
    for command in commands:
        whole.step(command, y, truth)
        again.append(y.copy())
    np.testing.assert_array_equal(np.array(again), first)
    assert len(inner.commands) == 200


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
