"""Rows of the table of requirements: common content of screen, page, Markdown and JSON about a verdict.

All outputs are made from the same rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pointing_analysis.formatting.number_text import ABSENT, at_most, digits, digits_beside, number, percent, with_unit
from pointing_analysis.formatting.tables import Marked, TextTable, numbers, texts
from pointing_analysis.requirements.guarantee import ProvenBound
from pointing_analysis.requirements.verdict import Status, Verdict
from pointing_analysis.units import ANGLES

WITHIN = "within limit"
"""Shown for a run that is within a limit and too short to demonstrate it."""
DISTURBED = "disturbed"
"""Shown for a run in real time in which more ticks were missed than may be."""
ALL_RUNS = "all runs"
NOT_DEMONSTRATED = "not demonstrated"
TOO_SHORT = f"{NOT_DEMONSTRATED}: record too short"
"""In place of a bound that the record does not show, without a word on proofs."""
MISSING = "not demonstrated: samples are missing"
"""In place of a bound above which as many samples may be as are allowed, and more with those that are missing."""


def css_class(status: str) -> str:
    """Class of a status, its colour and its sign: ok, within (the limit, not demonstrated), bad or open."""
    return {"compliant": "ok", WITHIN: "within", "not compliant": "bad"}.get(status, "open")


def shown_status(v: Verdict) -> str:
    """Status; `WITHIN` for too short a run that exceeds its limit no more often than allowed."""
    return WITHIN if v.status == "not enough data" and v.within_limit else v.status


WORST_FIRST = (DISTURBED, "not compliant", "not enough data", "not judged", WITHIN, "compliant")
"""Shown statuses of a verdict, the worst first."""


def overall(verdicts: Sequence[Verdict], disturbed: str = "") -> str:
    """One word for several verdicts: the worst of them, or that the run was `disturbed`."""
    if disturbed and verdicts:
        return DISTURBED
    statuses = {shown_status(v) for v in verdicts}
    return next((status for status in WORST_FIRST if status in statuses), "not judged")


@dataclass(frozen=True)
class Beside:
    """Further results of a requirement in a run.

    Attributes
    ----------
    proven : bound that is proven for the loop that ran and the tones that acted; None where none is
    unproven : why no bound is proven of a loop; empty where no loop is named
    disturbed : why the verdict is not of the loop alone; empty where it is
    """

    proven: ProvenBound | None = None
    unproven: str = ""
    disturbed: str = ""


NOTHING = Beside()


@dataclass(frozen=True)
class RequirementRow:
    """One requirement, what was measured of it, and the verdict.

    Attributes
    ----------
    run : label of the run, `ALL_RUNS` where several are judged together
    name, text : of the requirement
    quantity : judged quantity with its window and the probability, e.g. ``rms RPE(20 ms), 99.7 %``
    unit : of `value`, `limit` and `bound`
    value : required quantile; NaN where it was not judged
    limit : of the requirement
    bound : upper bound of the quantile at `confidence`, of a lower limit the lower one; infinite where there is none
    confidence : between 0 and 1
    status : of the verdict
    index : of the requirement: those on one index are a group
    shown : status, or `WITHIN` where the run is within the limit and too short to demonstrate it
    statement : verdict in words
    exceeding : share of the samples above the limit, or below a lower one
    samples, effective : samples, and independent ones that they weigh as much as
    seconds_needed : length of data that would decide [s]
    missing : samples that are missing
    note : of the verdict
    lower : whether the limit is a lower one
    beside : what else is known of it
    """

    run: str
    name: str
    text: str
    quantity: str
    unit: str
    value: float
    limit: float
    bound: float
    confidence: float
    status: Status
    shown: str
    statement: str
    index: str
    exceeding: float
    samples: int
    effective: float
    seconds_needed: float
    missing: float
    note: str
    lower: bool = False
    beside: Beside = NOTHING

    @classmethod
    def of(cls, verdict: Verdict, run: str = "", beside: Beside = NOTHING) -> RequirementRow:
        """Row of a verdict."""
        r, scale = verdict.requirement, verdict.requirement.scale
        judged = verdict.status != "not judged"
        disturbed = f"{DISTURBED}: {beside.disturbed}; " if beside.disturbed else ""
        tail = "" if r.interpretation == "temporal" else f", {r.interpretation}"
        return cls(
            run=run,
            name=r.name,
            text=str(r),
            quantity=f"{r.quantity}, {percent(r.probability, 10)}{tail}",
            unit=r.unit,
            value=verdict.quantile.value / scale if judged else math.nan,
            limit=r.limit / scale,
            bound=(verdict.quantile.lower if r.lower else verdict.quantile.upper) / scale if judged else math.nan,
            confidence=r.confidence,
            status=verdict.status,
            shown=DISTURBED if beside.disturbed else shown_status(verdict),
            statement=f"{disturbed}{verdict.statement}",
            index=r.index,
            exceeding=verdict.exceeding,
            samples=verdict.samples,
            effective=verdict.effective,
            seconds_needed=verdict.seconds_needed,
            missing=verdict.missing,
            note=verdict.note,
            lower=r.lower,
            beside=beside,
        )

    @property
    def label(self) -> str:
        """Judged quantity after the name of the requirement, if it has more than the index."""
        return self.quantity if self.name in ("", self.index) else f"{self.name}: {self.quantity}"

    @property
    def css(self) -> str:
        """Class of the verdict: its colour on the page."""
        return css_class(self.shown)

    @property
    def value_text(self) -> str:
        """Value with its unit, or a dash."""
        return ABSENT if math.isnan(self.value) else with_unit(digits_beside(self.value, self.limit), self.unit)

    @property
    def limit_text(self) -> str:
        """Limit with its unit; a lower one is marked."""
        return with_unit(f"{'above ' if self.lower else ''}{self.limit:g}", self.unit)

    @property
    def bound_text(self) -> str:
        """Bound of the quantile with its unit and its confidence; of a lower limit the lower one, which is marked.

        Where the record shows none, the bound that is proven for the loop, or that there is none.
        """
        if math.isnan(self.bound):
            return ABSENT
        if math.isinf(self.bound):
            if self.beside.proven is not None:
                return self.beside.proven.text(self._scale, self.unit)
            short = NOT_DEMONSTRATED if math.isinf(self.seconds_needed) else TOO_SHORT
            return MISSING if self.missing else self.beside.unproven or short
        bound = with_unit(f"{'above ' if self.lower else ''}{digits_beside(self.bound, self.limit)}", self.unit)
        return f"{bound} at {100 * self.confidence:g} %"

    @property
    def exceeding_text(self) -> str:
        """Share of the samples above the limit."""
        return percent(self.exceeding)

    @property
    def effective_text(self) -> str:
        """Independent samples of all."""
        return f"{digits(self.effective)} of {digits(self.samples, 6)}"

    @property
    def verdict_text(self) -> str:
        """Verdict in words, with its note: why there is none, or what is missing."""
        separator = ": " if self.status == "not judged" else "; "
        return self.statement if self.note in self.statement else f"{self.statement}{separator}{self.note}"

    @property
    def margin_text(self) -> str:
        """Distance to the limit, also in % of it, positive where it is met; empty where it was not judged."""
        if math.isnan(self.value):
            return ""
        sign = "+" if self._margin >= 0 else "−"
        return f"{sign}{with_unit(digits(abs(self._margin)), self.unit)} ({100 * abs(self.relative_margin):.0f} %)"

    @property
    def relative_margin(self) -> float:
        """Distance to the limit over the limit, positive where it is met; NaN where it was not judged."""
        return self._margin / self.limit

    @property
    def _scale(self) -> float:
        """Value of the unit [rad]."""
        return ANGLES.get(self.unit, 1.0)

    @property
    def _margin(self) -> float:
        return self.value - self.limit if self.lower else self.limit - self.value

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON; infinities and NaN become None."""
        return {
            "name": self.name,
            "text": self.text,
            "quantity": self.quantity,
            "status": self.status,
            "statement": self.statement,
            "quantile": number(self.value),
            "limit": number(self.limit),
            **({"lower_bound": number(self.bound)} if self.lower else {"upper_bound": number(self.bound)}),
            "confidence": number(self.confidence),
            **self._proven_dict(),
            **({"disturbed": self.beside.disturbed} if self.beside.disturbed else {}),
            "unit": self.unit,
            "exceeding": number(self.exceeding),
            "effective_samples": number(self.effective),
            "seconds_needed": number(self.seconds_needed),
            "missing": number(self.missing),
            "note": self.note,
        }

    def _proven_dict(self) -> dict[str, Any]:
        """Proven bound for JSON, rounded up, or why there is none."""
        proven = self.beside.proven
        if proven is None:
            return {"unproven": self.beside.unproven} if self.beside.unproven else {}
        value = float(at_most(proven.value / self._scale, 6))
        return {"proven_bound": value, "proven_probability": proven.probability}


