"""Results of a budget as a table, in the four steps of ESSB-HB-E-003.

=======  =========================================  ===========================================================
step     of the handbook                            columns
=======  =========================================  ===========================================================
AST-1    characterisation of the error source       ``type``, ``random``: over time or over the ensemble
AST-2    transfer to the pointing error             ``error_mean_*``, ``error_sigma_*``: behind all transfers
AST-3    contribution to the index                  ``index_mean_*``, ``index_sigma_*``: for RPE within the window
AST-4    evaluation                                 ``level``: alone at the required probability; ``share``; totals
=======  =========================================  ===========================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from pointing_analysis.budget.file import PointingBudget
from pointing_analysis.budget.total import PointingBudgetVerdict

NO_MEMBERS: Mapping[str, tuple[str, float]] = MappingProxyType({})


def name_of(verdict: PointingBudgetVerdict) -> str:
    """Name of the requirement of a verdict, its text where it has none."""
    return verdict.requirement.name or str(verdict.requirement)


def result_rows(
    budget: PointingBudget,
    verdicts: Sequence[PointingBudgetVerdict],
    worst: Mapping[str, tuple[str, float]] = NO_MEMBERS,
) -> list[dict[str, str]]:
    """Rows of the results: each source of each requirement, then its totals.

    `worst` has, for the name of a requirement, the member of the family with the largest total, and that total.
    """
    rows = []
    for v in verdicts:
        common = {"requirement": name_of(v), "unit": budget.unit}
        for s in v.shares:
            source = s.source
            values = {
                "error_mean": source.mean,
                "error_sigma": source.sigma(None),
                "index_mean": s.mean,
                "index_sigma": s.sigma,
            }
            axes = {
                f"{key}_{axis}": f"{x:.9g}" for key, by_axis in values.items() for axis, x in zip(budget.axes, by_axis)
            }
            step_1 = {"source": source.name, "type": source.kind, "random": source.random}
            rows.append({**common, **step_1, **axes, "level": f"{s.level:.9g}", "share": f"{s.share:.9g}"})
        totals = {"total, distribution": v.level, "total, root sum of squares": v.rss}
        if name_of(v) in worst:
            member, total = worst[name_of(v)]
            totals[f"total, largest over members ({member})"] = total
        for name, value in {**totals, "limit": v.limit, "margin": v.margin}.items():
            rows.append({**common, "source": name, "type": "total", "level": f"{value:.9g}"})
    return rows
