"""The table of a run and its JSON object: statistics of the nodes, shares of ticks, lines beside the table."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from los_testbed.run.older_bags import REMARK
from los_testbed.run.summary import summary as screen
from los_testbed.run.summary.source_shares import as_rows
from los_testbed.run.summary.summary import RunSummaries, missed_share, print_summary, summarise_runs
from rich.console import Console
from rich.table import Table

from pointing_analysis.read.series import series
from pointing_analysis.report.outputs import ReportOutputs
from pointing_analysis.report.source_share import SourceShare
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.summary import UNKNOWN, Summary, summarise

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


def printed(results: RunSummaries, **options: Any) -> str:
    file = io.StringIO()
    print_summary(Console(file=file, width=60, **options), results)
    return file.getvalue()


@pytest.mark.parametrize(
    ("plant", "skipped", "told"),
    [
        ({}, 0, ""),
        ({}, 4, ""),  # windows that miss samples for another reason
        (
            {"lost_periods": "3"},
            0,
            "3 periods were lost: the plant held its command, and no sample was sent",
        ),
        ({"lost_periods": "3"}, 4, "no sample was sent; 4 windows of 20 ms with one are excluded"),
        ({"unsent_ticks": "2"}, 1, "in 2 ticks samples of the device were incomplete"),
    ],
)
def test_what_a_plant_could_not_send_is_told_with_the_windows_that_it_cost(
    summary: Summary, plant: dict[str, str], skipped: int, told: str
) -> None:
    found = screen._lost_periods(recorded(plant), replace(summary, windows_skipped=skipped))
    assert told in found and bool(found) == bool(told) and ("windows" in found) == bool(told and skipped)
    assert ("--mode lockstep" in found) == ("lost_periods" in plant)
    rig = recorded(plant)
    rig.parameters["device"] = "my_rig:Rig"
    assert "--mode lockstep" not in screen._lost_periods(rig, summary), "a rig has no other mode"


def test_statistics_are_the_numbers_that_a_count_can_be() -> None:
    plant = {
        "ticks": "1e15",
        "missed_ticks": "-1",
        "samples_lost": "0",
        "latency_median_us": "-5",
        "skipped_periods": "x",
        "note": None,
        "large": "2e15",
    }
    assert screen._statistics(recorded(plant), "plant") == {
        "samples_lost": 0.0,
        "latency_median_us": -5.0,
        "large": 2e15,
    }
    assert screen._statistics(recorded({"ticks": "999999999999999"}), "plant") == {"ticks": 999999999999999.0}
    for odd in ({"statistics": "none"}, {"statistics": {"plant": [1]}}, {}):
        assert screen._statistics(SimpleNamespace(parameters=odd), "plant") == {}


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


def test_latency_is_there_as_a_whole_or_not_at_all(summary: Summary) -> None:
    assert metrics(summary, LATENCY)["latency_us"] == {"median": 250.0, "p99": 301.5, "p999": None}
    part = {name: text for name, text in LATENCY.items() if "p99_" not in name}
    assert metrics(summary, part)["latency_us"] == dict.fromkeys(("median", "p99", "p999"))


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


def test_a_quantity_stands_once_and_numbers_stand_right(summary: Summary) -> None:
    table = screen._table(summary, metrics(summary))
    assert {str(c.header): c.justify for c in table.columns if c.justify == "right"}.keys() == {
        "value",
        "limit",
    }
    judged = {row.quantity for row in summary.rows}
    beside = [figure for figure in summary.figures if figure.quantity not in judged]
    assert len(beside) == len(summary.figures) - 1  # the requirement is on one of them
    assert set(rows(table)) == {*judged, *(figure.name for figure in beside), "samples lost"}
    assert [row.css for row in summary.rows] == ["within"]
    assert table.columns[-1]._cells[0].style == "green"  # type: ignore[union-attr]


def test_title_names_what_is_known(summary: Summary) -> None:
    whole = screen._table(replace(summary, scenario="design", transient=0.5), metrics(summary))
    assert str(whole.title) == "fsm, design, realtime, 2 s, first 0.5 s (start-up) excluded"
    bare = screen._table(replace(summary, loop="", scenario="", mode="", transient=0.0), metrics(summary))
    assert str(bare.title) == f"{summary.path.name}, 2 s, steady start"


def test_lines_below_the_table(summary: Summary) -> None:
    """Budget, remarks, defects, paths: each where there is one, as it is, in one line."""
    budget = "RPE [bold]12.5[/bold] mas, " + "noise 3.25 mas, " * 6
    other: Any = replace(summary, budget=budget, problems=("a defect",), requirements_known=False)  # type: ignore[arg-type]
    one = {**metrics(summary), "remarks": ["first", "second"]}
    text = printed(
        RunSummaries((other,), (one,), ReportOutputs(Path("page.html"))), force_terminal=True, color_system="standard"
    )
    lines = text.splitlines()
    assert budget.rstrip() in [line.rstrip() for line in lines]  # no markup, no colour, no break
    wanted = [UNKNOWN, "first", "second", "a defect"]
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines]
    assert [line for line in plain if line.startswith("note: ")] == [f"note: {text}" for text in wanted]
    assert lines[-2:] == [f"arrays  {other.path}", "report  page.html"]
    bare = printed(RunSummaries((summary,), (metrics(summary) | {"remarks": []},)))
    assert UNKNOWN not in bare and "None" not in bare and "report" not in bare


def test_what_is_open_is_summarised_without_a_report() -> None:
    found = summarise_runs([JITTER], None, requirements=(APE,))
    assert not found.outputs and found.remarks == ((),)
    (one,) = found.runs
    assert one["ticks"] == 2000 and one["remarks"] == [] and REMARK not in one["remarks"]
    assert one["bag"] == str(found.summaries[0].path) and one["loop"] == found.summaries[0].loop
    assert "disturbances" not in one and found.shares == ((),)


def test_sources_and_notes_of_each_run_are_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shares of a run, or why there are none; an older bag says whose requirements it is judged by."""
    wheel = SourceShare("wheel", "tone", "hub", 1.0, 2.0, 1.0)
    older = series(None, 0.1 * JITTER["truth/los"].values, unit="rad", rate=1000.0, name="older")

    def shares(run: Any) -> tuple[SourceShare, ...]:
        if run.path.name == "older":
            raise ValueError("no telescope")
        return (wheel,)

    monkeypatch.setattr(screen, "source_shares", shares)
    monkeypatch.setattr(screen, "is_older", lambda run: run.path.name == "older")
    monkeypatch.setattr(screen, "with_requirements", lambda run: replace(run, label="older one"))
    found = summarise_runs([JITTER, older], None)
    assert [one.get("disturbances") for one in found.runs] == [as_rows([wheel]), None]
    assert found.shares == ((wheel,), ()) and found.remarks == ((), (REMARK, "no telescope"))
    assert [run.label for run in screen.judged([JITTER, older], None, None).runs] == [JITTER.label, "older one"]
    assert summarise_runs([older], None, requirements=(APE,)).remarks == (("no telescope",),)


def test_remarks_are_what_a_bag_says_of_itself(summary: Summary) -> None:
    run: Any = SimpleNamespace(parameters={"start_note": "starts at rest", "proof": ""}, attachments={})
    assert screen.remarks_of(run, summary) == ("starts at rest",)
