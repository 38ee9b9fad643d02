"""The reference telescope and that of the paper: order, occurrences, optics, calibration, figures of the paper."""

from __future__ import annotations

import itertools
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import frequency_response
from lftkit.systems.minimal import minimal_realisation
from los_loop.continuous_loop import continuous_open_loop
from titop_plant.disturbances.responses import DRIVES, WHEELS, disturbance_responses
from titop_plant.structures import smallest_residual_fraction
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

OCCURRENCES = {
    **{f"wheel_{i}.speed": 2 for i in range(1, 5)},
    "solar_array.omega_1": 4,
    "solar_array.omega_2": 4,
    "solar_array.tau": 32,
}
ARCSEC = np.pi / 648000.0


@pytest.fixture(scope="module")
def system():
    return assembled_telescope().system


def corners(telescope) -> list[dict[str, float]]:
    """Wheels 1, 3 and wheels 2, 4 at either limit of their speed, angle and frequencies at either limit."""
    table = telescope.uncertain
    result = []
    for a, b, w1, w2, tau in itertools.product(*[(0, 1)] * 5):
        ends = {name: (p.lower, p.upper) for name, p in table.items()}
        values = {f"wheel_{i}.speed": ends[f"wheel_{i}.speed"][a if i % 2 else b] for i in range(1, 5)}
        values["solar_array.omega_1"] = ends["solar_array.omega_1"][w1]
        values["solar_array.omega_2"] = ends["solar_array.omega_2"][w2]
        values["solar_array.tau"] = ends["solar_array.tau"][tau]
        result.append(values)
    return result


def test_order_and_occurrences(system) -> None:
    for plant in (system, assembled_telescope(load_telescope(FILE)).system):
        assert (plant.order, plant.occurrences()) == (204, OCCURRENCES)


def test_the_realisation_is_minimal(system) -> None:
    """No state is uncontrollable or unobservable, no occurrence is redundant."""
    result = minimal_realisation(system)
    assert result.removed_states == 0
    assert result.removed_occurrences == dict.fromkeys(OCCURRENCES, 0)


def test_stable_and_no_slow_pole_at_any_parameter_value(system, telescope) -> None:
    draws = system.sample_values(np.random.default_rng(0), 20)
    for values in [{}, *corners(telescope), *draws]:
        poles = linalg.eigvals(system.at(values).A)
        assert poles.real.max() < 0.0, values
        assert np.abs(poles).min() > 1e-3, values


def test_line_of_sight_identities(telescope) -> None:
    """Rigid translation of all elements gives 0, rigid rotation about any point gives 1."""
    optics = telescope.optics
    d, b = optics.mirror_distance, optics.back_focal_distance
    assert d + b == pytest.approx(optics.magnification * (optics.primary_focal_length - d))
    heights = {"M1": 0.0, "M2": d, "DET": -b}
    rng = np.random.default_rng(0)
    for _ in range(5):
        shift, turn, centre = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal(3)
        los = np.zeros(2)
        for name, z in heights.items():
            move = shift + np.cross(turn, np.array([0.0, 0.0, z]) - centre)
            los += optics.sensitivity(name) @ np.concatenate([move, turn])
        np.testing.assert_allclose(los, turn[:2], atol=1e-12)


def test_no_body_has_a_negative_residual_mass(telescope) -> None:
    for body in assembled_telescope().bodies:
        assert smallest_residual_fraction(body) > -1e-9, body.name


def weighted(system, telescope, values, omega, inputs=("wheel_imbalance", "sadm_torque")):
    """Normalised disturbances to the line of sight [arcsec]: singular values."""
    amplitudes = weight_amplitudes(telescope, omega)
    columns = {"wheel_imbalance": slice(0, 20), "sadm_torque": slice(20, 22)}
    size = np.hstack([amplitudes[:, columns[name]] for name in inputs])
    response = frequency_response(system[("los_controlled",), tuple(inputs)].at(values), omega)
    return largest_gains(response * size[:, None, :]) / ARCSEC


def grid(system, values, low: float, high: float) -> np.ndarray:
    return frequency_grid(linalg.eigvals(system.at(values).A), low, high)


def test_calibration_1_isolator_alone_nearly_uses_the_mirrors_authority(system, telescope) -> None:
    """Worst case over the parameters: 0.90 to 0.99 of 5.3 mrad x 0.1, near the attitude bandwidth."""
    worst, where = 0.0, 0.0
    for values in [{}, *corners(telescope), *system.sample_values(np.random.default_rng(1), 10)]:
        omega = grid(system, values, 1e-3, 1e3)
        los = weighted(system, telescope, values, omega)
        if los.max() > worst:
            worst, where = float(los.max()), float(omega[los.argmax()])
    authority = telescope.fsm.authority * telescope.fsm.los_sensitivity / ARCSEC
    assert 0.90 < worst / authority < 0.99
    assert 0.03 < where < 0.12


