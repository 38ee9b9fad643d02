"""How a campaign stands against the pointing requirements, in the three interpretations of ECSS-E-ST-60-10C.

=============  =====================================================================================================
ensemble       the worst instant of each member is one sample: so many members keep the limit at all times
temporal       each member keeps the limit for the share of its time; the worst member counts
mixed          all instants of all members together
=============  =====================================================================================================

Members are independent; bounds are Clopper and Pearson's (:mod:`pointing_analysis.indices.confidence`). The instants of
a member weigh as many as its autocorrelation leaves. A member that diverged is above every limit; one that failed for
another reason is left out and counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from pointing_analysis.indices.confidence import exceedance_lower, exceedance_upper, samples_needed
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from pointing_analysis.read.mapped_arrays import SortedValues
from pointing_analysis.requirements.summary import WINDOW
from pointing_analysis.requirements.text import Requirement
from titop_plant.telescope.requirements import window_probability

LOST = ("unstable", "diverged")
"""Statuses of members that are above every limit."""

INDICES = {"APE": ("ape", RAD_PER_ARCSEC, "arcsec"), "RPE": ("rpe_window", RAD_PER_MAS, "mas")}
"""Index to the stem of its columns, unit in radians, unit."""


@dataclass(frozen=True)
class CampaignVerdict:
    """One requirement in one interpretation.

    Parameters
    ----------
    requirement : str
    interpretation : {"ensemble", "temporal", "mixed"}
    status : {"compliant", "not compliant", "not enough data"}
    value, limit : float
        Quantile of the interpretation and limit.
    unit : str
    exceeding : float
        Share of the samples above the limit.
    lower, upper : float
        Bounds of the probability to exceed, each with the confidence of the requirement.
    samples, needed : int
        Independent samples, and those that would show compliance with the exceedances seen.
    text : str
        Requirement in full.
    """

    requirement: str
    interpretation: str
    status: str
    value: float
    limit: float
    unit: str
    exceeding: float
    lower: float
    upper: float
    samples: int
    needed: int
    text: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON; what is not finite is None."""
        return {
            name: (None if isinstance(value, float) and not math.isfinite(value) else value)
            for name, value in vars(self).items()
        }


def share_column(index: str, limit: float) -> str:
    """Column with the share of the samples of a member above a limit [rad]: ``rpe_window_above_40_mas``."""
    stem, scale, unit = INDICES[index]
    return f"{stem}_above_{limit / scale:g}_{unit}"


def quantile_column(requirement: Requirement) -> str:
    """Column with the quantile of a member that a requirement names: ``rpe_window_p997_mas``.

    Examples
    --------
    >>> from pointing_analysis.requirements.text import parse
    >>> quantile_column(parse("prob(|APE| < 1 arcsec) >= 95 % at 90 % confidence"))
    'ape_p95_arcsec'
    """
    stem, _, unit = INDICES[requirement.index]
    return f"{stem}_p{requirement.probability:.10g}_{unit}".replace("_p0.", "_p")


def judged(requirements: Sequence[Requirement], loop: str | None = None) -> tuple[Requirement, ...]:
    """Requirements that campaigns judge, of a stage or of all: on both axes of the APE, or of the RPE of windows."""
    return tuple(r for r in of_stage(requirements, loop) if _has_columns(r))


def not_judged(requirements: Sequence[Requirement], loop: str, depth: str = "time") -> tuple[Requirement, ...]:
    """Requirements of a stage on which a campaign has no verdict at a depth."""
    chosen = _of_model(requirements, loop) if depth == "model" else judged(requirements, loop)
    return tuple(r for r in of_stage(requirements, loop) if r not in chosen)


def of_stage(requirements: Sequence[Requirement], loop: str | None) -> tuple[Requirement, ...]:
    """Requirements that apply to a stage; all of them for None."""
    return tuple(r for r in requirements if loop is None or not r.loops or loop in r.loops)


def _has_columns(requirement: Requirement) -> bool:
    windows = requirement.of_windows and requirement.times == (WINDOW,)
    return requirement.index in INDICES and not requirement.axis and (requirement.index == "APE" or windows)


