"""The telescope in time against independent simulation, statistics and conservation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, signal

from titop_plant.disturbances.wheel_and_drive_tones import imbalance_tones, sadm_tones
from titop_plant.interface import COMMANDED, DT, MEASURED
from titop_plant.simulation.build import (
    DISTURBANCES,
    PlantConfig,
    build_plant,
    parameter_values,
)
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.control_plant import with_sensors
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


def test_commands_are_held_step_equals_dlsim() -> None:
    rng = np.random.default_rng(0)
    commands = np.hstack([1e-3 * rng.standard_normal((300, 2)), rng.standard_normal((300, 6))])
    measured, truth = run(replace(QUIET, camera_rate=1000.0), commands)
    data = plant_data(QUIET)
    Ad, Bd, C, D, _ = signal.cont2discrete((data.A, data.B[:, :8], data.C, data.D[:, :8]), DT)
    _, expected, _ = signal.dlsim((Ad, Bd, C, D, DT), commands)
    size = np.abs(expected).max(axis=0)
    assert np.max(np.abs(np.hstack([measured, truth]) - expected) / size) < 1e-8


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


def test_noise_has_the_standard_deviation_of_the_table() -> None:
    measured, _ = run(PlantConfig(disturbance=False, camera_rate=1000.0, seed=0), np.zeros((20000, 8)))
    table = load_telescope().to_mapping()["sensors"]
    sigma = np.r_[np.tile(table["accelerometer_noise"], 3), [1e-8] * 4]
    np.testing.assert_allclose(measured.std(axis=0), sigma, rtol=0.03)
    bias = np.tile(table["accelerometer_bias"], 3)
    np.testing.assert_allclose(measured.mean(axis=0)[:18], bias, atol=5 * sigma[:18].max() / np.sqrt(20000))


def test_camera_frames_come_at_their_rate_and_get_lost_at_theirs() -> None:
    config = PlantConfig(scenario="design", camera_rate=100.0, camera_dropout=0.25, seed=0)
    measured, _ = run(config, np.zeros((8000, 8)))
    seen = np.isfinite(measured[:, 18])
    assert not np.any(seen[np.arange(8000) % 10 != 0])
    assert 0.70 < seen[::10].mean() < 0.80
    assert np.all(np.isfinite(measured[:, :18]))


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
    from titop_plant.simulation.build import _tones

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
    from titop_plant.simulation.build import _tones

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
    from titop_plant.simulation.build import _tones

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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_rate": 300.0}, r"camera_rate must divide 1000 Hz \(50, 40, 25, \.\.\.\), got 300 Hz"),
        ({"camera_rate": 0.0}, "camera_rate must be between 1 and 1000 Hz, got 0"),
        (
            {"scenario": "quiet"},
            "scenario must be one of worst_case, unit_norm, design, imbalance, ramp, none, got 'quiet'",
        ),
        ({"camera_dropout": 1.5}, "camera_dropout must be between 0 and 1, got 1.5"),
        ({"seed": -1}, "seed must be between 0 and .*, got -1"),
        ({"ramp_duration": -1.0}, "ramp_duration must be between 0 and 86400 s, got -1"),
    ],
)
def test_bad_configurations(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlantConfig(**{"scenario": "design", **change})
