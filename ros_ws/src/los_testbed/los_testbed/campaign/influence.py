"""What decides about the metrics of a campaign: rank correlations, first-order indices, yield."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from lftkit.arrays import FloatArray
from los_testbed.campaign.sampling import COLUMNS
from pointing_analysis.indices.confidence import exceedance_upper

FEWEST, MOST_BINS = 8, 20
"""Fewest members for a correlation; most bins of a parameter's range."""

PER_BIN = 10


@dataclass(frozen=True)
class Influence:
    """Influence of one parameter on one metric.

    Parameters
    ----------
    parameter : str
    rank_correlation : float
        Spearman's; -1 to 1.
    first_order : float
        Share of the variance that the mean over this parameter explains (the first-order Sobol index, by bins with
        their own noise taken off); 0 to 1. NaN for few members.
    """

    parameter: str
    rank_correlation: float
    first_order: float


def influences(parameters: FloatArray, metric: FloatArray) -> list[Influence]:
    """Influence of each of `COLUMNS` (members, 7) on a metric (members,), the strongest first; none for few members."""
    known = np.isfinite(metric)
    x, y = parameters[known], metric[known]
    if len(y) < FEWEST or np.ptp(y) == 0.0:
        return []
    found = []
    for name, values in zip(COLUMNS, x.T):
        rank = float(stats.spearmanr(values, y).statistic) if np.ptp(values) > 0.0 else 0.0
        found.append(Influence(name, rank, first_order_index(values, y)))
    return sorted(found, key=lambda i: -max(abs(i.rank_correlation), 0.0 if np.isnan(i.first_order) else i.first_order))


def first_order_index(values: FloatArray, metric: FloatArray) -> float:
    """Variance of the means in equally filled bins over the whole variance, less what chance would make of it.

    Examples
    --------
    >>> x = np.random.default_rng(0).uniform(-1, 1, (4000, 2))
    >>> [round(first_order_index(column, x[:, 0] ** 2 + 0.0 * x[:, 1]), 2) for column in x.T]
    [0.99, 0.0]
    """
    bins = min(MOST_BINS, len(metric) // PER_BIN)
    if bins < 3:
        return float("nan")
    groups = np.array_split(metric[np.argsort(values, kind="stable")], bins)
    between = sum(len(g) * (g.mean() - metric.mean()) ** 2 for g in groups)
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups)
    if between + within == 0.0:
        return 0.0
    chance = (bins - 1) * within / (len(metric) - bins)
    return float(np.clip((between - chance) / (between + within), 0.0, 1.0))


def yield_curve(metric: FloatArray, levels: FloatArray, confidence: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """Share of the members below each level, and its lower bound.

    Parameters
    ----------
    metric : ndarray, shape (members,)
        Infinite for members that are lost.
    levels : ndarray, shape (k,)
    confidence : float
        Of the bound, one-sided.
    """
    ordered = np.sort(metric)
    below = np.searchsorted(ordered, levels, side="right")
    bound = [1.0 - exceedance_upper(int(len(metric) - k), len(metric), confidence) for k in below]
    return below / len(metric), np.array(bound)
