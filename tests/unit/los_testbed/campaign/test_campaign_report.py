"""Verdict, statistics and page of a campaign, from rows with known answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import finished_row, metric_columns
from los_testbed.campaign.overview import campaign_summary, metric_table
from los_testbed.campaign.page import write_page
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from support import axe, headless_browser

BASE = RunConfig(mode="inprocess", loop="fsm+pma", scenario="design")
REQUIREMENTS = RunParts(BASE).telescope.requirements
TIME_METRICS = metric_columns("time", REQUIREMENTS)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, dict[str, Any]]]:
    pytest.importorskip("pyarrow")
    made = {}
    for count in (5, 400, 10000):
        asked = Campaign.of(BASE, "uniform", count, 3, "time", {"version": "0"})
        folder = ResultFolder(tmp_path_factory.mktemp("pages") / str(count))
        folder.open(asked, False)
        rows = []
        for _, chunk in asked.chunks():
            for member in chunk:
                metrics = dict.fromkeys(TIME_METRICS, 1.0)
                metrics["rpe_window_p997_mas"] = 20.0 + 5.0 * member["tau"] + 1e-3 * member["wheel_speed_2"]
                rows.append(finished_row(member["index"], member, metrics, "ok", ""))
        folder.write(0, rows)
        summary = campaign_summary(asked, folder)
        made[count] = write_page(asked, folder, summary, folder.path / "report.html"), summary
    return made


@pytest.mark.further
@pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine")
def test_axe_finds_nothing_on_the_page(pages: dict[int, Any]) -> None:
    pytest.importorskip("axe_core_python")
    with headless_browser.Page() as browser:
        for scheme, width in (("light", 390), ("dark", 1280)):
            assert axe.findings(browser, pages[5][0], width, scheme) == []


def test_members_that_are_no_random_draws_have_no_probability(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked = Campaign.of(replace(BASE, loop="fsm"), "corners", 0, 3, "time", {})
    folder = ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    for number, chunk in asked.chunks():
        folder.write(number, [finished_row(m["index"], m, dict.fromkeys(TIME_METRICS, 1.0), "ok", "") for m in chunk])
    assert {v["interpretation"] for v in campaign_summary(asked, folder)["verdicts"]} == {"temporal"}


def test_one_member_is_no_plural() -> None:
    summary = {"members": 1, "samples": 1, "depth": "time", "status": {"ok": 1}, "metrics": {}}
    assert metric_table(summary).title == "1 of 1 member, depth time: 1 ok"
