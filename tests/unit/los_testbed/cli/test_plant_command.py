"""`los-testbed plant` and the telescopes of the family that `los-testbed run` flies."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from command_line import CommandLine
from los_testbed.cli.run import configure
from los_testbed.config.cases import telescope_cases
from los_testbed.config.members import random_member
from los_testbed.config.run_config import RunConfig
from los_testbed.parts import run_parts
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import announced

from titop_plant.disturbances.responses import ALL, Curve, disturbance_responses
from titop_plant.simulation.build import PlantConfig, parameter_values
from titop_plant.structures import write_modal_data
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    return CommandLine.below(tmp_path, monkeypatch, capsys)


def test_a_parameter_file_of_ones_own_changes_the_figures(run) -> None:
    """A payload with six of its modes: sixty states fewer."""
    payload = assembled_telescope().bodies[1]
    write_modal_data(payload.truncate(6), run.files / "payload.toml")
    mine = run.files / "mine.toml"
    mine.write_text('base = "reference"\n[payload]\nmodal_data = "payload.toml"\n')
    code, out, _ = run("plant", "--json", "--parameters", mine)
    found = json.loads(out)
    assert (code, found["order"]) == (0, 204 - 2 * (payload.n_modes - 6))
    assert found["bodies"]["payload"]["modes"] == 6


def test_a_column_of_a_picture_keeps_the_peak_inside_it() -> None:
    """A resonance far narrower than a column is as high as in the response."""
    curve = disturbance_responses(load_telescope()).first_channel({}, 0.3, 20.0)
    edges = np.geomspace(0.3, 20.0, 11)
    columns = curve.columns(edges)
    assert columns.max() == curve.size.max()
    for low, high, value in zip(edges[:-1], edges[1:], columns):
        inside = curve.size[(curve.omega >= low) & (curve.omega < high)]
        assert value >= inside.max() * (1.0 - 1e-12)
    narrow = Curve(np.array([1.0, 2.0, 2.001, 2.002, 4.0]), np.array([1.0, 1.0, 50.0, 1.0, 1.0]))
    np.testing.assert_allclose(narrow.columns(np.array([1.0, 1.5, 3.0, 4.0])), [1.0, 50.0, 1.0])


def test_tau_is_another_name_of_theta() -> None:
    by_tau, by_theta = RunConfig(tau=math.tan(0.3)), RunConfig(theta=1.2)
    assert by_tau.array_angle == pytest.approx(1.2, rel=1e-14)
    one, other = (announced(RunParts(c)) for c in (RunConfig(tau=0.5), RunConfig(theta=4.0 * math.atan(0.5))))
    assert one == other
    signals = []
    for config in (by_tau, by_theta):
        plant = run_parts.build_plant(config)
        truth, measurement = np.zeros(2), np.zeros(22)
        for _ in range(50):
            plant.step(np.zeros(8), measurement, truth)
        signals.append(np.r_[truth, measurement[:18]])
    np.testing.assert_allclose(signals[0], signals[1], rtol=1e-6)


def test_what_is_stated_goes_before_the_random_member_before_the_case_before_the_file(run) -> None:
    file = run.files / "run.yaml"
    file.write_text("theta: 0.5\nseed: 9\nomega_1: 0.75\n")
    chosen = configure(file, ["omega_2=2.6"], {"tau": "0.25"}, case="soft_arrays")
    assert (chosen.theta, chosen.tau, chosen.seed) == (None, 0.25, 9)
    assert (chosen.omega_1, chosen.omega_2) == (0.70585, 2.6)
    drawn = configure(file, [], {"theta": "0.1"}, case="wheels_fast", sample="4")
    assert (drawn.theta, drawn.tau) == (0.1, None)
    assert list(drawn.wheel_speed) == random_member(4)["wheel_speed"]


@pytest.mark.further
def test_the_worst_case_is_worse_than_the_other_ones() -> None:
    """Line of sight against the template of the relative error, isolator alone: named cases and random members."""
    telescope = load_telescope()
    both = disturbance_responses(telescope)

    def peak(config: RunConfig) -> float:
        plant = PlantConfig.of(config, disturbance=False)
        curve = both.weighted(both.isolated, parameter_values(plant, telescope), ALL, 1.0, 1e3)
        return float(np.max(curve.size * rpe_weight(curve.omega, telescope.weights.rpe_window)))

    peaks = {name: peak(configure(None, [], {"output": "x"}, case=name)) for name in telescope_cases(telescope)}
    drawn = [peak(RunConfig.from_mapping(random_member(seed))) for seed in range(8)]
    assert max(peaks, key=lambda name: peaks[name]) == "worst"
    assert peaks["worst"] > max(drawn)