def rows_of(verdicts: Sequence[Verdict], beside: Sequence[Beside], run: str = "") -> list[RequirementRow]:
    """Rows of the verdicts on one run."""
    more = list(beside) or [NOTHING] * len(verdicts)
    return [RequirementRow.of(verdict, run, one) for verdict, one in zip(verdicts, more, strict=True)]


BRIEF = ("requirement", "value", "limit", "bound", "verdict")
"""Columns of `requirement_table` for the terminal and for a comparison of stages."""


def requirement_table(rows: Sequence[RequirementRow], several: bool = False) -> TextTable:
    """The table of requirements; `several`: with the run of each row."""
    beyond = "time beyond limit" if any(row.lower for row in rows) else "time above limit"
    heads = (*texts("run", "requirement", "verdict"), *numbers("value", "limit", "margin"))
    cells = [
        (
            row.run,
            row.label,
            Marked(row.verdict_text, row.css),
            row.value_text,
            row.limit_text,
            row.margin_text,
            row.bound_text,
            row.exceeding_text,
            row.effective_text,
        )
        for row in rows
    ]
    heads = (*heads, *texts("bound"), *numbers(beyond, "independent samples"))
    table = TextTable.of(heads, cells, "Requirements", name="requirements")
    return table if several else table.only(*table.heads[1:])


