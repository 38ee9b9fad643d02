"""Verdicts of a campaign on the pointing requirements, in the three interpretations of ECSS-E-ST-60-10C.

=============  =====================================================================================================
ensemble       the worst instant of each member is one sample: so many members are within the limit at all times
temporal       each member is within the limit for the share of its time; one proven not to be is the verdict
mixed          all instants of all members together
=============  =====================================================================================================

The worst instant, the quantile and the share above a limit are columns of the data set
(:class:`los_testbed.campaign.meanings.RequirementColumns`); an index with one value for each window or exposure has
those in place of instants. Under a lower limit the worst is the smallest, and what is below the limit counts.

**Confidence.** Members are independent; bounds are Clopper and Pearson's (:mod:`pointing_analysis.indices.confidence`).
The instants of a member count as its effective samples (:mod:`pointing_analysis.indices.exceedances`), those of all
together as at most one for each member: what differs between telescopes is seen as often as there are members. A
temporal verdict has two steps, each at the
confidence of the requirement: on each member from its run, and on all telescopes from the members. A member counts as
compliant only if its own run proves it. Members that are not random draws have no bounds, and all of them must be
proven. A member that diverged, or whose metric is not known, exceeds every limit; one that failed for another reason is
excluded and counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.campaign.meanings import RequirementColumns, column_unit
from pointing_analysis.image.optics import Optics
from pointing_analysis.indices.confidence import exceedance_lower, exceedance_upper, samples_needed
from pointing_analysis.indices.exceedances import pooled_number
from pointing_analysis.read.mapped_arrays import SortedValues
from pointing_analysis.requirements.exposure import USUAL, exposure_of
from pointing_analysis.requirements.requirement import Requirement, time_text
from pointing_analysis.requirements.verdict import refusal, status_of
from titop_plant.interface import DT
from titop_plant.telescope.requirements import window_length, window_probability

LOST = ("unstable", "diverged")
"""Statuses of members that are beyond every limit."""

PRE = "the PRE compares several runs, a campaign has one per member"
"""Why there is no verdict on the PRE."""


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
        Share of the samples above the limit, or below a lower one.
    lower, upper : float
        Bounds of the probability to exceed, each with the confidence of the requirement; NaN where there are none.
    samples, needed : int
        Independent samples, and those that would show compliance with the exceedances seen.
    undecided : int
        Members whose own runs are too short for a verdict on them.
    column : str
        Of the data set, that the limit is for.
    text : str
        Requirement in full.
    lower_limit : bool
        Whether the limit is a lower one.
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
    lower_limit: bool = False
    undecided: int = 0
    column: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON; what is not finite is None."""
        return {
            name: (None if isinstance(value, float) and not math.isfinite(value) else value)
            for name, value in vars(self).items()
        }


def judged(requirements: Sequence[Requirement], loop: str | None = None) -> tuple[Requirement, ...]:
    """Requirements that campaigns of simulated runs judge, of a stage or of all: those on single runs."""
    return tuple(r for r in of_stage(requirements, loop) if r.index != "PRE")


def refused(requirements: Sequence[Requirement], ticks: int, optics: Optics | None) -> dict[Requirement, str]:
    """Requirements whose index the run of a member cannot have, and why.

    Parameters
    ----------
    requirements : sequence of Requirement
    ticks : int
        Of the run of each member, without its start-up.
    optics : Optics or None
        Of the telescope.
    """
    reasons = {r: PRE if r.index == "PRE" else refusal(r, ticks, DT, optics) for r in requirements}
    return {r: why for r, why in reasons.items() if why}


def not_judged(
    requirements: Sequence[Requirement],
    loop: str,
    depth: str = "time",
    refusals: Mapping[Requirement, str] | None = None,
) -> dict[Requirement, str]:
    """Requirements of a stage on which a campaign has no verdict at a depth, and why.

    Parameters
    ----------
    requirements : sequence of Requirement
        Of the telescope.
    loop : str
        Stage.
    depth : {"time", "model"}
    refusals : mapping, optional
        Of :func:`refused`, at depth time.
    """
    of_loop = of_stage(requirements, loop)
    if depth == "model":
        part = f"{100.0 * window_probability(requirements):.10g} % of the windows"
        window = time_text(window_length(requirements))
        known = f"depth model has rms RPE({window}) only, of {part} with the worst tone and the noise"
        chosen = _of_model(requirements, loop)
        return {r: known for r in of_loop if r not in chosen}
    reasons = {**{r: PRE for r in of_loop if r.index == "PRE"}, **(refusals or {})}
    return {r: reasons[r] for r in of_loop if r in reasons}


def of_stage(requirements: Sequence[Requirement], loop: str | None) -> tuple[Requirement, ...]:
    """Requirements that apply to a stage; all of them for None."""
    return tuple(r for r in requirements if loop is None or not r.loops or loop in r.loops)


def _of_model(requirements: Sequence[Requirement], loop: str) -> tuple[Requirement, ...]:
    """Those that the depth model judges: its level of tone and noise is that of one window and probability."""
    probability, window = window_probability(requirements), window_length(requirements)
    windows = [r for r in judged(requirements, loop) if r.index == "RPE" and r.of_windows and r.times == (window,)]
    return tuple(r for r in windows if not r.axis and r.probability == probability)


