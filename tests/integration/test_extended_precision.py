"""The simulated telescope against its equations in numbers of 160 bits behind the point: integers of any length.

The differential equations with held commands and tones are solved by one matrix exponential (Taylor series and
squarings) and stepped without any rounding that counts. Cosines are those of mpmath.
"""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest

from lftkit import System
from lftkit.analysis.eigenvectors import balanced
from lftkit.arrays import FloatArray
from titop_plant.interface import COMMANDS, DT
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.disturbances import Tones
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.simulation.ramped_plant import RampedPlant
from titop_plant.simulation.sampled_plant import SampledPlant

BITS = 160
SAME = 1e-9
"""Largest difference, over the largest value of a column."""

CONFIG = PlantConfig(scenario="design", noise=False)
HEAVY = replace(CONFIG, scenario="imbalance", theta=2.1, omega_1=1.9, omega_2=6.3)
SPEEDS = (395.0, -200.0, 150.0, -100.0)
RAMP = replace(CONFIG, scenario="ramp", wheel_speed=SPEEDS, wheel_acceleration=(8.0,) * 4, ramp_duration=1.2)
MEMBERS = {"reference": CONFIG, "turned": HEAVY, "hard": replace(CONFIG, isolated=False)}


def exact(values: FloatArray) -> np.ndarray:
    """Doubles as whole multiples of 2^-BITS (what is smaller is cut)."""

    def one(value: float) -> int:
        numerator, denominator = value.as_integer_ratio()
        return (numerator << BITS) // denominator

    flat = [one(value) for value in np.asarray(values, dtype=float).ravel().tolist()]
    return np.array([*flat, None], dtype=object)[:-1].reshape(np.shape(values))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.dot(a, b) >> BITS


def exponential(generator: np.ndarray) -> np.ndarray:
    """Of a matrix of multiples of 2^-BITS."""
    size = max(int(np.abs(generator).sum(axis=0).max()) >> BITS, 1)
    squarings = size.bit_length() + 1
    part = generator >> squarings
    total = exact(np.eye(len(generator)))
    term, k = total, 0
    while np.abs(term).max() > 0:
        k += 1
        term = product(term, part) // k
        total = total + term
    for _ in range(squarings):
        total = product(total, total)
    return total


def doubles(values: np.ndarray) -> FloatArray:
    return np.array([float(mpmath.mpf(int(value)) * mpmath.mpf(2) ** -BITS) for value in values.ravel()])


def record(data: System, tones: Tones, state: FloatArray, commands: FloatArray) -> FloatArray:
    """Measurement and truth of each tick, shape (N, 24), in extended precision."""
    n, m, K = len(data.A), COMMANDS, tones.frequency.size
    A, B, C = balanced(data.A, data.B, data.C)
    parts = exact(tones.amplitude.imag), exact(tones.amplitude.real)
    drive = [product(exact(B[:, m:]), part) for part in parts]
    through = [product(exact(data.D[:, m:]), part) for part in parts]
    size = n + m + 2 * K
    whole, outputs = exact(np.zeros((size, size))), exact(np.zeros((24, size)))
    whole[:n, :n], whole[:n, n : n + m] = exact(A), exact(B[:, :m])
    outputs[:, :n], outputs[:, n : n + m] = exact(C), exact(data.D[:, :m])
    for k, w in enumerate(exact(tones.frequency)):
        re, im = n + m + 2 * k, n + m + 2 * k + 1
        whole[:n, re], whole[:n, im] = drive[0][:, k], drive[1][:, k]
        outputs[:, re], outputs[:, im] = through[0][:, k], through[1][:, k]
        whole[re, im], whole[im, re] = -w, w
    over = exponential(whole * exact(np.array([DT]))[0] >> BITS)
    z = exact(np.zeros(size))
    z[:n] = exact(state / _units(data.A))
    z[n + m :: 2] = 1 << BITS
    rows = []
    for command in exact(commands):
        z[n : n + m] = command
        rows.append(product(outputs, z))
        z = product(over, z)
    return doubles(np.array(rows)).reshape(len(rows), 24)


def _units(A: FloatArray) -> FloatArray:
    """Of the balanced states."""
    B = balanced(A, np.eye(len(A)), np.eye(len(A)))[1]
    return np.asarray(1.0 / np.diag(B))


def simulated(plant: SampledPlant, commands: FloatArray) -> FloatArray:
    rows = np.zeros((len(commands), 24))
    for command, row in zip(commands, rows):
        plant.step(command, row[:22], row[22:])
    return rows


def commands_for(plant: SampledPlant, ticks: int) -> FloatArray:
    return np.random.default_rng(2).uniform(-0.01, 0.01, (ticks, COMMANDS)) * plant.limits


@pytest.mark.slow
@pytest.mark.parametrize("name", MEMBERS)
def test_two_thousand_ticks_are_those_of_extended_precision(name: str) -> None:
    config = MEMBERS[name]
    family = PlantFamily.of(config)
    plant = family.build(replace(config, camera_rate=1000.0))
    data, tones = family.plant_and_tones(config)
    commands = commands_for(plant, 2000)
    expected, found = record(data, tones, plant.state, commands), simulated(plant, commands)
    error = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert error.max() < SAME, error


@pytest.mark.slow
def test_ticks_of_a_ramp_are_its_recursion_in_extended_precision() -> None:
    """Of the same step matrices, interpolated: what rounding adds."""
    family = PlantFamily.of(RAMP)
    plant = family.build(replace(RAMP, camera_rate=1000.0))
    assert isinstance(plant, RampedPlant)
    commands = commands_for(plant, 2000)
    n, nodes = plant.state.size, [exact(node.T) for node in plant._nodes[:3]]
    x, expected = exact(plant.state), []
    for k, command in enumerate(commands):
        place = (k + 0.5) / plant._interval
        node, share = int(place), exact(np.array([place - int(place)]))[0]
        p = plant._moving.phasors(k * DT).view(float)
        z = np.concatenate([x, exact(command), exact(p)])
        near = product(nodes[min(node, 2)], z)
        out = near + ((product(nodes[node + 1], z) - near) * share >> BITS) if node < 2 else near
        x = out[:n]
        expected.append(out[n:])
    wanted = doubles(np.array(expected)).reshape(-1, 24)
    error = np.abs(simulated(plant, commands) - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    assert error.max() < SAME, error
