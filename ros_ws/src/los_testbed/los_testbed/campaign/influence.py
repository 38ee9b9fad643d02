"""Sensitivity of the metrics of a campaign: rank correlations, main and pair effects, yield."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from pointing_analysis.indices.confidence import exceedance_upper

FEWEST, MOST_BINS = 8, 20
"""Fewest members for a correlation; most bins of a parameter's range."""

PER_BIN = 10
MOST_CELLS = 8
"""Most bins of each parameter of a pair."""


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


def influences(parameters: Mapping[str, FloatArray], metric: FloatArray) -> list[Influence]:
    """Influence of each parameter (members,) on a metric (members,), the strongest first; none for few members."""
    from scipy import stats  # a large import, which members need not wait for

    known = np.isfinite(metric)
    y = metric[known]
    if len(y) < FEWEST or np.ptp(y) == 0.0:
        return []

    found = []
    for name, column in parameters.items():
        values = column[known]
        rank = float(stats.spearmanr(values, y).statistic) if np.ptp(values) > 0.0 else 0.0
        found.append(Influence(name, rank, first_order_index(values, y)))
    return sorted(found, key=lambda i: -max(abs(i.rank_correlation), 0.0 if np.isnan(i.first_order) else i.first_order))


def first_order_index(values: FloatArray, metric: FloatArray) -> float:
    """Variance of the means in bins of the values (:func:`bins_of`) over the total variance, minus the chance level.

    Examples
    --------
    >>> x = np.random.default_rng(0).uniform(-1, 1, (4000, 2))
    >>> [round(first_order_index(column, x[:, 0] ** 2 + 0.0 * x[:, 1]), 2) for column in x.T]
    [0.99, 0.0]
    """
    bins = min(MOST_BINS, len(metric) // PER_BIN)
    if bins < 3:
        return float("nan")
    if np.ptp(metric) == 0.0:
        return 0.0
    return float(np.clip(_share(bins_of(values, bins), metric), 0.0, 1.0))


def bins_of(values: FloatArray, bins: int) -> IntArray:
    """Bin of each value, numbered from 0: one for each distinct value where these are no more than `bins`.

    More are put into at most `bins` bins, filled as equally as possible: **equal values are in one bin**.

    Examples
    --------
    >>> bins_of(np.array([3.0, 1.0, 3.0, 1.0]), 20), bins_of(np.array([5.0, 0.0, 0.0, 0.0, 1.0, 2.0]), 2)
    (array([1, 0, 1, 0]), array([1, 0, 0, 0, 1, 1]))
    """
    distinct, place, count = np.unique(values, return_inverse=True, return_counts=True)
    if len(distinct) <= bins:
        return place
    middle = np.cumsum(count) - 0.5 * count  # rank of the middle one of each value
    _, number = np.unique((middle * bins / len(values)).astype(int), return_inverse=True)
    return np.asarray(number[place])


@dataclass(frozen=True)
class PairEffect:
    """Interaction of two parameters, beyond the sum of their main effects.

    Parameters
    ----------
    parameters : tuple of str
    share : float
        Of the variance (the second-order Sobol index, by cells with their own noise taken off); zero where chance can
        make as much.
    """

    parameters: tuple[str, str]
    share: float


def pair_effects(parameters: Mapping[str, FloatArray], metric: FloatArray) -> list[PairEffect]:
    """Effect of each pair of parameters (members,) on a metric (members,), the strongest first; none for few members.

    Examples
    --------
    >>> x = np.random.default_rng(0).uniform(-1, 1, (4000, 7))
    >>> metric = x[:, 0] + 2.0 * x[:, 1] * x[:, 2]  # variances 1/3 and 4/9
    >>> found = pair_effects(dict(zip("abcdefg", x.T)), metric)
    >>> found[0].parameters == ("b", "c"), round(found[0].share, 1), max(e.share for e in found[1:]) < 0.03
    (True, 0.6, True)
    """
    known = np.isfinite(metric)
    y, names = metric[known], list(parameters)
    bins = min(MOST_CELLS, int(np.sqrt(len(y) / PER_BIN)))
    if bins < 3 or np.ptp(y) == 0.0 or not names:
        return []
    places = np.stack([bins_of(column[known], bins) for column in parameters.values()], axis=1)
    alone = [_share(places[:, i], y) for i in range(len(names))]
    chance = 2.0 * np.sqrt(2.0) / len(y)  # twice the scatter of a share of nothing, for a single cell
    filled = 1.0 + places.max(axis=0)
    found = []
    for i, j in combinations(range(len(names)), 2):
        both = _share(places[:, i] * bins + places[:, j], y)
        share = both - alone[i] - alone[j]
        found.append(
            PairEffect((names[i], names[j]), share if share > chance * np.sqrt(filled[i] * filled[j]) else 0.0)
        )
    return sorted(found, key=lambda effect: -effect.share)


def _share(group: IntArray, metric: FloatArray) -> float:
    """Share of the variance between groups, minus the chance level."""
    _, group = np.unique(group, return_inverse=True)
    count = np.bincount(group)
    means = np.bincount(group, weights=metric) / count
    within = float(np.sum((metric - means[group]) ** 2))
    total = float(np.sum((metric - metric.mean()) ** 2))
    free = len(metric) - len(count)
    return (total - within - (len(count) - 1) * within / max(free, 1)) / total


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
