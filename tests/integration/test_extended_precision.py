"""The simulated telescope against its equations in the extended precision of the processor (64 bits of mantissa).

The differential equations with held commands and tones are solved by one matrix exponential of balanced states (Taylor
series and squarings).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.loop_rows import COMMANDS

from lftkit import System
from lftkit.analysis.eigenvectors import balanced
from lftkit.arrays import FloatArray
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import DT
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.simulation.ramped_step import RampedStep

SAME = 1e-9
"""Largest difference, over the largest value of a column."""

CONFIG = PlantConfig(scenario="design", noise=False)
HEAVY = replace(CONFIG, scenario="imbalance", theta=2.1, omega_1=0.71)
SPEEDS = (395.0, -200.0, 150.0, -100.0)
RAMP = replace(CONFIG, scenario="ramp", wheel_speed=SPEEDS, wheel_acceleration=(8.0,) * 4, ramp_duration=1.2)
MEMBERS = {"reference": CONFIG, "turned": HEAVY, "hard": replace(CONFIG, isolated=False)}


pytestmark = pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="this processor has no extended precision")


def wide(values: FloatArray) -> np.ndarray:
    return np.asarray(values, dtype=np.longdouble)


def exponential(generator: np.ndarray) -> np.ndarray:
    """By Taylor series and squarings."""
    squarings = max(0, math.frexp(float(np.abs(generator).sum(axis=0).max()))[1]) + 3
    part = generator / 2.0**squarings
    total = wide(np.eye(len(generator)))
    term, k = total, 0
    while np.abs(term).max() > 1e-25:
        k += 1
        term = term @ part / k
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total


def record(data: System, tones: Tones, state: FloatArray, commands: FloatArray) -> FloatArray:
    """Measurement and truth of each tick, shape (N, 24), in extended precision."""
    n, m, K = len(data.A), COMMANDS, tones.frequency.size
    A, B, C = (wide(matrix) for matrix in balanced(data.A, data.B, data.C))
    parts = wide(tones.amplitude.imag), wide(tones.amplitude.real)
    drive, through = ([matrix[:, m:] @ part for part in parts] for matrix in (B, wide(data.D)))
    size = n + m + 2 * K
    whole, outputs = wide(np.zeros((size, size))), wide(np.zeros((24, size)))
    whole[:n, :n], whole[:n, n : n + m] = A, B[:, :m]
    outputs[:, :n], outputs[:, n : n + m] = C, data.D[:, :m]
    for k, w in enumerate(tones.frequency):
        re, im = n + m + 2 * k, n + m + 2 * k + 1
        whole[:n, re], whole[:n, im] = drive[0][:, k], drive[1][:, k]
        outputs[:, re], outputs[:, im] = through[0][:, k], through[1][:, k]
        whole[re, im], whole[im, re] = -w, w
    over = exponential(whole * wide(np.array(DT)))
    z = wide(np.zeros(size))
    z[:n] = state / _units(data.A)
    z[n + m :: 2] = 1.0
    rows = np.empty((len(commands), 24))
    for row, command in zip(rows, commands):
        z[n : n + m] = command
        row[:] = outputs @ z
        z = over @ z
    return rows


def _units(A: FloatArray) -> FloatArray:
    """Of the balanced states."""
    B = balanced(A, np.eye(len(A)), np.eye(len(A)))[1]
    return np.asarray(1.0 / np.diag(B))


def simulated(plant: Plant, commands: FloatArray) -> FloatArray:
    rows = np.zeros((len(commands), 24))
    for command, row in zip(commands, rows):
        plant.step(command, row[:22], row[22:])
    return rows


def commands_for(plant: Plant, ticks: int) -> FloatArray:
    return np.random.default_rng(2).uniform(-0.01, 0.01, (ticks, COMMANDS)) * plant.authority


@pytest.mark.further
@pytest.mark.parametrize(
    "name", ["reference", *(pytest.param(name, marks=pytest.mark.slow) for name in ("turned", "hard"))]
)
def test_ticks_are_those_of_extended_precision(name: str) -> None:
    config = MEMBERS[name]
    family = PlantFamily.of(config)
    plant = family.build(replace(config, camera_rate=1000.0))
    data, tones = family.plant_and_tones(config)
    commands = commands_for(plant, 600)
    expected, found = record(data, tones, plant.state, commands), simulated(plant, commands)
    error = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert error.max() < SAME, error


@pytest.mark.slow
def test_ticks_of_a_ramp_are_its_recursion_in_extended_precision() -> None:
    """Of the same step matrices, interpolated: what rounding adds."""
    family = PlantFamily.of(RAMP)
    plant = family.build(replace(RAMP, camera_rate=1000.0))
    ramp = plant.dynamics
    assert isinstance(ramp, RampedStep)
    commands = commands_for(plant, 2000)
    n, nodes = plant.state.size, [wide(node.T) for node in ramp.nodes[:3]]
    x, expected = wide(plant.state), []
    for k, command in enumerate(commands):
        place = (k + 0.5) / ramp.interval
        node = int(place)
        z = np.concatenate([x, command, ramp.moving.phasors(k * DT).view(float)])
        near = nodes[min(node, 2)] @ z
        out = near + (nodes[node + 1] @ z - near) * (place - node) if node < 2 else near
        x = out[:n]
        expected.append(out[n:])
    wanted = np.array(expected, dtype=float)
    error = np.abs(simulated(plant, commands) - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    assert error.max() < SAME, error
