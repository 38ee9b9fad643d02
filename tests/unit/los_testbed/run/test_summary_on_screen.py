"""The table of a run and its JSON object, and what a row of the stage comparison says of its limits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from los_testbed.run.summary import summary as screen
from los_testbed.run.summary.summary import missed_share
from los_testbed.run.summary.worst_case_rows import ToneLevel, WorstToneRun, levels_text, limits_met
from rich.table import Table

from pointing_analysis.read.series import series
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.summary import Summary, summarise

APE = parse("prob(|APE| < 10 arcsec) >= 0.997 at 60 % confidence", "APE")
JITTER = series(None, 5.0 * np.random.default_rng(0).standard_normal((2000, 2)), unit="mas", rate=1000.0, name="mine")
COUNTS = {"ticks": "2000", "missed_ticks": "3", "skipped_periods": "5"}
LATENCY = {"latency_median_us": "250", "latency_p99_us": "301.5", "latency_p999_us": "nan"}


@pytest.fixture(scope="module")
def summary() -> Summary:
    return replace(summarise(JITTER, requirements=(APE,)), mode="realtime", loop="fsm", budget=None)


def recorded(plant: Any = None, recorder: Any = None) -> Any:
    statistics = {"plant": plant or {}, "recorder": recorder or {}}
    return SimpleNamespace(parameters={"statistics": statistics, "max_missed": 1.0})


def metrics(summary: Summary, plant: Any = None, recorder: Any = None) -> dict[str, Any]:
    return screen._metrics(recorded(plant, recorder), summary, ("one",))


def rows(table: Table) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for cells in zip(*([str(cell) for cell in column.cells] for column in table.columns)):
        assert cells[0] not in found, "one row each"
        found[cells[0]] = list(cells[1:])
    return found


@pytest.mark.parametrize(
    ("plant", "skipped", "told"),
    [
        ({}, 0, ""),
        ({}, 4, ""),  # windows that miss samples for another reason
        ({"lost_periods": "3"}, 0, "3 periods lost: the plant held its command, and no sample was sent"),
        ({"lost_periods": "3"}, 4, "no sample was sent; 4 windows of 20 ms with one excluded"),
        ({"lost_periods": "1"}, 1, "1 period lost: the plant held its command, and no sample was sent; 1 window of"),
        ({"unsent_ticks": "2"}, 1, "in 2 ticks samples of the device were incomplete"),
    ],
)
def test_what_a_plant_could_not_send_is_told_with_the_windows_that_it_cost(
    summary: Summary, plant: dict[str, str], skipped: int, told: str
) -> None:
    found = screen._lost_periods(recorded(plant), replace(summary, windows_skipped=skipped))
    assert told in found and bool(found) == bool(told) and ("window" in found) == bool(told and skipped)
    assert ("--mode lockstep" in found) == ("lost_periods" in plant)
    rig = recorded(plant)
    rig.parameters["device"] = "my_rig:Rig"
    assert "--mode lockstep" not in screen._lost_periods(rig, summary), "a rig has no other mode"


def test_periods_are_ticks_and_skipped_ones(summary: Summary) -> None:
    found = metrics(summary, COUNTS)
    assert (found["ticks"], found["missed_ticks"], found["periods"]) == (2000, 3, 2005)
    silent = metrics(summary, {"skipped_periods": "4"})
    assert (silent["ticks"], silent["periods"], silent["missed_ticks"]) == (summary.ticks, summary.ticks + 4, None)
    assert metrics(summary)["periods"] == summary.ticks == 2000


def test_samples_lost_are_the_larger_count(summary: Summary) -> None:
    assert summary.samples_lost == 0 and metrics(summary)["samples_lost"] == 0
    assert metrics(summary, None, {"samples_lost": "7"})["samples_lost"] == 7
    assert metrics(replace(summary, samples_lost=9), None, {"samples_lost": "7"})["samples_lost"] == 9


def test_share_of_missed_ticks() -> None:
    """Of the periods; more missed, a larger share; none where time was not real or nothing was counted."""
    shares = [missed_share({"mode": "realtime", "missed_ticks": k, "periods": 200}) for k in (0, 1, 50, 200)]
    assert shares == [0.0, 0.5, 25.0, 100.0]
    assert missed_share({"mode": "realtime", "missed_ticks": 1, "periods": 0}) == 100.0
    assert missed_share({"mode": "lockstep", "missed_ticks": 5, "periods": 10}) == 0.0
    assert missed_share({"mode": "realtime", "missed_ticks": None, "periods": 10}) == 0.0


def test_missed_ticks_are_judged_at_their_limit(summary: Summary) -> None:
    found = metrics(summary, COUNTS | LATENCY)
    share = missed_share(found)
    for limit, verdict in ((share, "met"), (0.99 * share, "not met")):
        table = rows(screen._table(summary, {**found, "max_missed": limit}))
        assert table["missed ticks"] == ["3 of 2005 (0.15 %)", f"{limit:g} %", "", verdict]
    assert table["sensor to command: median, 99 %, 99.9 %"][0] == "250 / 302 / – µs"


@pytest.mark.parametrize(("mode", "counts"), [("lockstep", COUNTS), ("realtime", {}), ("inprocess", {})])
def test_ticks_are_missed_in_real_time_only(summary: Summary, mode: str, counts: dict[str, str]) -> None:
    other = replace(summary, mode=mode)
    table = rows(screen._table(other, metrics(other, counts)))
    assert not {"missed ticks", "sensor to command: median, 99 %, 99.9 %"} & set(table)


@pytest.mark.parametrize(
    ("lost", "open_end", "verdict"),
    [(0, False, "met"), (2, False, "not met"), (2, True, "not met"), (0, True, "not known: truncated")],
)
def test_lost_samples_are_judged_where_they_are_known(
    summary: Summary, lost: int, open_end: bool, verdict: str
) -> None:
    other = replace(summary, samples_lost=lost, open_end=open_end)
    cells = rows(screen._table(other, metrics(other)))["samples lost"]
    assert cells == [other.lost_text(lost), "0", "", verdict]


def toned(*levels: tuple[float, float, float]) -> WorstToneRun:
    return WorstToneRun("slow", 3.0, 0.5, 40.0, 20.0, 20.0, tuple(ToneLevel(*level) for level in levels))


@pytest.mark.parametrize(
    ("levels", "shown", "text"),
    [
        (((40.0, 39.6, 0.997), (100.0, 39.6, 0.997)), "39.6 mas", "meets 100 and 40"),
        (((100.0, 40.1, 0.997), (40.0, 40.1, 0.997)), "40.1 mas", "meets 100, exceeds 40"),
        (((100.0, 482.0, 0.997), (40.0, 482.0, 0.997)), "482 mas", "exceeds 100 and 40"),
        (((100.0, 38.0, 0.95), (40.0, 41.0, 0.999)), "38 mas (95 %), 41 mas (99.9 %)", "meets 100, exceeds 40"),
        ((), "", ""),
    ],
)
def test_each_limit_is_compared_with_the_level_of_its_own_probability(
    levels: tuple[tuple[float, float, float], ...], shown: str, text: str
) -> None:
    tone = toned(*levels)
    assert (levels_text(tone), limits_met(tone)) == (shown, text)
