"""The telescope in time: exact tones, held commands and disturbances, scenarios, the plant of the design."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, signal
from support.loop_rows import COMMANDS, MEASUREMENTS

from lftkit import Port
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.systems.ports import total_size
from titop_plant.disturbances.wheel_and_drive_tones import imbalance_tones, sadm_tones
from titop_plant.interface import COMMANDED, DT, HOLD_DELAY, MEASURED, TRUTH
from titop_plant.simulation import build as simulation
from titop_plant.simulation.build import _tones, build_plant
from titop_plant.simulation.driven_plant import (
    DisturbanceInput,
    driven_ports,
    held_disturbance,
)
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.control_plant import (
    DISTURBANCES,
    held_commands,
    sample_hold,
    with_sensors,
)
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import weight_amplitudes

QUIET = PlantConfig(noise=False, disturbance=False)


def run(config: PlantConfig, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    plant = build_plant(config)
    measured, truth = np.zeros((len(commands), 22)), np.zeros((len(commands), 2))
    for k, command in enumerate(commands):
        plant.step(command, measured[k], truth[k])
    return measured, truth


def plant_data(config: PlantConfig):
    telescope = load_telescope()
    whole = with_sensors(assembled_telescope(telescope).system, telescope)
    part = whole.select(inputs=(*COMMANDED, *DISTURBANCES), outputs=(*MEASURED, "los_controlled"))
    return part.at(parameter_values(config, telescope))


def test_tones_are_integrated_exactly() -> None:
    """From rest in steady state the line of sight is the frequency response times the tone, above Nyquist too."""
    config = replace(QUIET, disturbance=True, scenario="imbalance", seed=3)
    _, truth = run(config, np.zeros((400, 8)))
    data, telescope = plant_data(config), load_telescope()
    plant = build_plant(config)
    assert plant.tones.max() > np.pi / DT  # beyond half the sampling rate
    speeds = np.array(telescope.default_speeds)
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(99,)))
    t = DT * np.arange(400)
    expected = np.zeros((400, 2))
    for tones in (imbalance_tones(telescope, speeds, rng), sadm_tones(telescope, rng)):
        for k, w in enumerate(tones.frequency):
            H = data.C[22:] @ np.linalg.solve(1j * w * np.eye(len(data.A)) - data.A, data.B[:, 8:])
            expected += np.imag(np.outer(np.exp(1j * w * t), H @ tones.amplitude[:, k]))
    assert np.max(np.abs(truth - expected)) < 1e-6 * np.abs(expected).max()


def test_imbalance_grows_with_the_square_of_the_speed() -> None:
    telescope = load_telescope()
    slow, fast = (imbalance_tones(telescope, np.array([s, 0, 0, 0]), np.random.default_rng(1)) for s in (100.0, 300.0))
    np.testing.assert_allclose(fast.amplitude, 9.0 * slow.amplitude, rtol=1e-12)
    np.testing.assert_allclose(fast.frequency, 3.0 * slow.frequency)
    top = imbalance_tones(telescope, np.full(4, 1047.2), np.random.default_rng(1))
    one = top.amplitude[:5, np.flatnonzero((top.wheel == 0) & (top.harmonic == 1.0))]
    np.testing.assert_allclose(np.abs(one).sum(axis=1), [0.4, 0.4, 0.35, 0.3, 0.3], rtol=5e-3)


def test_drive_torque_stays_within_its_bound() -> None:
    telescope = load_telescope()
    tones = sadm_tones(telescope, np.random.default_rng(0))
    assert np.all(np.abs(tones.amplitude[20:]).sum(axis=1) <= telescope.sadm.torque_bound * (1 + 1e-12))
    assert np.all(tones.amplitude[:20] == 0)


def test_design_tones_have_unit_norm_within_the_band() -> None:
    telescope = load_telescope()
    config = PlantConfig(scenario="design", seed=0)
    tones = _tones(config, telescope, parameter_values(config, telescope))
    low, high = telescope.design_scenario.band
    assert np.all((tones.frequency >= low) & (tones.frequency <= high))
    for k, w in enumerate(tones.frequency):
        normalised = tones.amplitude[:, k] / weight_amplitudes(telescope, w)[0]
        assert np.linalg.norm(normalised) == pytest.approx(1.0, rel=1e-12)
        assert (not normalised[:20].any()) or (not normalised[20:].any())


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_unit_norm_shares_a_norm_of_one_among_the_design_tones(seed: int) -> None:
    """Frequencies, directions and phases of the scenario design; other shares with each seed."""
    telescope = load_telescope()
    config = PlantConfig(scenario="unit_norm", seed=seed)
    values = parameter_values(config, telescope)
    shared, single = _tones(config, telescope, values), _tones(replace(config, scenario="design"), telescope, values)
    np.testing.assert_array_equal(shared.frequency, single.frequency)
    shares = np.linalg.norm(shared.amplitude, axis=0) / np.linalg.norm(single.amplitude, axis=0)
    np.testing.assert_allclose(shared.amplitude, single.amplitude * shares, rtol=1e-14)
    assert np.ptp(shares) > 0.1
    normalised = shared.amplitude / weight_amplitudes(telescope, shared.frequency).T
    assert np.linalg.norm(normalised, axis=0).sum() == pytest.approx(1.0, rel=1e-12)


def test_design_tones_are_kept_for_the_same_telescope_table_and_seed_alone() -> None:
    """Those that are kept cannot be changed; another seed turns each tone as a whole."""
    telescope, config = load_telescope(), PlantConfig(scenario="design", seed=0)
    values = parameter_values(config, telescope)
    first = _tones(config, telescope, values)
    assert _tones(replace(config), load_telescope(), dict(values)) is first
    with pytest.raises(ValueError, match="read-only"):
        first.amplitude[0, 0] = 0.0
    turned = _tones(replace(config, seed=config.seed + 1), telescope, values)
    ratio = np.sum(turned.amplitude * first.amplitude.conj(), axis=0) / np.sum(np.abs(first.amplitude) ** 2, axis=0)
    np.testing.assert_allclose(turned.amplitude, ratio * first.amplitude, atol=1e-12 * np.abs(first.amplitude).max())
    assert np.abs(np.abs(ratio) - 1.0).max() < 1e-12 < np.abs(ratio - 1.0).min()
    fewer = telescope.changed({"design_scenario": {"tones": 2}})
    assert _tones(config, fewer, values).frequency.size == 3 < first.frequency.size
    assert _tones(config, telescope, {**values, "solar_array.tau": 0.5}).frequency.tolist() != first.frequency.tolist()


STILL = PlantConfig(disturbance=False, noise=False, theta=0.4)

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


def driven(rows: np.ndarray, config: PlantConfig = STILL) -> Plant:
    plant = simulation.build_plant(config, np.zeros(simulation.PlantFamily.of(config).control_loop.order))
    held = held_disturbance(simulation.PlantFamily.of(config), config, DT)
    whole = replace(plant, inputs=(DisturbanceInput(held, Signal(rows), "test:Signal"),))
    whole.reset()
    return whole


def driven_response(plant: object, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    rows = rng.standard_normal((ticks, total_size(driven_ports(load_telescope())))) * 1e-2
    commands = rng.standard_normal((ticks, COMMANDS)) * np.r_[[1e-6] * 2, [1e-3] * 6]
    measured, truth = driven_response(driven(rows), commands)

    telescope = load_telescope()
    whole = with_sensors(assembled_telescope(telescope, True).system, telescope)
    names = (*COMMANDED, "wheel_imbalance", "sadm_torque", "external_wrench")
    data = whole.select(inputs=names, outputs=(*MEASURED, "los_controlled")).at(parameter_values(STILL, telescope))
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


COMMAND_COLUMNS = {"mirror": slice(22, 24), "actuators": slice(24, 30)}

ACCELERATIONS, LOS = slice(2, 20), slice(0, 2)


@pytest.fixture(scope="module")
def plant():
    outputs = ("los_controlled", *MEASURED)
    return with_sensors(assembled_telescope().system, load_telescope()).select(
        inputs=(*DISTURBANCES, *COMMANDED), outputs=outputs
    )


def sampled_response(data, omega):
    """Held for a tick and sampled, exactly: the commands' columns only."""
    n, B = len(data.A), data.B[:, 22:]
    step = linalg.expm(np.block([[data.A, B], [np.zeros((8, n + 8))]]) * DT)
    response = np.zeros(data.D.shape, complex)
    z = np.exp(1j * omega * DT)
    response[:, 22:] = data.C @ np.linalg.solve(z * np.eye(n) - step[:n, :n], step[:n, n:]) + data.D[:, 22:]
    return response


