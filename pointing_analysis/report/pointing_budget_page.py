"""HTML page of a pointing budget: margin, contributions and table for each requirement."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure

from pointing_analysis.budget.file import PointingBudget
from pointing_analysis.budget.total import PointingBudgetVerdict, axis_total
from pointing_analysis.formatting.number_text import digits, percent
from pointing_analysis.report.figures import COLOURS, LIMIT, Picture, legend_above, picture

TEMPLATE = Path(__file__).with_name("pointing_budget.html.j2")
BARS = 10
"""Largest sources that have a bar of their own."""
ROWS = 12
"""Rows of a table that are shown at once."""
DECADES = 5.0
"""Longest axis of the contributions."""


def vector(values: Sequence[float]) -> str:
    """Numbers of the axes for a table."""
    return ", ".join(digits(float(x), 4) for x in values)


def contributions(verdict: PointingBudgetVerdict, unit: str) -> Picture:
    """Level of each source alone at the required probability, the largest first, with the total and the limit.

    The axis is logarithmic, so that a source of a hundredth of the largest one still has a bar.
    """
    shares = sorted(verdict.shares, key=lambda s: -s.level)
    levels = [s.level for s in shares[:BARS]]
    names = [s.source.name for s in shares[:BARS]]
    if len(shares) > BARS:
        names.append(f"largest of {len(shares) - BARS} others")
        levels.append(shares[BARS].level)
    values = np.array([*levels, verdict.total])
    shown = values[values > 0.0]
    highest = max([*shown, verdict.limit])
    lowest = max(0.5 * min([*shown, verdict.limit]), 10.0**-DECADES * highest)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        y = np.arange(len(values))
        widths = np.maximum(values / lowest - 1.0, 0.0) * lowest
        axis.barh(y, widths, left=lowest, color=[COLOURS[0]] * len(names) + [COLOURS[1]])
        axis.set_xscale("log")
        axis.set_xlim(lowest, 3.0 * highest)
        for k, value in enumerate(values):
            number, place = digits(float(value), 4), (max(value, lowest), k)
            box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
            axis.annotate(number, place, xytext=(4, 0), textcoords="offset points", va="center", bbox=box)
        axis.axvline(verdict.limit, color=LIMIT, ls="--", label=f"limit {digits(verdict.limit, 4)}")
        axis.set_yticks(y, [*names, "total"])
        axis.invert_yaxis()
        level = f"{100 * verdict.requirement.probability:g} %"
        axis.set_xlabel(f"{level} level, each alone [{unit}]")
        legend_above(figure, axis)

    text = f"Level of each source alone; total {digits(verdict.total, 4)}, limit {digits(verdict.limit, 4)} {unit}"
    return picture("contributions", "Contributions", text, 1.4 + 0.24 * len(names), draw)


def render_budget(budget: PointingBudget, verdicts: Sequence[PointingBudgetVerdict]) -> str:
    """The page as HTML text; the same budget gives the same text."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    totals = []
    for rule in budget.totals:
        total = axis_total(budget, rule)
        name = f"{rule.index}, factor {rule.factor:g}"
        rows = [
            (label, [digits(x, 4) for x in values])
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


def _section(v: PointingBudgetVerdict, unit: str) -> dict[str, Any]:
    chart = contributions(v, unit)
    numbers = {key: digits(getattr(v, key), 4) for key in ("total", "limit", "margin", "level", "uncertainty", "rss")}
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
                "level": digits(s.level, 4),
                "share": percent(s.share),
            }
            for s in v.shares
        ],
    }
