"""Sensitivity of the metrics of a campaign: rank correlations, main and pair effects, yield."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
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
ROUNDING = 1e-9
"""Share of the variance that may be rounding."""


@dataclass(frozen=True)
class ChanceSettings:
    """How much of an influence there is by chance: of the metric's values in random order.

    Parameters
    ----------
    orders : int
        Random orders.
    confidence : float
        Part of them in which no parameter, or pair, reaches the level.
    seed : int
    """

    orders: int = 400
    confidence: float = 0.95
    seed: int = 0

    def level(self, metric: FloatArray, largest: Callable[[FloatArray], float]) -> float:
        """What the `largest` influence on a metric (members,) does not exceed by chance."""
        rng = np.random.default_rng(self.seed)
        return float(np.quantile([largest(rng.permutation(metric)) for _ in range(self.orders)], self.confidence))


CHANCE = ChanceSettings()


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
    chance_rank_correlation, chance_first_order : float
        What the largest of all parameters does not exceed by chance, at 95 % confidence.
    """

    parameter: str
    rank_correlation: float
    first_order: float
    chance_rank_correlation: float
    chance_first_order: float

    @property
    def known(self) -> bool:
        """Whether its share of the variance is more than chance makes."""
        return self.first_order > self.chance_first_order


def influences(parameters: Mapping[str, FloatArray], metric: FloatArray) -> list[Influence]:
    """Influence of each parameter (members,) on a metric (members,), the strongest first; none for few members."""
    from scipy import stats  # a large import, which members need not wait for

    known = np.isfinite(metric)
    y = metric[known]
    if len(y) < FEWEST or np.ptp(y) == 0.0 or not parameters:
        return []

    columns = [column[known] for column in parameters.values()]
    ranks = np.stack([_standard(stats.rankdata(column)) for column in columns])
    correlations, order = ranks @ _standard(stats.rankdata(y)), stats.rankdata(y)
    by_rank = CHANCE.level(order, lambda values: float(np.abs(ranks @ _standard(values)).max()))
    shares = [first_order_index(column, y) for column in columns]
    by_share = np.nan
    if not np.isnan(shares).any():
        groups = [bins_of(column, _bins(y)) for column in columns]
        by_share = CHANCE.level(y, lambda values: max(_share(group, values) for group in groups))
    rows = [Influence(name, float(rank), share, by_rank, by_share)
             for name, rank, share in zip(parameters, correlations, shares)]  # fmt: skip
    return sorted(rows, key=lambda i: -max(abs(i.rank_correlation), 0.0 if np.isnan(i.first_order) else i.first_order))


def _standard(values: FloatArray) -> FloatArray:
    """Without their mean, of length 1; zeros for a constant."""
    centred: FloatArray = np.asarray(values - values.mean())
    return centred / (math.sqrt(centred @ centred) or 1.0)


def _bins(metric: FloatArray) -> int:
    return min(MOST_BINS, len(metric) // PER_BIN)


def first_order_index(values: FloatArray, metric: FloatArray) -> float:
    """Variance of the means in bins of the values (:func:`bins_of`) over the total variance, minus the chance level.

    Examples
    --------
    >>> x = np.random.default_rng(0).uniform(-1, 1, (4000, 2))
    >>> [round(first_order_index(column, x[:, 0] ** 2 + 0.0 * x[:, 1]), 2) for column in x.T]
    [0.99, 0.0]
    """
    bins = _bins(metric)
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
        Of the variance (the second-order Sobol index, by cells with their own noise taken off).
    chance : float
        Share that the largest of all pairs does not exceed by chance, at 95 % confidence.
    """

    parameters: tuple[str, str]
    share: float
    chance: float

    @property
    def known(self) -> bool:
        """Whether its share is more than chance makes."""
        return self.share > self.chance


def pair_effects(parameters: Mapping[str, FloatArray], metric: FloatArray) -> list[PairEffect]:
    """Effect of each pair of parameters (members,) on a metric (members,), the strongest first; none for few members.

    Examples
    --------
    >>> x = np.random.default_rng(0).uniform(-1, 1, (4000, 7))
    >>> metric = x[:, 0] + 2.0 * x[:, 1] * x[:, 2]  # variances 1/3 and 4/9
    >>> effects = pair_effects(dict(zip("abcdefg", x.T)), metric)
    >>> effects[0].parameters == ("b", "c"), 0.5 < effects[0].share < 0.6, max(e.share for e in effects[1:]) < 0.03
    (True, True, True)
    """
    known = np.isfinite(metric)
    y, names = metric[known], list(parameters)
    bins = min(MOST_CELLS, int(np.sqrt(len(y) / PER_BIN)))
    if bins < 3 or np.ptp(y) == 0.0 or not names:
        return []
    alone = [bins_of(column[known], bins) for column in parameters.values()]
    pairs = list(combinations(range(len(names)), 2))
    cells = [np.unique(alone[i] * bins + alone[j], return_inverse=True)[1] for i, j in pairs]
    rest = y - sum(_means(group, y) for group in alone)  # without what each parameter explains alone
    part = float(np.var(rest) / np.var(y))

    def shares(values: FloatArray) -> FloatArray:
        one = [_share(group, values) for group in alone]
        return np.array([part * (_share(cell, values) - one[i] - one[j]) for cell, (i, j) in zip(cells, pairs)])

    if not pairs or part < ROUNDING:
        return [PairEffect((names[i], names[j]), 0.0, ROUNDING) for i, j in pairs]
    chance = CHANCE.level(rest, lambda values: float(shares(values).max()))
    effects = [PairEffect((names[i], names[j]), float(share), chance) for (i, j), share in zip(pairs, shares(rest))]
    return sorted(effects, key=lambda effect: -effect.share)


def _means(group: IntArray, metric: FloatArray) -> FloatArray:
    """Mean of the group of each member, about the mean of all."""
    return np.asarray((np.bincount(group, weights=metric) / np.bincount(group))[group] - metric.mean())


def _share(group: IntArray, metric: FloatArray) -> float:
    """Share of the variance between groups, numbered without gaps, minus the chance level."""
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
