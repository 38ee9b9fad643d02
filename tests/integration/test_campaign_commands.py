"""The command beside each of the worst members of a campaign, pasted, gives the member's figure as it is printed."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.overview import campaign_summary, worst_lines
from los_testbed.config.run_config import RunConfig
from support.command_line import call_command

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


def compare_time(folder: Path, capsys: pytest.CaptureFixture[str], count: int) -> None:
    summary, lines = lines_of(folder, "time", count)
    assert len(lines) == count
    for k, (line, member) in enumerate(zip(lines, summary["worst"])):
        figure, screen, found = pasted(line, capsys, "--no-report", "--output", str(folder / f"bag{k}"))
        assert figure.endswith(" mas") and f" {figure} " in screen
        assert found["rpe_mas"]["windows_p997"] == member["value"]


def compare_model(folder: Path, capsys: pytest.CaptureFixture[str], count: int) -> None:
    summary, lines = lines_of(folder, "model", count)
    assert len(lines) == count
    for line, member in zip(lines, summary["worst"]):
        figure, screen, found = pasted(line, capsys)
        assert figure.endswith(" mas") and f" {figure.removesuffix(' mas')} " in screen
        assert float(f"{found['metrics']['total_mas']:.6g}") == member["value"]


def test_commands_of_simulated_members(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compare_time(tmp_path, capsys, 3)


def test_commands_at_depth_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compare_model(tmp_path, capsys, 1)


def test_a_member_that_cannot_be_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = call_command(capsys, "campaign", "--depth", "model", "--member", "0,1,2")
    assert code == 2 and "--member must be tau,wheel_speed_1," in err and "got '0,1,2'" in err
    code, _, err = call_command(capsys, "campaign", "--depth", "model", "--member", "9,0,0,0,0,0.74,2.6")
    assert code == 2 and "tau must be between -1 and 1, got 9" in err
    code, _, err = call_command(capsys, "campaign", "--member", "0,0,0,0,0,0.74,2.6", "--keep", "2")
    assert code == 2 and "--keep must not be given with --member" in err
