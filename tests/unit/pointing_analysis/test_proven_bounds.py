"""Bounds that are proven for a loop, beside what a short run shows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pointing_analysis.requirements.guarantee import proven_bound
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.rows import DISTURBED, Beside, overall, rows_of
from pointing_analysis.requirements.summary import beside_of
from pointing_analysis.requirements.verdict import decide
from pointing_analysis.units import ANGLES

MAS = ANGLES["mas"]
BOUNDS = {
    "APE": [9.9771e3 * MAS, 0.997],
    "slow": [39.8732 * MAS, 0.997],
    "fast": [39.9841 * MAS, 0.997],
    "both": [42.9543 * MAS, 0.997],
    "window_s": 0.02,
    "condition": "",
}
RPE = "prob(rms RPE(20 ms) < 40 mas) >= 0.997 at 95 % confidence"


def recorded(tones: Any = (378.2,), **more: Any) -> Any:
    budget = {"noise": 1.0, "band_edge_rad_s": 85.0}
    return SimpleNamespace(
        parameters={"proof_bounds": BOUNDS, "rpe_budget_mas": budget, "tones_rad_s": list(tones), "loop": "fsm"} | more
    )


@pytest.mark.parametrize(
    ("tones", "mas"),
    [((378.2,), 39.9841), ((0.7,), 39.8732), ((0.7, 378.2), 42.9543), ((), 42.9543), ((85.0,), 39.8732)],
)
def test_the_bound_is_that_of_the_tones_that_act(tones: tuple[float, ...], mas: float) -> None:
    found = proven_bound(recorded(tones), parse(RPE, "RPE"))
    assert found is not None and found.value == pytest.approx(mas * MAS) and found.probability == 0.997


@pytest.mark.parametrize(
    "text",
    [
        RPE.replace("20 ms", "50 ms"),
        RPE.replace("0.997", "0.9999"),
        RPE.replace("rms RPE(20 ms)", "|RPE(20 ms)|"),
        RPE.replace("rms RPE(20 ms)", "|PDE(20 ms, 1 s)|"),
        "prob(MTF(20 ms, Nyquist) > 0.9) >= 0.997 at 95 % confidence",
        "prob(|APE_x| < 10 arcsec) >= 0.997 at 95 % confidence",
    ],
)
def test_another_window_probability_or_index_has_none(text: str) -> None:
    assert proven_bound(recorded(), parse(text, "other")) is None


@pytest.mark.parametrize(
    "odd",
    [
        None,
        [],
        {"fast": 3.0},
        {"fast": [None, 0.997]},
        {"fast": [-1e-7, 0.997]},
        {"fast": [1e-7, 1.5]},
        {"fast": [1e-7]},
    ],
)
def test_what_is_no_bound_is_none(odd: Any) -> None:
    found = {"window_s": 0.02, **odd} if isinstance(odd, dict) else odd
    assert proven_bound(recorded(proof_bounds=found), parse(RPE, "RPE")) is None


def checked(beside: Beside) -> Beside:
    """As where the certificates say the same."""
    assert beside.proven is not None and not beside.proven.checked
    return replace(beside, proven=replace(beside.proven, checked=True))


def test_a_bound_that_nobody_checked_is_not_said_to_be_proven() -> None:
    """Whoever writes a bag can write any bound into it."""
    requirement = parse(RPE, "RPE, finest")
    short = decide(requirement, 25.0 * MAS * (1 + 0.1 * (1.0 * np.arange(100) % 2)), 100.0, 2.0)
    (row,) = rows_of([short], [beside_of(recorded(), requirement)])
    assert row.bound_text == "39.99 mas (99.7 %), stated in the bag, not checked"
    assert "stated_bound" in row.as_dict() and not [key for key in row.as_dict() if "proven" in key]


def test_a_row_has_the_proven_bound_where_the_record_shows_none() -> None:
    """Rounded up, in the unit of the requirement, with its probability; the same in JSON."""
    requirement = parse(RPE, "RPE, finest")
    short = decide(requirement, 25.0 * MAS * (1 + 0.1 * (1.0 * np.arange(100) % 2)), 100.0, 2.0)
    (row,) = rows_of([short], [checked(beside_of(recorded(), requirement))])
    assert row.bound_text == "39.99 mas, proven (99.7 %)"
    content = row.as_dict()
    assert content["proven_bound"] == pytest.approx(39.9841, abs=2e-4) and content["upper_bound"] is None
    assert "proven_without" not in content
    late = recorded(proof_bounds={**BOUNDS, "condition": "16 missed ticks"})
    (row,) = rows_of([short], [checked(beside_of(late, requirement))])
    assert row.bound_text == "39.99 mas, proven (99.7 %) without the 16 missed ticks"
    assert row.as_dict()["proven_without"] == "16 missed ticks"
    other = SimpleNamespace(parameters={"loop": "fsm"})
    assert rows_of([short], [beside_of(other, requirement)])[0].bound_text == "no proof for this loop"
    foreign = SimpleNamespace(parameters={})
    assert rows_of([short], [beside_of(foreign, requirement)])[0].bound_text == "not demonstrated: record too short"


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"proof_bounds": ""}, "no proof for this loop"),
        ({"proof_bounds": "", "proof_noise": "with noise, proven: ..."}, "no proof for this disturbance"),
        ({"proof_bounds": "", "proof_rpe": {"rms_rad": 1e-7, "exposure_s": 0.02}}, "no proof for this disturbance"),
        ({}, "no proof of this quantity"),
    ],
)
def test_a_table_without_a_bound_says_what_there_is_no_proof_of(more: dict[str, Any], text: str) -> None:
    """A loop with a proof has one, though not of this quantity or of what acts: the remarks of the run say so."""
    other = parse(RPE.replace("20 ms", "50 ms"), "RPE")
    short = decide(other, 25.0 * MAS * np.ones(50), 50.0, 1.0)
    assert rows_of([short], [beside_of(recorded(**more), other)])[0].bound_text == text


def test_a_run_that_missed_too_many_ticks_is_disturbed() -> None:
    """In real time, at the limit that the run had; the words stand in every output."""
    statistics = {"plant": {"ticks": "1000", "missed_ticks": "6"}}
    run = recorded(mode="realtime", max_missed=0.5, statistics=statistics)
    requirement = parse(RPE, "RPE")
    numbers = 25.0 * MAS * np.ones(50)
    verdict = decide(requirement, numbers, 50.0, 1.0)
    (row,) = rows_of([verdict], [beside_of(run, requirement)])
    assert row.shown == DISTURBED and row.css == "open"
    assert row.verdict_text.startswith("disturbed: 0.6 % of the ticks were missed; ")
    assert row.as_dict()["disturbed"] == "0.6 % of the ticks were missed"
    assert overall([verdict], "0.6 %") == DISTURBED
    skipped = {"plant": {"ticks": "1000", "missed_ticks": "6", "skipped_periods": "200"}}  # 0.5 % of 1200 periods
    others: list[dict[str, Any]] = [{"mode": "lockstep"}, {"max_missed": 0.6}, {"statistics": {}}, {"max_missed": "x"}]
    others.append({"statistics": skipped})
    for other in others:
        found = beside_of(
            recorded(**{"mode": "realtime", "max_missed": 0.5, "statistics": statistics, **other}), requirement
        )
        assert not found.disturbed
    assert Beside().disturbed == ""
