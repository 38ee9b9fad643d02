"""Worst members of a campaign: their commands, pasted, give the printed figures, and known worst cases are found."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.adversarial import adversarial_members
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.overview import campaign_summary, worst_lines
from los_testbed.campaign.sampling import MemberParameters, members
from los_testbed.config.run_config import RunConfig
from support.command_line import call_command, refused

from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop_norms import weighted_gains

DURATION = {"time": 1.04, "model": 10.0}


def lines_of(folder: Path, depth: str, count: int) -> tuple[dict[str, Any], list[str]]:
    """Summary of a campaign of random members, and the line of each of them."""
    pytest.importorskip("pyarrow")
    base = RunConfig(mode="inprocess", loop="fsm+pma", duration=DURATION[depth])
    asked = Campaign.of(base, "uniform", count, 11, depth, {})
    evaluator, results = MemberEvaluator.of(base), ResultFolder(folder / "campaign")
    results.open(asked, False)
    for number, chunk in asked.chunks():
        results.write(number, evaluator.rows(chunk, depth))
    summary = campaign_summary(asked, results, count)
    return summary, worst_lines(summary)


def pasted(line: str, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[str, str, dict[str, Any]]:
    """Figure of a line, and what its command prints: the screen and the JSON object."""
    figure, command = re.fullmatch(r"\S+ (.+?): los-testbed (.+)", line).groups()  # type: ignore[union-attr]
    code, out, err = call_command(capsys, *shlex.split(command), *more, "--json")
    assert code == 0
    return figure, err, json.loads(out.splitlines()[-1])


def test_commands_of_simulated_members(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary, lines = lines_of(tmp_path, "time", 3)
    assert len(lines) == 3
    for k, (line, member) in enumerate(zip(lines, summary["worst"])):
        figure, screen, found = pasted(line, capsys, "--no-report", "--output", str(tmp_path / f"bag{k}"))
        assert figure.endswith(" mas") and f" {figure} " in screen
        assert found["rpe_mas"]["windows_p997"] == member["value"]


def test_the_command_at_depth_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary, (line,) = lines_of(tmp_path, "model", 1)
    figure, screen, found = pasted(line, capsys)
    assert figure.endswith(" mas") and f" {figure.removesuffix(' mas')} " in screen
    assert float(f"{found['metrics']['total_mas']:.6g}") == summary["worst"][0]["value"]


def test_a_member_that_cannot_be_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        ("--depth model --member 0,1,2", "--member must be tau,wheel_speed_1,"),
        ("--depth model --member 9,0,0,0,0,0.74,2.6", "tau must be between -1 and 1, got 9"),
        ("--member 0,0,0,0,0,0.74,2.6 --keep 2", "--keep must not be given with --member"),
    ):
        assert message in refused(capsys, "campaign", *words.split())


REFERENCE = MemberParameters.of()

FIXTURES = Path(__file__).parents[1] / "fixtures"
OLD = RunConfig(
    mode="inprocess",
    loop="fsm+pma",
    k_fsm=str(FIXTURES / "k_fsm_without_margin.json"),
    k_pma=str(FIXTURES / "k_pma_without_margin.json"),
)


def rows_of(evaluator: MemberEvaluator, points: np.ndarray) -> list[dict[str, Any]]:
    rows = [evaluator.row(k, {**dict(zip(REFERENCE.columns, p)), "seed": 1}, "model") for k, p in enumerate(points)]
    assert {row["status"] for row in rows} == {"ok"}
    return rows


@pytest.mark.slow
def test_adversarial_members_reach_the_known_worst_case_and_random_ones_do_not() -> None:
    """1.48 of 40 mas is known of these controllers (`tests/unit/los_design/test_worst_points.py`).

    Random members are between the limit and that. The worst of them is confirmed by the periodic solution of its
    assembled loop.
    """
    evaluator = MemberEvaluator.of(OLD)
    found = [row["rpe_fine_gain"] for row in rows_of(evaluator, adversarial_members(OLD, 10, 0))]
    assert found[0] == max(found) and found[0] == pytest.approx(1.48, abs=0.04)
    points = members("uniform", 400, 1)
    rows = rows_of(evaluator, points)
    random = np.array([row["rpe_fine_gain"] for row in rows])
    assert 1.0 < random.max() < found[0] and np.median(random) < 1.0
    worst = int(random.argmax())
    plant = evaluator.family.control_loop.at(dict(zip(REFERENCE.ranges, points[worst])))
    pair, telescope = (evaluator.controllers["k_fsm"], evaluator.controllers["k_pma"]), evaluator.family.telescope
    closed = sampled_loop(plant, ControlLaws(*pair, "fsm+pma", rows()))
    near = rows[worst]["rpe_peak_rad_s"] * (1.0 + np.linspace(-2e-3, 2e-3, 81))
    peak = float(weighted_gains(closed, plant, telescope, near)[1].max()) / telescope.weights.rpe_limit_fine
    assert random[worst] == pytest.approx(peak, rel=0.02)
