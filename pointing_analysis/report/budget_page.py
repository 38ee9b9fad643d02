"""HTML page of a pointing budget: margin, waterfall of the contributions and table for each requirement."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure

from pointing_analysis.budget.file import Budget
from pointing_analysis.budget.total import BudgetVerdict, axis_total
from pointing_analysis.report.figures import COLOURS, LIMIT, Picture, legend_above, picture

TEMPLATE = Path(__file__).with_name("budget.html.j2")
BARS = 10
"""Largest sources that have a bar of their own."""
ROWS = 12
"""Rows of a table that are shown at once."""
FAR = 4.0
"""Ratio of the limit to the total from which the axis ends before the limit."""


def digits(value: float) -> str:
    """Number for a table."""
    return f"{value:.4g}" if abs(value) < 9999.5 else f"{value:.0f}"


def vector(values: Sequence[float]) -> str:
    """Numbers of the axes for a table."""
    return ", ".join(digits(float(x)) for x in values)


def waterfall(verdict: BudgetVerdict, unit: str) -> Picture:
    """Root sum of squares, source by source, the largest first, with the total and the limit."""
    shares = sorted(verdict.shares, key=lambda s: -s.share)
    powers = [float(np.sum(s.sigma**2)) for s in shares]
    names = [s.source.name for s in shares[:BARS]]
    values = powers[:BARS]
    if len(shares) > BARS:
        names.append(f"{len(shares) - BARS} others")
        values.append(sum(powers[BARS:]))
    ends = np.sqrt(np.cumsum(values))
    starts = np.append(0.0, ends[:-1])

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        y = np.arange(len(names) + 1)
        widths = np.append(ends - starts, verdict.total)
        axis.barh(y, widths, left=np.append(starts, 0.0), color=[COLOURS[0]] * len(names) + [COLOURS[1]])
        largest = max(verdict.total, float(ends[-1]))
        beyond = verdict.limit > FAR * largest > 0
        name = f"limit {digits(verdict.limit)}" + (", beyond the axis" if beyond else "")
        axis.axvline(verdict.limit, color=LIMIT, ls="--", label=name)
        if beyond:
            axis.set_xlim(0.0, 1.2 * largest)
        axis.set_yticks(y, [*names, f"total at {100 * verdict.requirement.probability:g} %"])
        axis.invert_yaxis()
        axis.set_xlabel(f"rms with all sources above; total [{unit}]")
        legend_above(figure, axis)

    text = f"Waterfall of the contributions; total {digits(verdict.total)}, limit {digits(verdict.limit)} {unit}"
    return picture("waterfall", "Contributions", text, 1.4 + 0.24 * len(names), draw)


def render_budget(budget: Budget, verdicts: Sequence[BudgetVerdict]) -> str:
    """The page as HTML text; the same budget gives the same text."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    totals = []
    for rule in budget.totals:
        total = axis_total(budget, rule)
        name = f"{rule.index}, factor {rule.factor:g}"
        rows = [
            (label, [digits(x) for x in values])
            for label, values in zip(("root sum of squares", "mean", "level"), (total.rss, total.mean, total.level))
        ]
        totals.append({"name": name, "rows": rows})
    return environment.from_string(TEMPLATE.read_text("utf-8")).render(
        title=budget.title,
        unit=budget.unit,
        axes=budget.axes,
        verdicts=[_section(v, budget.unit) for v in verdicts],
        totals=totals,
        most=ROWS,
    )


def _section(v: BudgetVerdict, unit: str) -> dict[str, Any]:
    chart = waterfall(v, unit)
    numbers = {key: digits(getattr(v, key)) for key in ("total", "limit", "margin", "level", "uncertainty", "rss")}
    return {
        "name": v.requirement.name,
        "text": str(v.requirement),
        "css": "ok" if v.compliant else "bad",
        "status": "within the limit" if v.compliant else "above the limit",
        "chart": "data:image/svg+xml;base64," + base64.b64encode(chart.svg).decode(),
        "alt": chart.alt,
        **numbers,
        "rows": [
            {
                "name": s.source.name,
                "kind": s.source.kind,
                "mean": vector(s.mean.tolist()),
                "sigma": vector(s.sigma.tolist()),
                "level": digits(s.level),
                "share": f"{100 * s.share:.3g} %",
            }
            for s in v.shares
        ],
    }