def verdicts(
    columns: dict[str, FloatArray],
    status: Sequence[str],
    loop: str,
    requirements: Sequence[Requirement],
    random: bool = True,
    exposure: float = USUAL,
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
    random : bool
        Whether the members are random draws. Of others there is the temporal verdict only.
    exposure : float
        Of the telescope [s], for the names of the columns.
    """
    lost = np.array([s in LOST for s in status])
    keep = lost | np.array([s == "ok" for s in status])
    rows: list[CampaignVerdict] = []
    if not keep.any():
        return rows
    for requirement in judged(requirements, loop):
        named = RequirementColumns.of(requirement, exposure)
        beyond = -np.inf if named.lower else np.inf

        def column(name: str, instead: float) -> FloatArray:
            values = np.asarray(columns.get(name, np.full(len(lost), np.nan)), dtype=float)
            return np.asarray(np.where(lost | np.isnan(values), instead, values)[keep])

        worst, quantiles, share = column(named.worst, beyond), column(named.quantile, beyond), column(named.share, 1.0)
        effective, unseen = np.maximum(column(named.effective, 1.0), 1.0), column(named.unseen, 1.0)
        own_status = [
            "not compliant" if gone else status_of(requirement, s + more, s, n, len(share))
            for gone, s, more, n in zip(lost[keep].tolist(), share.tolist(), unseen.tolist(), effective.tolist())
        ]
        temporal = replace(_temporal(requirement, quantiles, own_status, random), column=named.quantile)
        if not random:
            rows.append(temporal)
            continue
        together = pooled_number(effective, np.ones(len(share)))
        total = int(together + 1e-6)
        above = min(math.ceil(float(np.mean(share)) * together - 1e-6), total)
        # Quantile of the values at the required probability
        sign = -1.0 if requirement.lower else 1.0
        of_all = sign * SortedValues(sign * worst).quantile(requirement.probability)
        ensemble = _decided("ensemble", requirement, _above(worst, requirement), len(worst), of_all)
        mixed = _decided("mixed", requirement, above, total, float(np.mean(quantiles)))
        rows += [replace(verdict, column=named.quantile) for verdict in (ensemble, temporal, mixed)]
    return rows


def model_verdicts(
    total: FloatArray,
    status: Sequence[str],
    loop: str,
    requirements: Sequence[Requirement],
    random: bool = True,
) -> list[CampaignVerdict]:
    """Verdicts of a campaign at depth model: each member is within the limit with its worst tone and its noise.

    Parameters
    ----------
    total : ndarray, shape (members,)
        Quantile of the windows at the required probability [mas].
    status, loop, requirements, random
        As in :func:`verdicts`.
    """
    lost = np.array([s in LOST for s in status])
    keep = lost | np.array([s == "ok" for s in status])
    if not keep.any():
        return []
    totals, exposure = np.where(lost, np.inf, total)[keep], exposure_of(requirements)
    return [
        replace(_temporal(r, totals, _known(totals, r), random), column=RequirementColumns.of(r, exposure).quantile)
        for r in _of_model(requirements, loop)
    ]


def _known(values: FloatArray, requirement: Requirement) -> list[str]:
    """Statuses of members whose quantiles are computed, not estimated."""
    return ["not compliant" if _above(values[k : k + 1], requirement) else "compliant" for k in range(len(values))]


def _above(values: FloatArray, requirement: Requirement) -> int:
    """Number of values, in the unit of the columns, above the limit."""
    limit = requirement.limit / column_unit(requirement)[1]
    return int(np.sum(values <= limit if requirement.lower else values >= limit))


def _decided(interpretation: str, requirement: Requirement, above: int, samples: int, value: float) -> CampaignVerdict:
    allowed = 1.0 - requirement.probability
    lower = exceedance_lower(above, samples, requirement.confidence)
    upper = exceedance_upper(above, samples, requirement.confidence)
    status = "compliant" if upper <= allowed else "not compliant" if lower > allowed else "not enough data"
    needed = samples_needed(requirement.probability, requirement.confidence, above)
    return _verdict(requirement, interpretation, status, value, above, samples, needed)


def _temporal(requirement: Requirement, values: FloatArray, status: Sequence[str], random: bool) -> CampaignVerdict:
    """Every member is within the limit for its share of the time; `status` is that of each member alone.

    Bounds are those of the share of telescopes that exceed it. A member that exceeds the limit passes for one within
    it with probability 1 - c at most: of those that exceed it a part c at least is not proven.
    """
    above, samples, c = _above(values, requirement), len(values), requirement.confidence
    worst = float(np.min(values) if requirement.lower else np.max(values))
    unproven, refuted = sum(s != "compliant" for s in status), sum(s == "not compliant" for s in status)
    undecided = unproven - refuted
    allowed = 1.0 - requirement.probability
    upper = exceedance_upper(unproven, samples, c) if random else math.nan
    lower = exceedance_lower(refuted, samples, c) if random else math.nan
    proven = upper <= allowed if random else not unproven
    decided = "not compliant" if refuted else "compliant" if proven else "not enough data"
    needed = samples_needed(requirement.probability, c, refuted) if random else samples
    verdict = _verdict(requirement, "temporal", decided, worst, above, samples, needed)
    return replace(verdict, lower=lower, upper=upper, undecided=undecided)


def _verdict(
    requirement: Requirement, interpretation: str, status: str, value: float, above: int, samples: int, needed: int
) -> CampaignVerdict:
    unit, scale = column_unit(requirement)
    return CampaignVerdict(
        requirement=requirement.name,
        interpretation=interpretation,
        status=status,
        value=value,
        limit=requirement.limit / scale,
        unit=unit,
        exceeding=above / samples,
        lower=exceedance_lower(above, samples, requirement.confidence),
        upper=exceedance_upper(above, samples, requirement.confidence),
        samples=samples,
        needed=needed,
        text=str(requirement),
        lower_limit=requirement.lower,
    )
