"""Rows of the table of requirements: texts, proven bounds beside them, roundings to the safe side, overall verdicts."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pointing_analysis.formatting.number_text import at_least, at_most, digits, number
from pointing_analysis.indices.confidence import Quantile
from pointing_analysis.requirements.guarantee import proven_bound
from pointing_analysis.requirements.rows import (
    BRIEF,
    DISTURBED,
    WITHIN,
    Beside,
    RequirementRow,
    css_class,
    definition_table,
    overall,
    requirement_table,
    rows_of,
    verdict_table,
)
from pointing_analysis.requirements.summary import beside_of
from pointing_analysis.requirements.verdict import Verdict, decide, parse
from pointing_analysis.units import ANGLES, RAD_PER_MAS

RULE = parse("prob(|RPE(250 ms)| < 40 mas) >= 0.75 at 90 % confidence, mixed", "long")


def verdict(value: float = 30.0, upper: float = 36.0, **changes: Any) -> Verdict:
    found = Quantile(0.75, 0.9, value * RAD_PER_MAS, 0.0, upper * RAD_PER_MAS, 50.0)
    return replace(Verdict(RULE, "compliant", 0.125, found, 2000, 50.0, 8.0, 8.0), **changes)


OPEN = verdict(status="not enough data", seconds_needed=12.3)
NOTHING: dict[str, Any] = {"exceeding": math.nan, "samples": 0, "effective": 0.0, "seconds_needed": math.nan}
NOT_JUDGED = verdict(math.nan, math.inf, status="not judged", note="no window", **NOTHING)


def brief(row: RequirementRow) -> tuple[str, ...]:
    return requirement_table([row]).only(*BRIEF).rows[0]


def test_numbers_as_text_and_for_json() -> None:
    values = (12.3456, 0.00123456, 999.4, 1000.0, -1234567.8, math.nan, math.inf, 0.0)
    assert [*map(digits, values)] == ["12.3", "0.00123", "999", "1000", "-1234568", "–", "no bound", "0"]
    assert digits(123456.0, 6) == "123456" and digits(12.3456, 5) == "12.346"
    assert [*map(number, (1.23456789, math.inf, math.nan, -math.inf))] == [1.23457, None, None, None]


def test_a_row() -> None:
    row = RequirementRow.of(verdict(), "run")
    assert brief(row) == ("long: |RPE(250 ms)|, 75 %, mixed", "30 mas", "40 mas", "36 mas at 90 %", "compliant")
    assert (row.run, row.name, row.text, row.css) == ("run", "long", str(RULE), "ok")
    assert (row.exceeding_text, row.effective_text) == ("12.5 %", "50 of 2000")
    assert (row.margin_text, row.relative_margin) == ("+10 mas (25 %)", pytest.approx(0.25))
    texts = {"name": "long", "text": str(RULE), "quantity": "|RPE(250 ms)|, 75 %, mixed", "unit": "mas", "note": ""}
    texts |= dict.fromkeys(("status", "statement"), "compliant")
    levels = {"quantile": 30.0, "limit": 40.0, "upper_bound": 36.0, "confidence": 0.9, "exceeding": 0.125}
    counts = {"effective_samples": 50.0, "seconds_needed": 8.0, "missing": 0.0}
    assert row.as_dict() == {**texts, **levels, **counts}
    temporal = verdict(requirement=replace(RULE, interpretation="temporal"))
    assert RequirementRow.of(temporal).quantity == "|RPE(250 ms)|, 75 %"


@pytest.mark.parametrize(
    ("found", "text", "margin"),
    [(verdict(50.0), "−10 mas (25 %)", -0.25), (verdict(40.0), "+0 mas (0 %)", 0.0), (NOT_JUDGED, "", math.nan)],
)
def test_margins(found: Verdict, text: str, margin: float) -> None:
    row = RequirementRow.of(found)
    assert row.margin_text == text and row.relative_margin == pytest.approx(margin, nan_ok=True)


def test_a_requirement_that_is_not_judged_has_no_number() -> None:
    row = RequirementRow.of(NOT_JUDGED)
    assert brief(row)[1:] == ("–", "40 mas", "–", "not judged: no window")
    assert (row.exceeding_text, row.css, row.shown) == ("–", "open", "not judged")
    assert {row.as_dict()[key] for key in ("quantile", "upper_bound", "exceeding", "seconds_needed")} == {None}
    bare = RequirementRow.of(replace(NOT_JUDGED, note=""))
    assert bare.verdict_text == "not judged"


def test_the_verdict_has_a_line_for_each_index_of_each_run_with_the_worst_of_its_requirements() -> None:
    ape = replace(RULE, index="APE", times=(), name="APE", interpretation="temporal")
    strict = replace(RULE, limit=20 * RAD_PER_MAS, name="strict")
    rows = [RequirementRow.of(v, "a") for v in (verdict(requirement=ape), OPEN, verdict())]
    rows += [RequirementRow.of(v, "b") for v in (verdict(), verdict(19.0, requirement=strict))]
    table = verdict_table(rows, several=True)
    assert [row[0] for row in table.rows] == ["a", "a", "b"]
    assert table.rows[0][1:3] == ("|APE|, 75 %", "compliant")
    assert table.rows[1][1].startswith("RPE, worst of 2 requirements\n") and table.rows[1][2].startswith(WITHIN)
    assert table.rows[2][3:] == ("19 mas", "20 mas", "+1 mas (5 %)"), "of two that are compliant that of least margin"
    assert verdict_table(rows[:1]).heads == table.heads[1:]
    assert definition_table(rows).rows[:2] == (("APE", str(ape)), ("long", str(RULE)))


def test_shown_and_overall() -> None:
    bad, above = verdict(status="not compliant", exceeding=1.0), replace(OPEN, exceeding=0.5)
    shown = [RequirementRow.of(v).shown for v in (verdict(), OPEN, above, bad)]
    assert shown == ["compliant", WITHIN, "not enough data", "not compliant"]
    ranked = [bad, above, NOT_JUDGED, OPEN, verdict()]
    for i, worst in enumerate(ranked):
        assert overall(ranked[i:]) == overall(ranked[i:][::-1]) == RequirementRow.of(worst).shown
    assert overall([]) == "not judged"
    assert [*map(css_class, shown), css_class("not judged")] == ["ok", "within", "open", "bad", "open"]


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
FINEST = parse(RPE, "RPE, finest")
SHORT = decide(FINEST, 25.0 * MAS * (1 + 0.1 * (1.0 * np.arange(100) % 2)), 100.0, 2.0)


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


def test_what_is_no_bound_is_none() -> None:
    for fast in (3.0, [None, 0.997], [-1e-7, 0.997], [1e-7, 1.5], [1e-7]):
        assert proven_bound(recorded(proof_bounds={"window_s": 0.02, "fast": fast}), parse(RPE, "RPE")) is None, fast
    for nothing in (None, "", list[float]()):
        assert proven_bound(recorded(proof_bounds=nothing), parse(RPE, "RPE")) is None


def checked(beside: Beside) -> Beside:
    """As where the certificates say the same."""
    assert beside.proven is not None and not beside.proven.checked
    return replace(beside, proven=replace(beside.proven, checked=True))


def test_a_bound_that_nobody_checked_is_not_said_to_be_proven() -> None:
    """Whoever writes a bag can write any bound into it."""
    (row,) = rows_of([SHORT], [beside_of(recorded(), FINEST)])
    assert row.bound_text == "39.99 mas (99.7 %), stated in the bag, not checked"
    assert "stated_bound" in row.as_dict() and not [key for key in row.as_dict() if "proven" in key]


def test_a_row_has_the_proven_bound_where_the_record_shows_none() -> None:
    """Rounded up, in the unit of the requirement, with its probability; the same in JSON."""
    (row,) = rows_of([SHORT], [checked(beside_of(recorded(), FINEST))])
    assert row.bound_text == "39.99 mas, proven (99.7 %)"
    content = row.as_dict()
    assert content["proven_bound"] == pytest.approx(39.9841, abs=2e-4) and content["upper_bound"] is None
    assert "proven_without" not in content
    late = recorded(proof_bounds={**BOUNDS, "condition": "16 missed ticks"})
    (row,) = rows_of([SHORT], [checked(beside_of(late, FINEST))])
    assert row.bound_text == "39.99 mas, proven (99.7 %) without the 16 missed ticks"
    assert row.as_dict()["proven_without"] == "16 missed ticks"
    for parameters, text in (({"loop": "fsm"}, "no proof for this loop"), ({}, "not demonstrated: record too short")):
        assert rows_of([SHORT], [beside_of(SimpleNamespace(parameters=parameters), FINEST)])[0].bound_text == text


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
        asked = {"mode": "realtime", "max_missed": 0.5, "statistics": statistics, **other}
        assert not beside_of(recorded(**asked), requirement).disturbed
    assert Beside().disturbed == ""


def test_a_bound_from_above_is_rounded_up_and_one_from_below_down() -> None:
    """By no more than one unit of the last digit, and beyond the rounding of units, 1e-14."""
    chance = random.Random(0)
    for _ in range(3000):
        value = chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-12.0, 12.0)
        digits = chance.randrange(2, 8)
        above, below = float(at_most(value, digits)), float(at_least(value, digits))
        slack = Fraction(abs(value)) / 10**13
        assert Fraction(below) - slack <= Fraction(value) <= Fraction(above) + slack
        assert above - below <= 1.0001 * 10.0 ** (math.floor(math.log10(abs(value))) + 2 - digits)


def test_what_has_so_few_digits_stays() -> None:
    for text in ("0.492", "9.947", "1e-07", "40", "0", "0.001", "1093"):
        assert at_most(float(text)) == at_least(float(text)) == text
    assert (at_most(math.inf), at_least(-math.inf)) == ("inf", "-inf")
    assert (at_most(0.1 * 3.0, 4), at_least(0.1 * 3.0, 4)) == ("0.3", "0.3"), "rounding of units"
    assert (at_most(0.44400046), at_least(0.44399999)) == ("0.4441", "0.4439")
