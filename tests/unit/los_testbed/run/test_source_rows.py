"""Sources of disturbance of a parameter file act in campaigns and budgets, each with a row of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign.member import MemberEvaluator, source_columns
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
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
period = 0.1
width = 0.05
"""
ROWS = ("cooler", "thruster pair")


@pytest.fixture
def base(tmp_path: Path) -> RunConfig:
    (tmp_path / "telescope.toml").write_text(SOURCES)
    parameters = str(tmp_path / "telescope.toml")
    return RunConfig(mode="inprocess", duration=1.2, loop="fsm", scenario="design", parameters=parameters)


@pytest.mark.further
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


@pytest.mark.further
def test_a_budget_has_a_source_for_each(base: RunConfig, tmp_path: Path) -> None:
    table = {"loop": "fsm", "part": "sources", "settings": {"parameters": base.parameters, "duration": base.duration}}
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
