"""A disturbance of the user on the telescope: against an independent simulation, and against the same tone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from titop_plant.disturbances.wheel_and_drive_tones import given_tones
from titop_plant.interface import COMMANDED, COMMANDS, DT, MEASURED, MEASUREMENTS, TRUTH
from titop_plant.simulation import build as simulation
from titop_plant.simulation.driven_plant import (
    DISTURBANCE_COLUMNS,
    DISTURBANCE_SIZE,
    DisturbanceInput,
    held_disturbance,
)
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.load import load_telescope

QUIET = PlantConfig(disturbance=False, noise=False, theta=0.4)
FAST = [*range(18), 20, 21]
"""Columns of the measurement that have a value at every tick."""


class Signal:
    """A given table of values, one row a tick."""

    def __init__(self, rows: np.ndarray) -> None:
        self.rows, self.tick = rows, 0

    def reset(self) -> None:
        self.tick = 0

    def step(self, out: np.ndarray) -> None:
        out[:] = self.rows[self.tick]
        self.tick += 1


def driven(rows: np.ndarray, config: PlantConfig = QUIET) -> Plant:
    plant = simulation.build_plant(config, np.zeros(simulation.PlantFamily.of(config).control_loop.order))
    held = held_disturbance(simulation.PlantFamily.of(config), config, DT)
    whole = replace(plant, inputs=(DisturbanceInput(held, Signal(rows), "test:Signal"),))
    whole.reset()
    return whole


def response(plant: object, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    y, truth, seen = np.zeros(MEASUREMENTS), np.zeros(TRUTH), []
    for command in commands:
        plant.step(command, y, truth)  # type: ignore[attr-defined]
        seen.append(np.r_[y, truth])
    found = np.array(seen)
    return found[:, :MEASUREMENTS], found[:, MEASUREMENTS:]


def test_it_is_the_simulation_of_the_continuous_plant_in_tenths_of_a_tick() -> None:
    """Commands and disturbance held, ten steps a tick, from the assembled model itself."""
    rng = np.random.default_rng(1)
    ticks = 12
    rows = rng.standard_normal((ticks, DISTURBANCE_SIZE)) * 1e-2
    commands = rng.standard_normal((ticks, COMMANDS)) * np.r_[[1e-6] * 2, [1e-3] * 6]
    measured, truth = response(driven(rows), commands)

    telescope = load_telescope()
    whole = with_sensors(assembled_telescope(telescope, True).system, telescope)
    names = (*COMMANDED, "wheel_imbalance", "sadm_torque", "external_wrench")
    data = whole.select(inputs=names, outputs=(*MEASURED, "los_controlled")).at(parameter_values(QUIET, telescope))
    step = linalg.expm(data.A * DT / 10)
    n = data.A.shape[0]
    x: FloatArray = np.zeros(n)
    augmented = np.zeros((n + 1, n + 1))
    for k in range(ticks):
        u = np.r_[commands[k], rows[k]]
        y = data.C @ x + data.D @ u
        np.testing.assert_allclose(measured[k, FAST], y[FAST], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(truth[k], y[MEASUREMENTS:], rtol=1e-8, atol=1e-14)
        augmented[:n, :n], augmented[:n, n] = data.A, data.B @ u
        drift = linalg.expm(augmented * DT / 10)[:n, n]
        for _ in range(10):
            x = step @ x + drift


def test_a_slow_sine_is_the_tone_of_a_scenario() -> None:
    """Held values lag the tone by half a tick and are smaller by sinc: less than 0.2 % at 20 rad/s."""
    omega, ticks = 20.0, 2000
    amplitude = np.zeros(22)
    amplitude[0], amplitude[20] = 0.3, 0.02
    tone = (omega, *amplitude, *np.zeros(22))
    config = replace(QUIET, disturbance=True, scenario="worst_case", tones=(tone,))
    assert given_tones(config.tones).frequency.tolist() == [omega]
    continuous = simulation.build_plant(config, np.zeros(simulation.PlantFamily.of(config).control_loop.order))
    commands = np.zeros((ticks, COMMANDS))
    rows = np.zeros((ticks, DISTURBANCE_SIZE))
    rows[:, :22] = np.sin(omega * DT * (np.arange(ticks) + 0.5))[:, None] * amplitude
    _, expected = response(continuous, commands)
    _, truth = response(driven(rows), commands)
    assert np.abs(expected).max() > 1e-9
    np.testing.assert_allclose(truth, expected, atol=2e-3 * np.abs(expected).max())


def test_a_steady_wrench_turns_the_body_about_its_axis() -> None:
    """A torque about z of the bus ends, after seconds, in a line of sight that has moved; without it nothing moves."""
    rows = np.zeros((500, DISTURBANCE_SIZE))
    commands = np.zeros((500, COMMANDS))
    _, still = response(driven(rows), commands)
    assert not still.any()
    columns = DISTURBANCE_COLUMNS["external_wrench"]
    rows[:, columns.start + 3] = 1e-2
    _, once = response(driven(rows), commands)
    _, twice = response(driven(2.0 * rows), commands)
    assert np.abs(once).max() > 1e-9
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-9, atol=1e-18)
