"""Sources of disturbance of a parameter file act in campaigns and budgets, each with a row of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign.dataset import Campaign
from los_testbed.campaign.meanings import scenario_text
from los_testbed.campaign.member import MemberEvaluator, source_columns
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.summary.pointing_budget_sources import testbed_sources as sources_of_table
from los_testbed.run.summary.source_shares import source_shares

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

REFERENCE = MemberParameters.of()

SOURCES = """
[[disturbance]]
name = "cooler"
kind = "cooler"
place = "payload"
frequency = 45.0
harmonics = [{order = 1, force = [2.0, 0.0, 1.0]}]

[[disturbance]]
name = "thruster pair"
kind = "pulses"
torque = [0.2, 0.0, 0.1]
period = 0.5
width = 0.05
"""
ROWS = ("cooler", "thruster pair")


@pytest.fixture
def base(tmp_path: Path) -> RunConfig:
    (tmp_path / "telescope.toml").write_text(SOURCES)
    parameters = str(tmp_path / "telescope.toml")
    return RunConfig(mode="inprocess", duration=2.0, loop="fsm", scenario="design", parameters=parameters)


def test_a_member_has_the_sources_of_its_run_and_a_row_for_each(base: RunConfig, tmp_path: Path) -> None:
    values = dict(zip(REFERENCE.columns, map(float, members("uniform", 1, 4)[0])))
    member = {**values, "seed": int(member_seeds(1, 4)[0])}
    row = MemberEvaluator.of(base).row(0, member, "time")
    assert row["status"] == "ok", row["reason"]
    run_in_process(replace(base, **REFERENCE.settings(member)), tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    summary = summarise(run)
    assert (row["ape_max_arcsec"], row["rpe_rms_mas"]) == (summary.ape_max, summary.rpe_rms)
    shares = [share for share in source_shares(run) if share.name in ROWS]
    assert [share.name for share in shares] == list(ROWS)
    for share in shares:
        assert [row[name] for name in source_columns(share.name)] == [share.ape, share.rpe]
    quiet = MemberEvaluator.of(replace(base, parameters=None)).row(0, member, "time")
    assert row["rpe_rms_mas"] > 1.05 * quiet["rpe_rms_mas"], "they act"
    assert not any(name.startswith("source_") for name in quiet)


def test_a_campaign_names_them(base: RunConfig) -> None:
    asked = Campaign.of(base, "uniform", 2, 1, "time", {})
    columns = [name for source in ROWS for name in source_columns(source)]
    assert [name for name in asked.metrics if name.startswith("source_")] == columns
    assert scenario_text("design", "time", asked.sources).endswith("act: cooler, thruster pair.")


def test_a_budget_has_a_source_for_each(base: RunConfig, tmp_path: Path) -> None:
    table = {"loop": "fsm", "part": "sources", "settings": {"parameters": base.parameters, "duration": 2.0}}
    found = sources_of_table(("loop",), table, np.pi / 648e6)
    assert [source.path for source in found] == [("loop", name) for name in ROWS]
    run_in_process(replace(base, scenario="imbalance"), tmp_path / "bag")
    shares = [share for share in source_shares(Run.open(tmp_path / "bag")) if share.name in ROWS]
    for source, share in zip(found, shares, strict=True):
        assert np.linalg.norm(source.sigma(0.02)) == pytest.approx(share.rpe, rel=1e-3)
    every = {s.name for s in sources_of_table(("loop",), {**table, "part": "all"}, 1.0)}
    assert every > {"loop / cooler"} and not any("tone" in name for name in every), "its sources alone"
    asked = {s.name for s in sources_of_table(("loop",), {**table, "part": "all", "scenario": "design"}, 1.0)}
    assert any("tone" in name for name in asked)


ROTORS = """
[reaction_wheel.bearing]
rotor_mass = 0.8
rotor_radial_inertia = 0.047
rocking_stiffness = 9.1e3
rocking_damping = 0.83

[reaction_wheel.broadband]
frequency = [1.0, 400.0]
radial_torque = [1e-4, 1e-4]

[sadm.stepper]
rotor_inertia = 1.2e-5
gear_ratio = 100.0
full_steps = 200
micro_steps = 16
holding_torque = 0.4
rate = 2e-2
detent_torque = 0.05
"""


def test_rotors_of_wheels_and_drives_have_a_row_each(base: RunConfig, tmp_path: Path) -> None:
    """In campaign and budget, at every stage and while the arrays turn; another noise has another name."""
    path = tmp_path / "rotors.toml"
    path.write_text(ROTORS)
    config = replace(base, parameters=str(path))
    rows = ("wheel broadband", "array drive")
    asked = Campaign.of(config, "uniform", 2, 1, "time", {})
    columns = [name for source in rows for name in source_columns(source)]
    assert [name for name in asked.metrics if name.startswith("source_")] == columns
    table = {"loop": "fsm", "part": "sources", "settings": {"parameters": str(path), "duration": 2.0}}
    found = sources_of_table(("loop",), table, np.pi / 648e6)
    assert [source.path for source in found] == [("loop", name) for name in rows]
    assert all(np.linalg.norm(source.sigma(0.02)) > 1e-3 for source in found)
    digest = RunParts(config).sources_digest
    path.write_text(ROTORS.replace("1e-4, 1e-4", "2e-4, 2e-4"))
    assert (
        digest != RunParts(config).sources_digest != RunParts(replace(config, disturbance=False)).sources_digest == ""
    )


def test_rotors_act_while_the_arrays_turn(base: RunConfig, tmp_path: Path) -> None:
    path = tmp_path / "rotors.toml"
    path.write_text(ROTORS)
    config = replace(base, parameters=str(path), scenario="ramp", theta_rate=0.05, ramp_duration=0.5, loop="isolator")
    parts = RunParts(config)
    plant = parts.with_sources(parts.family.build(parts.physical))
    command, measurement, truth = np.zeros(8), np.zeros(22), np.zeros(2)
    for _ in range(50):
        plant.step(command, measurement, truth)
    assert np.isfinite(measurement[:18]).all() and np.abs(truth).max() > 0.0
    assert not parts.sources[1].signal.lines.size
