"""Texts of a row of the table of requirements, and what several verdicts are together."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from pointing_analysis.indices.confidence import Quantile
from pointing_analysis.requirements.rows import HEADS, KEEPS, RequirementRow, cells, css_class, digits, number, overall
from pointing_analysis.requirements.verdict import Verdict, parse
from pointing_analysis.units import RAD_PER_MAS

RULE = parse("prob(|RPE(250 ms)| < 40 mas) >= 0.75 at 90 % confidence, mixed", "long")


def verdict(value: float = 30.0, upper: float = 36.0, **changes: Any) -> Verdict:
    found = Quantile(0.75, 0.9, value * RAD_PER_MAS, 0.0, upper * RAD_PER_MAS, 50.0)
    return replace(Verdict(RULE, "compliant", 0.125, found, 2000, 50.0, 8.0, 8.0), **changes)


OPEN = verdict(status="not enough data", seconds_needed=12.3)
NOT_JUDGED = verdict(
    math.nan,
    math.inf,
    status="not judged",
    exceeding=math.nan,
    samples=0,
    effective=0.0,
    seconds_needed=math.nan,
    note="no window",
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12.3456, "12.3"),
        (0.00123456, "0.00123"),
        (999.4, "999"),
        (1000.0, "1000"),
        (-1234567.8, "-1234568"),
        (math.nan, "–"),
        (math.inf, "no bound yet"),
        (0.0, "0"),
    ],
)
def test_digits(value: float, text: str) -> None:
    assert digits(value) == text
    assert digits(123456.0, 6) == "123456" and digits(12.3456, 5) == "12.346"


@pytest.mark.parametrize(
    ("value", "places", "text"),
    [(999.4, 3, "999"), (999.5, 3, "1000"), (-999.6, 3, "-1000"), (1000.2, 3, "1000"), (999.6, 6, "999.6")],
)
def test_digits_write_no_power_of_ten_for_what_is_rounded_to_a_thousand(value: float, places: int, text: str) -> None:
    assert digits(value, places) == text


def test_numbers_for_json() -> None:
    assert (number(1.23456789), number(math.inf), number(math.nan), number(-math.inf)) == (1.23457, None, None, None)


def test_a_row() -> None:
    row = RequirementRow.of(verdict(), "run")
    assert cells(row) == ("|RPE(250 ms)|, 75 %, mixed", "30 mas", "40 mas", "36 mas at 90 %", "compliant")
    assert len(HEADS) == len(cells(row))
    assert (row.run, row.name, row.text, row.css, row.remark) == ("run", "long", str(RULE), "ok", "")
    assert (row.exceeding_text, row.effective_text) == ("12.5 %", "50 of 2000")
    assert (row.margin_text, row.margin_css) == ("margin +10 mas (25 %)", "ok")
    assert row.as_dict() == {
        "name": "long",
        "text": str(RULE),
        "quantity": "|RPE(250 ms)|, 75 %, mixed",
        "status": "compliant",
        "statement": "compliant",
        "quantile": 30.0,
        "limit": 40.0,
        "upper_bound": 36.0,
        "confidence": 0.9,
        "unit": "mas",
        "exceeding": 0.125,
        "effective_samples": 50.0,
        "seconds_needed": 8.0,
        "missing": 0.0,
        "note": "",
    }
    assert RequirementRow.of(replace(verdict(), requirement=replace(RULE, interpretation="temporal"))).quantity == (
        "|RPE(250 ms)|, 75 %"
    )


@pytest.mark.parametrize(
    ("found", "text", "css"),
    [
        (verdict(50.0), "margin −10 mas (25 %)", "bad"),
        (verdict(40.0), "margin +0 mas (0 %)", "ok"),
        (NOT_JUDGED, "", "open"),
    ],
)
def test_margins(found: Verdict, text: str, css: str) -> None:
    row = RequirementRow.of(found)
    assert (row.margin_text, row.margin_css) == (text, css)


def test_a_requirement_that_is_not_judged_has_no_number() -> None:
    row = RequirementRow.of(NOT_JUDGED)
    assert cells(row)[1:] == ("–", "40 mas", "–", "not judged: no window")
    assert (row.exceeding_text, row.remark, row.css, row.shown) == ("–", "no window", "open", "not judged")
    assert {row.as_dict()[key] for key in ("quantile", "upper_bound", "exceeding", "seconds_needed")} == {None}
    bare = RequirementRow.of(replace(NOT_JUDGED, note=""))
    assert bare.verdict_text == "not judged"


def test_remarks() -> None:
    def remark(**changes: Any) -> str:
        return RequirementRow.of(replace(OPEN, **changes)).remark

    assert remark() == "not yet demonstrated: needs 13 s"
    assert remark(exceeding=0.5) == "not yet demonstrated: needs 13 s"
    assert remark(seconds_needed=math.inf) == "no length of run decides it"
    assert remark(note="cut off") == "not yet demonstrated: needs 13 s. cut off"
    assert RequirementRow.of(verdict(note="2 of 9 are missing")).remark == "2 of 9 are missing"
    no_bound = RequirementRow.of(replace(OPEN, quantile=replace(OPEN.quantile, upper=math.inf)))
    assert no_bound.bound_text == "none: too short a record" and no_bound.as_dict()["upper_bound"] is None


def test_shown_and_overall() -> None:
    bad, above = verdict(status="not compliant", exceeding=1.0), replace(OPEN, exceeding=0.5)
    assert [RequirementRow.of(v).shown for v in (verdict(), OPEN, above, bad)] == [
        "compliant",
        KEEPS,
        "not enough data",
        "not compliant",
    ]
    ranked = [bad, above, NOT_JUDGED, OPEN, verdict()]
    for i, worst in enumerate(ranked):
        assert overall(ranked[i:]) == overall(ranked[i:][::-1]) == RequirementRow.of(worst).shown
    assert overall([]) == "not judged"
    assert [css_class(s) for s in ("compliant", KEEPS, "not compliant", "not judged", "not enough data")] == [
        "ok",
        "ok",
        "bad",
        "open",
        "open",
    ]