def _of_model(requirements: Sequence[Requirement], loop: str) -> tuple[Requirement, ...]:
    """Those that the depth model judges: its level of tone and noise is that of one probability."""
    probability = window_probability(requirements)
    return tuple(r for r in judged(requirements, loop) if r.index == "RPE" and r.probability == probability)


def verdicts(
    columns: dict[str, FloatArray], status: Sequence[str], loop: str, requirements: Sequence[Requirement]
) -> list[CampaignVerdict]:
    """Verdicts of a campaign of simulated runs.

    Parameters
    ----------
    columns : dict
        Metrics by name, shape (members,).
    status : sequence of str
    loop : str
        Stage, for the requirements that apply to it.
    requirements : sequence of Requirement
        Of the telescope.
    """
    lost = np.array([s in LOST for s in status])
    keep = lost | np.array([s == "ok" for s in status])
    found: list[CampaignVerdict] = []
    if not keep.any():
        return found
    for requirement in judged(requirements, loop):
        stem, scale, unit = INDICES[requirement.index]
        limit = requirement.limit / scale

        def column(name: str, instead: float) -> FloatArray:
            values = np.where(lost, instead, columns.get(name, np.full(len(lost), np.nan)))[keep]
            return np.asarray(values, dtype=float)

        worst, own = column(f"{stem}_max_{unit}", np.inf), column(quantile_column(requirement), np.inf)
        share = column(share_column(requirement.index, requirement.limit), 1.0)
        effective = np.maximum(column(f"{stem}_effective", 1.0), 1.0)
        pooled = float(np.average(share, weights=effective))
        common = (requirement, limit, unit)
        found += [
            _decided("ensemble", *common, int(np.sum(worst >= limit)), len(worst), _quantile(worst, requirement)),
            _temporal(requirement, limit, unit, own),
            _decided(
                "mixed",
                *common,
                math.ceil(pooled * effective.sum() - 1e-6),
                int(effective.sum()),
                _quantile(own, requirement, mean=True),
            ),
        ]
    return found


def model_verdicts(
    total: FloatArray, status: Sequence[str], loop: str, requirements: Sequence[Requirement]
) -> list[CampaignVerdict]:
    """Verdicts of a campaign at depth model: each member keeps the limit with its worst tone and its noise.

    Parameters
    ----------
    total : ndarray, shape (members,)
        What the required part of the windows keeps [mas].
    status, loop, requirements
        As in :func:`verdicts`.
    """
    lost = np.array([s in LOST for s in status])
    keep = lost | np.array([s == "ok" for s in status])
    if not keep.any():
        return []
    own = np.where(lost, np.inf, total)[keep]
    return [_temporal(r, r.limit / RAD_PER_MAS, "mas", own) for r in _of_model(requirements, loop)]


def _quantile(values: FloatArray, requirement: Requirement, mean: bool = False) -> float:
    if mean:
        return float(np.mean(values))
    return SortedValues(values).quantile(requirement.probability)


def _decided(
    interpretation: str, requirement: Requirement, limit: float, unit: str, above: int, samples: int, value: float
) -> CampaignVerdict:
    allowed = 1.0 - requirement.probability
    lower = exceedance_lower(above, samples, requirement.confidence)
    upper = exceedance_upper(above, samples, requirement.confidence)
    status = "compliant" if upper <= allowed else "not compliant" if lower > allowed else "not enough data"
    needed = samples_needed(requirement.probability, requirement.confidence, above)
    return CampaignVerdict(
        requirement.name,
        interpretation,
        status,
        value,
        limit,
        unit,
        above / samples,
        lower,
        upper,
        samples,
        needed,
        str(requirement),
    )


def _temporal(requirement: Requirement, limit: float, unit: str, own: FloatArray) -> CampaignVerdict:
    """Every member keeps the limit for its share of the time; bounds are those of the share of members that do not."""
    above, samples = int(np.sum(own >= limit)), len(own)
    lower, upper = (f(above, samples, requirement.confidence) for f in (exceedance_lower, exceedance_upper))
    status = "not compliant" if above else "compliant"
    worst = float(np.max(own))
    return CampaignVerdict(
        requirement.name,
        "temporal",
        status,
        worst,
        limit,
        unit,
        above / samples,
        lower,
        upper,
        samples,
        samples,
        str(requirement),
    )
