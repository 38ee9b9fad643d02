r"""Totals of a pointing budget: contribution of each source, total at the required probability, margin.

Two summations. ``distribution``: the error is drawn from all sources together and its quantile is read off; its
statistical uncertainty is stated. ``rss``: the standard deviations add in the root sum of squares and the level of an
axis is :math:`|\sum\mu| + n_P \sqrt{\sum\sigma^2}` with the :math:`n_P` of a Gaussian distribution; the norm of two
axes is that of two independent Gaussian ones.

The interpretation of the requirement decides what is drawn. ``temporal``: sources that vary over the ensemble have
their largest value (where a distribution has no bound, :math:`n_P` standard deviations) with one sign for all of the
time; the largest quantile over the signs of the axes counts. ``ensemble``: those that vary in time have their largest
value, which at some instant adds to whatever the others are. ``mixed``: all are drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import integrate, optimize, special

from pointing_analysis.arrays import FloatArray
from pointing_analysis.budget.file import PointingBudget, TotalRule
from pointing_analysis.budget.lines import Total, combine, contribution
from pointing_analysis.budget.sources import ENSEMBLE, TIME, ErrorSource
from pointing_analysis.indices import confidence
from pointing_analysis.requirements.requirement import Requirement
from pointing_analysis.units import ANGLES

BLOCK = 100_000


@dataclass(frozen=True)
class Share:
    """Contribution of one source to an index.

    Attributes
    ----------
    source : the source
    mean, sigma : (k,)
    level : quantile of this source alone at the required probability
    share : part of the sum of the variances of the judged axes (0 to 1)
    """

    source: ErrorSource
    mean: FloatArray
    sigma: FloatArray
    level: float
    share: float


@dataclass(frozen=True)
class PointingBudgetVerdict:
    """A requirement against the budget; lengths in the unit of the budget.

    Attributes
    ----------
    requirement : the requirement
    limit : its limit
    shares : contributions, largest first
    rss : level by the root sum of squares
    level : level by the distribution
    uncertainty : half width of the 95 % interval of `level` due to the number of draws
    total : the one of both that counts
    margin : limit less total
    """

    requirement: Requirement
    limit: float
    shares: tuple[Share, ...]
    rss: float
    level: float
    uncertainty: float
    total: float
    margin: float

    @property
    def compliant(self) -> bool:
        """Whether the total is below the limit."""
        return self.margin > 0


def axis_factor(probability: float) -> float:
    """Standard deviations within which a Gaussian error stays with a probability.

    Examples
    --------
    >>> round(axis_factor(0.997), 5)
    2.96774
    """
    return math.sqrt(2) * float(special.erfinv(probability))


def norm_quantile(mean: FloatArray, sigma: FloatArray, probability: float) -> float:
    """Quantile of the norm of two independent Gaussian errors.

    Examples
    --------
    >>> round(norm_quantile(np.zeros(2), np.ones(2), 0.997), 5)
    3.40856
    """
    m, s = np.abs(np.asarray(mean, dtype=float)), np.asarray(sigma, dtype=float)
    order = np.argsort(s)
    (small, large), (m_small, m_large) = s[order], m[order]
    if large == 0:
        return float(np.hypot(*m))
    top = float(np.hypot(*m) + 12 * large)
    if small < 1e-9 * large:
        small = 1e-9 * large

    def inside(radius: float) -> float:
        def slice_at(x: float) -> float:
            half = math.sqrt(max(radius**2 - (m_large + x * large) ** 2, 0.0))
            a, b = (half - m_small) / small, (-half - m_small) / small
            return math.exp(-x * x / 2) * float(special.ndtr(a) - special.ndtr(b)) / math.sqrt(2 * math.pi)

        low, high = max((-radius - m_large) / large, -12.0), min((radius - m_large) / large, 12.0)
        return float(integrate.quad(slice_at, low, high, limit=200)[0]) if high > low else 0.0

    return float(optimize.brentq(lambda radius: inside(radius) - probability, 1e-12 * top, top, xtol=1e-12 * top))


def evaluate(budget: PointingBudget) -> tuple[PointingBudgetVerdict, ...]:
    """Every requirement of a budget against its total."""
    return tuple(_evaluate(budget, requirement) for requirement in budget.requirements)


def _worst(requirement: Requirement) -> str:
    """Sources at their largest value: those that vary over the ensemble, in time, or none."""
    return {"temporal": ENSEMBLE, "ensemble": TIME, "mixed": ""}[requirement.interpretation]


def _largest(source: ErrorSource, window: float | None, factor: float) -> FloatArray:
    bound = source.worst(window)
    return np.where(np.isfinite(bound), bound, factor * source.sigma(window))


def _draw(sources: list[ErrorSource], budget: PointingBudget, window: float | None, k: int) -> FloatArray:
    """Errors (draws, k) of some sources together, means left out."""
    rng, parts = np.random.default_rng(budget.seed), []
    for start in range(0, budget.draws, BLOCK):
        u = rng.random(min(BLOCK, budget.draws - start))
        total = np.zeros((u.size, k))
        for source in sources:
            total += source.draw(rng, u, window)
        parts.append(total)
    return np.concatenate(parts)


def _evaluate(budget: PointingBudget, requirement: Requirement) -> PointingBudgetVerdict:
    window = requirement.times[0] if requirement.times else None
    axes = [budget.axes.index(requirement.axis)] if requirement.axis else [0, 1]
    p, factor = requirement.probability, axis_factor(requirement.probability)
    fixed = [s for s in budget.sources if s.random == _worst(requirement)]
    drawn = [s for s in budget.sources if s.random != _worst(requirement)]
    means = {s.path: s.mean if window is None else np.zeros_like(s.mean) for s in budget.sources}
    none = np.zeros(len(budget.axes))
    offset = sum((means[s.path] for s in budget.sources), none)
    largest = sum((_largest(s, window, factor) for s in fixed), none)

    error = (_draw(drawn, budget, window, len(budget.axes)) + offset)[:, axes]
    if requirement.interpretation == "temporal":
        corners = product(*((one, -one) if one else (0.0,) for one in largest[axes].tolist()))
        sizes = [np.sqrt(np.square(error + corner).sum(axis=1)) for corner in corners]
    else:
        sizes = [np.sqrt(np.square(np.abs(error) + largest[axes]).sum(axis=1))]
    quantiles = (confidence.quantile(size, p, 0.975, effective=size.size) for size in sizes)
    worst_axis = max(quantiles, key=lambda quantile: quantile.value)
    sigma = np.sqrt(sum((s.sigma(window) ** 2 for s in drawn), none))
    reach = (np.abs(offset) + largest)[axes]
    rss = float(reach[0] + factor * sigma[axes[0]]) if len(axes) == 1 else norm_quantile(reach, sigma, p)
    total = worst_axis.value if budget.summation == "distribution" else rss
    limit = requirement.limit / ANGLES[budget.unit]
    rows = []
    for source in budget.sources:
        mean, deviation = means[source.path], source.sigma(window)
        if source in drawn:
            alone = _draw([source], budget, window, len(budget.axes)) + mean
            size = np.hypot(*alone[:, axes].T) if len(axes) == 2 else np.abs(alone[:, axes[0]])
            level = float(np.quantile(size, p))
        else:
            level = float(np.sqrt(np.sum((np.abs(mean) + _largest(source, window, factor))[axes] ** 2)))
        rows.append((source, mean, deviation, level, float(np.sum(deviation[axes] ** 2))))
    whole = math.fsum(row[4] for row in rows) or 1.0
    shares = [Share(s, m, d, level, power / whole) for s, m, d, level, power in rows]
    shares.sort(key=lambda share: (-share.level, share.source.path))
    level, margin = worst_axis.value, limit - total
    uncertainty = max(worst_axis.upper - level, level - worst_axis.lower)
    return PointingBudgetVerdict(requirement, limit, tuple(shares), rss, level, uncertainty, total, margin)


def axis_total(budget: PointingBudget, rule: TotalRule) -> Total:
    """Total of each axis by the rule of ECSS-E-ST-60-10C: mean plus a number of standard deviations."""
    means = [np.zeros_like(s.mean) if rule.window is not None else s.mean for s in budget.sources]
    parts = [contribution(s.name, s.sigma(rule.window), mean=m) for s, m in zip(budget.sources, means)]
    return combine(parts, "APE", rule.factor)


def as_dict(budget: PointingBudget, verdicts: tuple[PointingBudgetVerdict, ...]) -> dict[str, object]:
    """Budget and verdicts for JSON."""
    return {
        "title": budget.title,
        "unit": budget.unit,
        "summation": budget.summation,
        "requirements": [
            {
                "text": str(v.requirement),
                "limit": v.limit,
                "total": v.total,
                "margin": v.margin,
                "compliant": v.compliant,
                "distribution": v.level,
                "uncertainty": v.uncertainty if math.isfinite(v.uncertainty) else None,
                "rss": v.rss,
                "sources": [
                    {
                        "name": s.source.name,
                        "type": s.source.kind,
                        "mean": s.mean.tolist(),
                        "sigma": s.sigma.tolist(),
                        "level": s.level,
                        "share": s.share,
                    }
                    for s in v.shares
                ],
            }
            for v in verdicts
        ],
        "totals": [
            {"index": rule.index, "factor": rule.factor, "rss": total.rss.tolist(), "level": total.level.tolist()}
            for rule in budget.totals
            for total in (axis_total(budget, rule),)
        ],
    }