def error(trial, exact, rows, columns):
    return np.linalg.norm((trial - exact)[rows, columns]) / np.linalg.norm(exact[rows, columns])


@pytest.mark.parametrize("omega", [0.3, 5.0, 20.0, 100.0])
def test_held_commands_are_close_to_the_sampled_plant_and_one_delay_is_not(plant, omega) -> None:
    exact = sampled_response(plant.at({}), omega)
    held = frequency_response(held_commands(plant, HOLD_DELAY).at({}), [omega])[0]
    one_delay = frequency_response(plant.at({}), [omega])[0] * np.exp(-1j * omega * HOLD_DELAY)
    for columns in COMMAND_COLUMNS.values():
        assert error(held, exact, LOS, columns) < 1e-3
        assert error(held, exact, ACCELERATIONS, columns) < 0.11
        ratio = error(one_delay, exact, ACCELERATIONS, columns) / error(held, exact, ACCELERATIONS, columns)
        assert ratio > 8.0


def test_nothing_is_added_without_a_hold(plant) -> None:
    assert held_commands(plant, 0.0) is plant


def test_a_held_frame_is_as_old_as_the_mean_of_its_ticks() -> None:
    hold = sample_hold(Port("camera_los", 2, "rad"), 0.02).at({})
    for omega in (0.5, 5.0, 30.0):
        mean = np.mean(np.exp(-1j * omega * DT * np.arange(20)))
        phase = np.angle(frequency_response(hold, [omega])[0][0, 0])
        assert phase == pytest.approx(np.angle(mean), rel=1e-3)


