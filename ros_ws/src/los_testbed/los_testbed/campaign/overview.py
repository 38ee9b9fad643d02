"""Summary of a campaign: quantiles of each metric, failed members, the worst members with their commands."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.counted_nouns import counted
from los_testbed.campaign.campaign_verdict import LOST, CampaignVerdict, model_verdicts, not_judged, verdicts
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.influence import Influence, PairEffect, influences, pair_effects
from los_testbed.campaign.meanings import TOTAL, RequirementColumns, scenario_text
from los_testbed.campaign.reproduction import figure_text, member_command
from los_testbed.campaign.sampling import RANDOM
from pointing_analysis.formatting.number_text import digits, percent, with_unit
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from pointing_analysis.requirements.requirement import Requirement

QUANTILES = (0.5, 0.9, 0.99, 1.0)
PAIRS = 6
"""Pairs of parameters that are named."""


def campaign_summary(campaign: Campaign, folder: ResultFolder, worst: int = 5) -> dict[str, Any]:
    """Summary as a JSON object.

    Parameters
    ----------
    campaign : Campaign
    folder : ResultFolder
    worst : int
        Number of the worst members that are listed; a member that is unstable or diverged comes first.
    """
    table = folder.table()
    status = Counter(table.column("status").to_pylist())
    lower = {name for r in campaign.judged if r.lower for name in RequirementColumns.of(r, campaign.exposure).values}
    metrics = {name: _quantiles(table.column(name).to_numpy(), name in lower) for name in campaign.metrics}
    ranked = table.column(campaign.ranked).to_numpy()
    lost = np.array([s in LOST for s in table.column("status").to_pylist()])
    key = np.where(lost, np.inf, np.where(np.isnan(ranked), -np.inf, ranked))
    order = np.argsort(-key, kind="stable")[:worst]
    return {
        "output": str(folder.path),
        "depth": campaign.depth,
        "window_s": campaign.exposure,
        "members": table.num_rows,
        "samples": campaign.samples,
        "status": dict(sorted(status.items())),
        "metrics": metrics,
        "rows_hash": folder.rows_hash(),
        "ranked_by": campaign.ranked,
        "verdicts": [v.as_dict() for v in _verdicts(campaign, table)],
        "not_judged": [f"{requirement.exact_text}: {why}" for requirement, why in _not_judged(campaign).items()],
        "scenario": scenario_text(campaign.base.scenario or "", campaign.depth, campaign.sources),
        "pairs": [_shown({**vars(e), "known": e.known}) for e in _pairs(campaign, table)[:PAIRS]],
        "influence": [_shown({**vars(i), "known": i.known}) for i in _influences(campaign, table)],
        "worst": [_member(table.slice(int(k), 1).to_pylist()[0], campaign) for k in order],
    }


def _quantiles(values: FloatArray, lower: bool) -> dict[str, float | None]:
    """Number of members with a value and `QUANTILES` of them, of a column of a lower limit from the other end."""
    finite = values[np.isfinite(values)]
    wanted = [1.0 - q for q in QUANTILES] if lower else QUANTILES
    quantiles = {f"q{q:.3g}": float(f"{np.quantile(finite, q):.6g}") if finite.size else None for q in wanted}
    return {"members": int(finite.size), **quantiles}


def quantile_heads(summary: dict[str, Any]) -> tuple[str, ...]:
    """Headings of the quantiles of the metrics: of a lower limit those that so many members are above."""
    any_lower = any("q0" in quantiles for quantiles in summary["metrics"].values())
    return "median", "90 %", "99 %", "largest (smallest for lower limits)" if any_lower else "largest"


def _not_judged(campaign: Campaign) -> dict[Requirement, str]:
    return not_judged(campaign.requirements, campaign.base.loop, campaign.depth, campaign.refusals)


def _verdicts(campaign: Campaign, table: Any) -> list[CampaignVerdict]:
    status, random = table.column("status").to_pylist(), campaign.sampling in RANDOM
    if campaign.depth == "model":
        total = table.column(TOTAL).to_numpy()
        return model_verdicts(total, status, campaign.base.loop, campaign.requirements, random)
    columns = {name: table.column(name).to_numpy() for name in campaign.metrics}
    return verdicts(columns, status, campaign.base.loop, campaign.judged, random, campaign.exposure)


def _points(campaign: Campaign, table: Any) -> dict[str, FloatArray]:
    return {name: table.column(name).to_numpy() for name in campaign.parameters.columns}


def _influences(campaign: Campaign, table: Any) -> list[Influence]:
    return influences(_points(campaign, table), table.column(campaign.ranked).to_numpy())


def _pairs(campaign: Campaign, table: Any) -> list[PairEffect]:
    return pair_effects(_points(campaign, table), table.column(campaign.ranked).to_numpy())


def _shown(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()}


def verdict_table(summary: dict[str, Any]) -> TextTable:
    """Verdicts."""
    rows = []
    for v in summary["verdicts"]:
        value = "unbounded" if v["value"] is None else with_unit(digits(v["value"], 4), v["unit"])
        limit = f"{'above ' if v['lower_limit'] else ''}{digits(v['limit'], 4)}"
        bounds = "" if v["upper"] is None else f" ({digits(100 * v['lower'], 2)} to {digits(100 * v['upper'], 2)})"
        samples = f"{v['samples']}" + (f", {v['undecided']} undecided" if v["undecided"] else "")
        beyond = f"{percent(v['exceeding'])}{bounds}"
        rows.append((v["requirement"], v["interpretation"], v["status"], value, limit, beyond, samples))
    heads = (*texts("requirement", "interpretation", "verdict"), *numbers("quantile", "limit", "beyond", "samples"))
    return TextTable.of(heads, rows, "Requirements (ECSS-E-ST-60-10C)")


def _member(row: dict[str, Any], campaign: Campaign) -> dict[str, Any]:
    value = row[campaign.ranked]
    return {
        "index": row["index"],
        "status": row["status"],
        "value": float(f"{value:.6g}") if np.isfinite(value) else None,
        "figure": figure_text(row, campaign.ranked, campaign.depth),
        "command": member_command(row, campaign.base, campaign.depth),
    }


def worst_lines(summary: dict[str, Any]) -> list[str]:
    """Lines for the screen: figure of each of the worst members and the command that gives it."""
    return [f"{summary['ranked_by']} {member['figure']}: {member['command']}" for member in summary["worst"]]


def metric_table(summary: dict[str, Any]) -> TextTable:
    """Quantiles of each metric."""
    counts = ", ".join(f"{count} {status}" for status, count in summary["status"].items())
    title = f"{summary['members']} of {counted(summary['samples'], 'member')}, depth {summary['depth']}: {counts}"
    rows = [
        (name, *(digits(value, 4) for key, value in quantiles.items() if key != "members"))
        for name, quantiles in summary["metrics"].items()
    ]
    return TextTable.of((*texts("metric"), *numbers(*quantile_heads(summary))), rows, title)
