"""Verdict, statistics and page of a campaign, from rows with known answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign import page as campaign_page
from los_testbed.campaign.campaign_verdict import verdicts
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.influence import first_order_index, influences, pair_effects, yield_curve
from los_testbed.campaign.member import finished_row, metric_columns
from los_testbed.campaign.overview import campaign_summary, verdict_table
from los_testbed.campaign.page import write_page
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from support import axe, headless_browser

from lftkit.arrays import FloatArray
from pointing_analysis.requirements.requirement import parse

REFERENCE = MemberParameters.of()

BASE = RunConfig(mode="inprocess", loop="fsm+pma", scenario="design")
REQUIREMENTS = RunParts(BASE).telescope.requirements
TIME_METRICS = metric_columns("time", REQUIREMENTS)


def columns(count: int, largest: float = 30.0, share: float = 0.0) -> dict[str, np.ndarray]:
    """Metrics of members that keep 40 mas, but for the last ones."""
    found = {name: np.ones(count) for name in TIME_METRICS}
    found |= {name: np.zeros(count) for name in TIME_METRICS if "above" in name}
    found |= {name: np.full(count, 4000.0) for name in TIME_METRICS if "effective" in name}
    found["rpe_window_max_mas"] = np.full(count, largest)
    found["rpe_window_above_40_mas"] = np.full(count, share)
    return found


def by_name(found: list[Any], requirement: str) -> dict[str, Any]:
    return {v.interpretation: v for v in found if v.requirement == requirement}


def test_a_thousand_members_below_the_limit_are_compliant_and_a_hundred_do_not_show_it() -> None:
    many, few = (by_name(verdicts(columns(n), ["ok"] * n, "fsm+pma", REQUIREMENTS), "RPE, finest") for n in (1000, 100))
    assert many["ensemble"].status == "compliant" and many["ensemble"].upper < 0.003
    assert few["ensemble"].status == "not enough data" and few["ensemble"].needed == 998
    assert few["mixed"].status == "compliant" and few["mixed"].samples == 400000
    assert many["temporal"].status == "compliant" and few["temporal"].status == "not enough data"


def test_interpretations_differ_as_ecss_says() -> None:
    """Each member is above the limit for 0.1 % of its windows: good in time, bad in every worst instant."""
    found = by_name(
        verdicts(columns(1000, largest=60.0, share=1e-3), ["ok"] * 1000, "fsm+pma", REQUIREMENTS), "RPE, finest"
    )
    assert [found[name].status for name in ("ensemble", "temporal", "mixed")] == [
        "not compliant",
        "compliant",
        "compliant",
    ]
    assert found["ensemble"].exceeding == 1.0 and found["mixed"].exceeding == pytest.approx(1e-3)


def test_lost_members_count_as_above_and_failed_ones_not() -> None:
    status = ["ok"] * 990 + ["diverged"] * 8 + ["failed"] * 2
    found = by_name(verdicts(columns(1000), status, "fsm+pma", REQUIREMENTS), "RPE, finest")
    assert found["ensemble"].samples == 998 and found["ensemble"].exceeding == pytest.approx(8 / 998)
    assert found["temporal"].status == "not compliant" and found["temporal"].as_dict()["value"] is None
    assert verdicts(columns(2), ["failed"] * 2, "fsm", REQUIREMENTS) == []


def test_requirements_are_those_of_the_stage() -> None:
    names = {v.requirement for v in verdicts(columns(10), ["ok"] * 10, "fsm", REQUIREMENTS)}
    assert "RPE, finest" not in names and {"APE", "RPE, fine"} <= names


def named(x: FloatArray) -> dict[str, FloatArray]:
    """Columns of the reference's parameters."""
    return dict(zip(REFERENCE.columns, x.T))


def test_influence_finds_the_parameters_of_a_known_function() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (3000, 7))
    found = influences(named(x), 3.0 * x[:, 1] + x[:, 4] ** 2)
    assert found[0].parameter == REFERENCE.columns[1] and found[0].rank_correlation > 0.9
    squared = next(i for i in found if i.parameter == REFERENCE.columns[4])
    assert abs(squared.rank_correlation) < 0.1
    assert squared.first_order == pytest.approx((4 / 45) / (4 / 45 + 3.0), abs=0.02)
    assert influences(named(x[:4]), x[:4, 0]) == [] and first_order_index(x[:5, 0], x[:5, 0]) != 0.0


def test_effects_of_pairs_are_what_neither_parameter_does_alone() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (3000, 7))
    found = pair_effects(named(x), x[:, 3] + 1.5 * x[:, 1] * x[:, 5] + 0.3 * rng.standard_normal(3000))
    whole = 1 / 3 + 1.5**2 / 9 + 0.09
    assert found[0].parameters == (REFERENCE.columns[1], REFERENCE.columns[5])
    assert found[0].share == pytest.approx(1.5**2 / 9 / whole, abs=0.06)
    assert max(effect.share for effect in found[1:]) < 0.03
    assert pair_effects(named(x[:50]), x[:50, 0]) == []


def test_yield_is_the_share_below_and_its_bound_is_lower() -> None:
    share, bound = yield_curve(np.array([1.0, 2.0, 3.0, np.inf]), np.array([0.5, 2.0, 9.0]))
    assert share.tolist() == [0.0, 0.5, 0.75]
    assert bound[0] == 0.0 and (bound <= share).all()


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


def test_the_page_is_as_large_for_ten_thousand_members_as_for_four_hundred(pages: dict[int, Any]) -> None:
    small, large = (pages[n][0].stat().st_size for n in (400, 10000))
    assert pages[5][0].stat().st_size < large, "too few members for effects"
    assert 0.5 < small / large < 2.0


def test_page_table_and_json_say_the_same(pages: dict[int, Any]) -> None:
    page, summary = pages[10000]
    text = page.read_text("utf-8")
    assert len(verdict_table(summary).rows) == len(summary["verdicts"]) == 9
    for v in summary["verdicts"]:
        assert f"<td>{v['requirement']}</td><td>{v['interpretation']}</td>" in text.replace("\n", "")
    assert all(member["command"].split(" --")[0] in text for member in summary["worst"])
    assert summary["influence"][0]["parameter"] == "tau" and summary["influence"][1]["parameter"] == "wheel_speed_2"
    assert "several tones act at once, each of norm 1" in text.split("Depth time")[0], "the scenario comes first"
    assert text.count("<figure>") == 4 and "http" not in text.replace("http://www.w3.org", "")


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


def test_the_limits_of_a_picture_are_those_of_its_column(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of 20 ms, 99.7 % of them: neither another window nor another part, though all are in mas."""
    texts = [(40, 20, 0.997), (30, 20, 0.95), (60, 50, 0.997)]
    asked = [parse(f"prob(rms RPE({ms} ms) < {mas} mas) >= {p} at 95 % confidence") for mas, ms, p in texts]
    found = [v for r in asked for v in verdicts({}, ["ok"] * 9, "fsm+pma", [r])]
    shown: list[Any] = []
    monkeypatch.setattr(campaign_page, "_distribution", lambda name, metric, limits: shown.append(limits))
    monkeypatch.setattr(campaign_page, "_yield", lambda name, metric, limits: shown.append(limits))
    summary = {"ranked_by": "rpe_window_p997_mas", "verdicts": [v.as_dict() for v in found], "influence": []}
    campaign_page._pictures(summary, np.zeros((9, 7)), np.linspace(20.0, 50.0, 9))
    assert shown == [[pytest.approx(40.0)]] * 2