def test_energy_of_the_undamped_telescope_is_conserved() -> None:
    """Without damping and attitude law the sampled motion keeps the energy of the second-order model."""
    tables = load_telescope().to_mapping()
    for name, key in (
        ("body", "damping"),
        ("payload", "damping"),
        ("solar_array", "damping"),
        ("sadm", "gearbox_damping"),
        ("fsm", "damping"),
        ("pma", "damping"),
    ):
        tables[name][key] = 0.0
    tables["isolator"]["damping"] = [0.0] * 6
    free = build_telescope(Telescope(tables), attitude_controlled=False).system
    data = free.select(inputs=(*COMMANDED, *DISTURBANCES)).at({})
    poles = linalg.eigvals(data.A)
    moving = np.abs(poles) > 0.1
    assert np.max(np.abs(poles[moving].real) / np.abs(poles[moving])) < 1e-9
    n = len(data.A)
    flow = linalg.expm(data.A * DT)
    start = np.random.default_rng(0).standard_normal(n)
    # An energy is a quadratic form that the motion conserves: amplitude of every mode stays what it was.
    values, vectors = linalg.eig(data.A)
    amplitude = np.linalg.solve(vectors, start)[np.abs(values) > 0.1]
    state = np.linalg.matrix_power(flow, 10000) @ start
    later = np.linalg.solve(vectors, state)[np.abs(values) > 0.1]
    assert np.max(np.abs(np.abs(later) - np.abs(amplitude)) / np.abs(amplitude).max()) < 1e-6


def test_commands_are_held_step_equals_dlsim() -> None:
    rng = np.random.default_rng(0)
    commands = np.hstack([1e-3 * rng.standard_normal((300, 2)), rng.standard_normal((300, 6))])
    measured, truth = run(replace(QUIET, camera_rate=1000.0), commands)
    data = plant_data(QUIET)
    Ad, Bd, C, D, _ = signal.cont2discrete((data.A, data.B[:, :8], data.C, data.D[:, :8]), DT)
    _, expected, _ = signal.dlsim((Ad, Bd, C, D, DT), commands)
    size = np.abs(expected).max(axis=0)
    assert np.max(np.abs(np.hstack([measured, truth]) - expected) / size) < 1e-8