def test_calibration_2_the_isolator_cuts_high_frequencies(system, telescope) -> None:
    hard = assembled_telescope(None, False).system
    both = {}
    for name, model in (("hard", hard), ("soft", system)):
        omega = grid(model, {}, 50.0, 1e4)
        both[name] = omega, weighted(model, telescope, {}, omega)

    def peak(name: str, low: float, high: float) -> float:
        omega, los = both[name]
        return float(los[(omega >= low) & (omega < high)].max())

    assert peak("hard", 1000.0, 1e4) > 10.0 * peak("soft", 1000.0, 1e4)  # 20 dB
    assert peak("hard", 500.0, 1e3) > peak("soft", 500.0, 1e3)
    assert peak("soft", 100.0, 200.0) > 2.0 * peak("hard", 100.0, 200.0)  # its own modes


def test_template_weight_values() -> None:
    """The rational weight of 20 ms at 1, 10, 25, 50, 100 Hz (handbook values)."""
    hz = np.array([1.0, 10.0, 25.0, 50.0, 100.0])
    expected = [0.036276, 0.360016, 0.774485, 0.966350, 0.997327]
    np.testing.assert_allclose(rpe_weight(2 * np.pi * hz, 0.02), expected, atol=1e-6)


def test_a_users_file_contains_only_the_changed_values(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("base = 'reference'\n[pma]\nstiffness = 90.0\n")
    mine, reference = load_telescope(path), load_telescope()
    assert mine.pma.stiffness == 90.0 and mine.pma.damping == reference.pma.damping
    assert mine.parameters_hash != reference.parameters_hash


FILE = str(Path(__file__).parents[3] / "examples" / "paper" / "telescope.toml")

BANDS = (1.0, 6.0, 10.0, 30.0, 100.0, 300.0, 1000.0)


def decades(file: str | None) -> list[float]:
    """Median over each band of the decades by which the wheels exceed the drives, resonances in each hundredth."""
    both, found = disturbance_responses(load_telescope(file)), []
    for low, high in pairwise(BANDS):
        edges = np.geomspace(low, high, round(100 * np.log10(high / low)) + 1)
        wheels, drives = (both.weighted(both.isolated, {}, of, low, high).columns(edges) for of in (WHEELS, DRIVES))
        found.append(float(np.median(np.log10(wheels / drives))))
    return found


@pytest.mark.further
def test_wheels_are_up_to_three_decades_above_the_drives_below_100_rad_s() -> None:
    """In each band, not at one frequency; above 100 rad/s the two come closer. The reference has other drives."""
    found = decades(FILE)
    assert all(value > 1.5 for value in found[:4]) and 2.5 < max(found[:4]) < 3.5
    assert found[5] < 1.1 and found[5] < found[4] < 2.1
    assert decades(None)[3] < 1.0


def test_the_open_loop_needs_more_than_the_mirror_by_what_the_pairs_of_figures_say() -> None:
    """Reach 109.3 arcsec; 10 arcsec times the APE of a nominal and of a robust design more, 0.7115 and 0.9857."""
    telescope = load_telescope(FILE)
    loop, rng = continuous_open_loop(telescope), np.random.default_rng(0)
    points = rng.uniform(size=(2000, len(loop.names)))
    points = np.where(rng.uniform(size=points.shape) < 0.6, np.round(points), points)
    points[0] = loop.point({})
    omega = np.geomspace(0.055, 0.065, 7)
    size = np.max(
        [
            np.linalg.norm(loop.closed_over(lft, points)[:, -2:, : loop.disturbances], 2, axis=(1, 2))
            for lft in loop.at(omega)
        ],
        axis=0,
    )
    reach = telescope.fsm.authority * telescope.fsm.los_sensitivity
    limit = telescope.weights.ape_limit
    assert size[0] / ARCSEC == pytest.approx(116.4, abs=0.1)
    assert (size[0] - reach) / limit == pytest.approx(0.7115, rel=0.02)
    assert (size.max() - reach) / limit == pytest.approx(0.9857, rel=0.02)


def test_lft_sampled_equals_the_telescope_rebuilt(system, telescope) -> None:
    """New nominal values in the parameter file give the same model as Delta at these values."""
    w1, w2 = 0.743 * 1.03, 2.65 * 0.96
    rebuilt = build_telescope(telescope.changed({"solar_array": {"frequencies": [w1, w2]}})).system
    # the attitude law uses the inertia of the nominal telescope, which does not depend on the frequencies
    values = {"wheel_2.speed": 700.0, "solar_array.tau": 0.6}
    omega = np.geomspace(1e-2, 3e3, 25)
    both = {**values, "solar_array.omega_1": w1, "solar_array.omega_2": w2}
    one = frequency_response(system["los", "wheel_imbalance"].at(both), omega, tolerance=1e-11)
    two = frequency_response(rebuilt["los", "wheel_imbalance"].at(values), omega, tolerance=1e-11)
    size = np.sqrt(np.sum(np.abs(two) ** 2, axis=(1, 2)))
    assert np.max(np.sqrt(np.sum(np.abs(one - two) ** 2, axis=(1, 2))) / size) < 1e-9
