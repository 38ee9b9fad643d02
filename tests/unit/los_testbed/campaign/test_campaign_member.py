"""A member of a campaign has the metrics of its recorded run, to the last bit, whatever was computed before it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from los_testbed.campaign.member import MemberEvaluator, metric_columns, row_hash
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.closed_loop import LoopDivergedError, SimulatedLoop
from los_testbed.run.loop.contract import RunFailedError
from los_testbed.run.loop.simulate import run_in_process

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

REFERENCE = MemberParameters.of()

BASE = RunConfig(mode="inprocess", duration=2.0)
TIME_METRICS = metric_columns("time", RunParts(BASE).telescope.requirements)


def member(index: int) -> dict[str, Any]:
    values = dict(zip(REFERENCE.columns, map(float, members("uniform", index + 1, 4)[index])))
    return {**values, "seed": int(member_seeds(index + 1, 4)[index])}


@pytest.fixture(scope="module")
def evaluator() -> MemberEvaluator:
    return MemberEvaluator.of(BASE)


@pytest.mark.parametrize(("loop", "scenario"), [("fsm+pma", "design"), ("isolator", "imbalance"), ("none", "design")])
def test_metrics_are_those_of_the_bag(loop: str, scenario: str, tmp_path: Path) -> None:
    base = replace(BASE, loop=loop, scenario=scenario)
    row = MemberEvaluator.of(base).row(0, member(0), "time")
    run_in_process(replace(base, **REFERENCE.settings(member(0))), tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    summary = summarise(run)
    assert row["status"] == "ok"
    assert (row["ape_max_arcsec"], row["ape_p997_arcsec"]) == (summary.ape_max, summary.ape_quantile)
    assert (row["rpe_rms_mas"], row["rpe_p997_mas"]) == (summary.rpe_rms, summary.rpe_quantile)
    assert summary.knowledge is not None
    found = row["ake_p997_arcsec"], row["rke_rms_mas"]
    assert found == (summary.knowledge.ake_quantile_arcsec, summary.knowledge.rke_rms_mas)
    assert row["mirror_max_mrad"] == 1e3 * np.abs(run["fsm/command"].values[:, :2]).max()


def test_rows_do_not_depend_on_what_was_computed_before_or_beside() -> None:
    """Rows of one part are those of each alone; one of them fails before its run."""
    together, alone = (MemberEvaluator.of(replace(BASE, scenario="design", duration=1.1)) for _ in range(2))
    asked = [{**member(k), "index": k} for k in range(4)]
    asked[2]["omega_1"] = 3.0
    found = together.rows(asked, "time")
    assert [row["status"] for row in found] == ["ok", "ok", "failed", "ok"]
    assert found == [alone.row(m["index"], m, "time") for m in asked[::-1]][::-1]


def test_member_that_fails_is_a_row_with_its_reason(
    evaluator: MemberEvaluator, monkeypatch: pytest.MonkeyPatch
) -> None:
    outside = evaluator.row(5, {**member(0), "omega_1": 3.0}, "time")
    assert outside["status"] == "failed" and outside["reason"].startswith("omega_1 must be between")
    assert all(np.isnan(outside[name]) for name in TIME_METRICS) and outside["omega_1"] == 3.0
    short = MemberEvaluator.of(replace(BASE, duration=0.5, start="rest")).row(5, member(0), "time")
    assert short["status"] == "failed" and short["reason"] == "duration must exceed the start-up of 1 s, got 0.5 s"

    lost = LoopDivergedError("the loop diverged within the first 1000 ms")
    within_a_step = RunFailedError("plant failed at tick 3: MemoryError")
    within_a_step.__cause__ = MemoryError()
    for raised, status, reason in (
        (lost, "diverged", "the loop diverged within the first 1000 ms"),
        (MemoryError(), "crashed", "no memory"),
        (within_a_step, "crashed", ""),
    ):
        monkeypatch.setattr(SimulatedLoop, "run", Mock(side_effect=raised))
        found = evaluator.row(5, member(0), "time")
        assert found["status"] == status and reason in found["reason"]


def test_hash_of_a_row_sees_every_bit(evaluator: MemberEvaluator) -> None:
    row = evaluator.row(0, member(0), "time")
    assert row_hash(row) == row["hash"]
    for name in ("index", "tau", "rpe_rms_mas", "status"):
        value = row[name]
        other = float(np.nextafter(value, 1e9)) if isinstance(value, float) else f"{value}1"
        assert row_hash({**row, name: other}) != row["hash"]
