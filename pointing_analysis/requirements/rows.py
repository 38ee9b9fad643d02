"""Rows of the table of requirements: what the screen, the page, Markdown and JSON say of a verdict.

Each output is made of the same rows, so that none of them can say what another does not.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pointing_analysis.requirements.guarantee import ProvenBound
from pointing_analysis.requirements.verdict import Status, Verdict
from pointing_analysis.rounding import at_most
from pointing_analysis.units import ANGLES

KEEPS = "within limits"
"""Shown for a run that keeps a limit and is too short to prove it."""
DISTURBED = "disturbed"
"""Shown for a run in real time in which more ticks were missed than may be."""
ABSENT = "–"
ALL_RUNS = "all runs"


def digits(value: float, places: int = 3) -> str:
    """Number for a table: a few significant digits, a dash where there is none."""
    if math.isnan(value):
        return ABSENT
    if math.isinf(value):
        return "no bound yet"
    whole = 1000.0 - 0.5 * 10.0 ** (3 - places)  # what would be rounded to 1e+03
    return f"{value:.0f}" if abs(value) >= whole else f"{value:.{places}g}"


def digits_beside(value: float, limit: float) -> str:
    """As :func:`digits`, with as many more as show on which side of the limit the value is.

    Examples
    --------
    >>> [digits_beside(value, 40.0) for value in (41.23, 40.0026, 39.9996, 40.0)]
    ['41.2', '40.003', '39.9996', '40']
    """
    if math.isinf(value):
        return f"{value:g}"
    if math.isnan(value) or value == limit:
        return digits(value)
    texts = (digits(value, places) for places in range(3, 17))
    return next((text for text in texts if (float(text) - limit) * (value - limit) > 0.0), repr(value))


def number(value: float) -> float | None:
    """Six digits for JSON; infinities and NaN become None."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def css_class(status: str) -> str:
    """Class of a status: its colour on the page."""
    return {"compliant": "ok", KEEPS: "ok", "not compliant": "bad"}.get(status, "open")


def shown_status(v: Verdict) -> str:
    """Status; of too short a run that exceeds its limit no more often than allowed: that it keeps it."""
    return KEEPS if v.status == "not enough data" and v.keeps else v.status


def overall(verdicts: Sequence[Verdict], disturbed: str = "") -> str:
    """One word for several verdicts: the worst of them, or that the run was `disturbed`."""
    if disturbed and verdicts:
        return DISTURBED
    found = {shown_status(v) for v in verdicts}
    for status in ("not compliant", "not enough data", "not judged", KEEPS):
        if status in found:
            return status
    return "compliant" if found else "not judged"