def verdict_table(rows: Sequence[RequirementRow], several: bool = False) -> TextTable:
    """One line for each group of requirements, those on one index: the worst of them, or the one with least margin."""
    groups: dict[tuple[str, str], list[RequirementRow]] = {}
    for row in rows:
        groups.setdefault((row.run, row.index), []).append(row)
    lines = []
    for (run, index), group in groups.items():
        worst = min(group, key=_rank)
        label = worst.label if len(group) == 1 else f"{index}, worst of {len(group)} requirements\n{worst.label}"
        verdict = Marked(worst.verdict_text, worst.css)
        lines.append((run, label, verdict, worst.value_text, worst.limit_text, worst.margin_text))
    heads = (*texts("run", "requirement", "verdict"), *numbers("value", "limit", "margin"))
    table = TextTable.of(heads, lines, "Verdict", name="verdict")
    return table if several else table.only(*table.heads[1:])


def _rank(row: RequirementRow) -> tuple[int, float]:
    margin = row.relative_margin
    return WORST_FIRST.index(row.shown), -math.inf if math.isnan(margin) else margin


def definition_table(rows: Sequence[RequirementRow]) -> TextTable:
    """Names of the requirements and their texts, each once."""
    definitions = dict.fromkeys((row.name or row.quantity, row.text) for row in rows)
    return TextTable.of(("requirement", "definition"), definitions, "Requirements as stated", name="definitions")
