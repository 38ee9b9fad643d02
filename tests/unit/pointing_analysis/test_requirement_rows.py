"""Texts of a row of the table of requirements, and what several verdicts are together."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from pointing_analysis.formatting.number_text import digits, number
from pointing_analysis.indices.confidence import Quantile
from pointing_analysis.requirements.rows import (
    BRIEF,
    WITHIN,
    RequirementRow,
    css_class,
    definition_table,
    overall,
    requirement_table,
    verdict_table,
)
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


def brief(row: RequirementRow) -> tuple[str, ...]:
    return requirement_table([row]).only(*BRIEF).rows[0]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12.3456, "12.3"),
        (0.00123456, "0.00123"),
        (999.4, "999"),
        (1000.0, "1000"),
        (-1234567.8, "-1234568"),
        (math.nan, "–"),
        (math.inf, "no bound"),
        (0.0, "0"),
    ],
)
def test_digits(value: float, text: str) -> None:
    assert digits(value) == text
    assert digits(123456.0, 6) == "123456" and digits(12.3456, 5) == "12.346"


def test_numbers_for_json() -> None:
    assert (number(1.23456789), number(math.inf), number(math.nan), number(-math.inf)) == (1.23457, None, None, None)


def test_a_row() -> None:
    row = RequirementRow.of(verdict(), "run")
    assert brief(row) == ("long: |RPE(250 ms)|, 75 %, mixed", "30 mas", "40 mas", "36 mas at 90 %", "compliant")
    assert (row.run, row.name, row.text, row.css) == ("run", "long", str(RULE), "ok")
    assert (row.exceeding_text, row.effective_text) == ("12.5 %", "50 of 2000")
    assert (row.margin_text, row.relative_margin) == ("+10 mas (25 %)", pytest.approx(0.25))
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
    assert [RequirementRow.of(v).shown for v in (verdict(), OPEN, above, bad)] == [
        "compliant",
        WITHIN,
        "not enough data",
        "not compliant",
    ]
    ranked = [bad, above, NOT_JUDGED, OPEN, verdict()]
    for i, worst in enumerate(ranked):
        assert overall(ranked[i:]) == overall(ranked[i:][::-1]) == RequirementRow.of(worst).shown
    assert overall([]) == "not judged"
    assert [css_class(s) for s in ("compliant", WITHIN, "not compliant", "not judged", "not enough data")] == [
        "ok",
        "within",
        "bad",
        "open",
        "open",
    ]