@dataclass(frozen=True)
class Beside:
    """What else is known of a requirement in a run.

    Attributes
    ----------
    proven : bound that is proven for the loop and the tones that act, or stated to be; None where none is
    unproven : what is said where the run is too short for a bound and none is proven
    disturbed : why the verdict is not of the loop alone; empty where it is
    """

    proven: ProvenBound | None = None
    unproven: str = "none: too short a record"
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
    shown : status, or that the run keeps the limit where it is too short to prove it
    statement : verdict in words
    remark : what length of run would decide, what is missing, or why it was not judged
    exceeding : share of the samples above the limit, or below a lower one
    samples, effective : samples, and independent ones that they weigh as much as
    seconds_needed : length of data that would decide [s]
    missing : samples that are missing
    note : of the verdict
    lower : whether the limit is a lower one
    beside : what else is known of it
    named : whether other requirements of the table are on the same quantity, so that the name tells them apart
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
    remark: str
    exceeding: float
    samples: int
    effective: float
    seconds_needed: float
    missing: float
    note: str
    lower: bool = False
    beside: Beside = NOTHING
    named: bool = False

    @classmethod
    def of(cls, verdict: Verdict, run: str = "", beside: Beside = NOTHING, named: bool = False) -> RequirementRow:
        """Row of a verdict."""
        r, scale = verdict.requirement, verdict.requirement.scale
        judged = verdict.status != "not judged"
        disturbed = f"{DISTURBED}: {beside.disturbed}; " if beside.disturbed else ""
        tail = "" if r.interpretation == "temporal" else f", {r.interpretation}"
        return cls(
            run=run,
            name=r.name,
            text=str(r),
            quantity=f"{r.quantity}, {100 * r.probability:g} %{tail}",
            unit=r.unit,
            value=verdict.quantile.value / scale if judged else math.nan,
            limit=r.limit / scale,
            bound=(verdict.quantile.lower if r.lower else verdict.quantile.upper) / scale if judged else math.nan,
            confidence=r.confidence,
            status=verdict.status,
            shown=DISTURBED if beside.disturbed else shown_status(verdict),
            statement=f"{disturbed}{verdict.statement}",
            remark=_remark(verdict),
            exceeding=verdict.exceeding,
            samples=verdict.samples,
            effective=verdict.effective,
            seconds_needed=verdict.seconds_needed,
            missing=verdict.missing,
            note=verdict.note,
            lower=r.lower,
            beside=beside,
            named=named,
        )

    @property
    def label(self) -> str:
        """Judged quantity, behind the name where others are on the same one."""
        return f"{self.name}: {self.quantity}" if self.named and self.name else self.quantity

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
        """Limit with its unit; a lower one says so."""
        return with_unit(f"{'above ' if self.lower else ''}{self.limit:g}", self.unit)

    @property
    def bound_text(self) -> str:
        """Bound of the quantile with its unit and its confidence; of a lower limit the lower one, which says so.

        Where the record shows none, the bound that is proven for the loop, or that there is none.
        """
        if math.isnan(self.bound):
            return ABSENT
        if math.isinf(self.bound):
            proven = self.beside.proven
            return self.beside.unproven if proven is None else proven.text(self._scale, self.unit)
        bound = with_unit(f"{'above ' if self.lower else ''}{digits_beside(self.bound, self.limit)}", self.unit)
        return f"{bound} at {100 * self.confidence:g} %"

    @property
    def exceeding_text(self) -> str:
        """Share of the samples above the limit."""
        return ABSENT if math.isnan(self.exceeding) else f"{100 * self.exceeding:.3g} %"

    @property
    def effective_text(self) -> str:
        """Independent samples of all."""
        return f"{digits(self.effective)} of {digits(self.samples, 6)}"

    @property
    def verdict_text(self) -> str:
        """Verdict in words, with the reason where there is none."""
        return f"{self.statement}: {self.note}" if self.status == "not judged" and self.note else self.statement

    @property
    def margin_text(self) -> str:
        """Distance to the limit, also in % of it, positive where it is kept; empty where it was not judged."""
        if math.isnan(self.value):
            return ""
        margin = self._margin
        sign = "+" if margin >= 0 else "−"
        return f"margin {sign}{with_unit(digits(abs(margin)), self.unit)} ({abs(100 * margin / self.limit):.0f} %)"

    @property
    def margin_css(self) -> str:
        """Class of the margin: its colour on the page."""
        return "open" if math.isnan(self.value) else "ok" if self._margin >= 0 else "bad"

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
        """Proven bound for JSON, rounded up; one that the bag states and nobody checked has another name."""
        proven = self.beside.proven
        if proven is None:
            return {}
        value = float(at_most(proven.value / self._scale, 6))
        kind = "proven" if proven.checked else "stated"
        condition = {f"{kind}_without": proven.condition} if proven.condition else {}
        return {f"{kind}_bound": value, f"{kind}_probability": proven.probability, **condition}


def rows_of(verdicts: Sequence[Verdict], beside: Sequence[Beside], run: str = "") -> list[RequirementRow]:
    """Rows of the verdicts on one run; no two of them have the same label unless their names are the same."""
    more = list(beside) or [NOTHING] * len(verdicts)
    rows = [RequirementRow.of(verdict, run, one) for verdict, one in zip(verdicts, more, strict=True)]
    count = Counter(row.quantity for row in rows)
    return [replace(row, named=count[row.quantity] > 1) for row in rows]


def _remark(v: Verdict) -> str:
    """What length of run would decide, and the note of the verdict."""
    needed = ""
    if v.status == "not enough data":
        needed = (
            "no length of run decides it"
            if math.isinf(v.seconds_needed)
            else f"not yet demonstrated: needs {math.ceil(v.seconds_needed)} s"
        )
    return ". ".join(part for part in (needed, v.note) if part)


def with_unit(text: str, unit: str) -> str:
    """A number with its unit, alone where it has none."""
    return f"{text} {unit}" if unit else text


HEADS = ("requirement", "value", "limit", "bound", "verdict")
"""Headings of `cells`."""


def cells(row: RequirementRow) -> tuple[str, str, str, str, str]:
    """A row as texts for a table of the screen or of Markdown, under `HEADS`."""
    return row.label, row.value_text, row.limit_text, row.bound_text, row.verdict_text
