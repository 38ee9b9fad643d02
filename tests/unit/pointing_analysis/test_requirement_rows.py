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
from pointing_analysis.requirements.guarantee import ErrorBounds, ProvenBound
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
BOUNDS = ErrorBounds(ProvenBound(9.9771e3 * MAS, 0.997), ProvenBound(39.9841 * MAS, 0.997), 0.02)
RPE = "prob(rms RPE(20 ms) < 40 mas) >= 0.997 at 95 % confidence"
FINEST = parse(RPE, "RPE, finest")
SHORT = decide(FINEST, 25.0 * MAS * (1 + 0.1 * (1.0 * np.arange(100) % 2)), 100.0, 2.0)


def recorded(**more: Any) -> Any:
    return SimpleNamespace(parameters={"loop": "fsm"} | more)


def test_the_bound_is_that_of_the_index() -> None:
    assert BOUNDS.of(FINEST) is BOUNDS.relative
    assert BOUNDS.of(parse("prob(|APE| < 10 arcsec) >= 0.997 at 95 % confidence", "APE")) is BOUNDS.absolute
    assert replace(BOUNDS, relative=None).of(FINEST) is None


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
    assert BOUNDS.of(parse(text, "other")) is None


def test_a_recording_states_no_bound() -> None:
    """Whoever writes a bag can write any bound into it."""
    stated = recorded(proof_bounds={"fast": [1e-9, 0.9999], "window_s": 0.02}, proof="proven: all of it")
    (row,) = rows_of([SHORT], [beside_of(stated, FINEST)])
    assert row.bound_text == row.as_dict()["unproven"] == "no proof of this run"
    assert not [key for key in row.as_dict() if "proven_" in key]


def test_a_row_has_the_proven_bound_where_the_record_shows_none() -> None:
    """Rounded up, in the unit of the requirement, with its probability; the same in JSON."""
    (row,) = rows_of([SHORT], [Beside(BOUNDS.of(FINEST))])
    assert row.bound_text == "39.99 mas, proven (99.7 %)"
    content = row.as_dict()
    assert content["proven_bound"] == pytest.approx(39.9841, abs=2e-4) and content["upper_bound"] is None
    assert "unproven" not in content
    (row,) = rows_of([SHORT], [beside_of(SimpleNamespace(parameters={}), FINEST)])
    assert replace(row, seconds_needed=9.0).bound_text == "not demonstrated: record too short"
    assert replace(row, seconds_needed=math.inf).bound_text == "not demonstrated"  # a longer one shows no more
    assert "unproven" not in row.as_dict()


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
    others: list[dict[str, Any]] = [{"mode": "lockstep"}, {"max_missed": 0.6}, {"statistics": {}}]
    others.append({"statistics": skipped})
    for other in others:
        asked = {"mode": "realtime", "max_missed": 0.5, "statistics": statistics, **other}
        assert not beside_of(recorded(**asked), requirement).disturbed
    assert Beside().disturbed == ""
    unread = recorded(mode="realtime", max_missed="x", statistics=statistics)
    assert beside_of(unread, requirement).disturbed == "it cannot be read whether too many ticks were missed"


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
