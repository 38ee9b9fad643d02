"""The worst point of a metric, from the largest values of many parameter points on a grid of frequencies.

Peaks lie between the frequencies of a grid. Those near the largest one are refined, but not where slopes say that they
stay below it: from its value on, a singular value is taken to rise with no more than :data:`RISE` times its slope, up
to the end of its bracket or to the next slope of the other sign; a resonance's rise is below its tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from lftkit.analysis.batched_linalg import singular_values
from lftkit.arrays import ComplexArray, FloatArray
from los_design.search.worst_case_search import Search
from los_design.search.worst_points import WorstPoint
from los_loop.closing import ClosedLoop
from los_loop.implemented_loop import LoopMetric

NEAR = 0.8
"""Peaks above this part of the largest one of their metric are looked at."""
RISE, SAME = 2.0, 1e-5
"""Factor of a slope that bounds a rise; peaks that differ by less than the last part are one."""
BESIDE = 1e-5
"""Of log frequency, for slopes of all singular values."""
LEVELS, SEVERAL, PARTS = 3, 4, 8
"""How often brackets are cut into parts at whose frequencies all their points are looked at together, if so many share
a bracket, and the number of parts."""
ACCURACY, MOST = 1e-6, 40
"""Of the log frequency of a refined peak, whose value is then exact to better than 1e-6, and slopes that it takes."""
TOGETHER = 64
"""Frequencies of brackets whose loops are closed together."""
CLIP = 0.01
"""Least part of a bracket between a slope's frequency and the next one."""


@dataclass(frozen=True)
class Bracket:
    """A value of a metric, its frequency, the frequencies between which its peak is refined, and its point."""

    value: float
    omega: float
    ends: tuple[float, float]
    point: FloatArray


Peak = tuple[float, float]
"""Value and frequency [rad/s]."""


def worst_of(search: Search, metric: LoopMetric, brackets: Sequence[Bracket]) -> WorstPoint:
    """Worst point of a metric, its peak and those near it refined."""
    order = sorted(brackets, key=lambda b: -b.value)
    if not order or not order[0].value > 0.0:
        return search.confirmed(metric, 0.0, search.loop.point({}))
    first = order[0]
    best = (*(_refined(search, metric, [first], 0.0)[0] or (first.value, first.omega)), first.point)
    others = [bracket for bracket in order[1:] if bracket.value >= NEAR * best[0]]
    others, alone = _higher(search, metric, others, best[0]), list[Bracket]()
    for _ in range(LEVELS):
        several = [group for group in _groups(others) if len(group) >= SEVERAL]
        grouped = {k for group in several for k in group}
        alone += [bracket for k, bracket in enumerate(others) if k not in grouped]
        narrow = [bracket for group in several for bracket in _narrowed(search, metric, [others[k] for k in group])]
        largest = max(narrow, key=lambda b: b.value, default=first)
        best = max(best, (largest.value, largest.omega, largest.point), key=lambda entry: entry[0])
        others = _higher(search, metric, narrow, best[0])
    left = sorted(others + alone, key=lambda b: -b.value)
    for start in range(0, len(left), TOGETHER):
        some = left[start : start + TOGETHER]
        for bracket, refined in zip(some, _refined(search, metric, some, best[0])):
            if refined is not None and refined[0] > best[0]:
                best = (*refined, bracket.point)
    return search.confirmed(metric, *best[1:])


def rise_bounds(here: FloatArray, above: FloatArray, below_end: FloatArray, above_end: FloatArray) -> FloatArray:
    """Bounds of N peaks by the slopes of all their singular values.

    Parameters
    ----------
    here, above : ndarray, shape (N, r)
        Singular values at a frequency, and at :data:`BESIDE` above it.
    below_end, above_end : ndarray
        Distances in log frequency to the ends of the bracket, positive.

    Examples
    --------
    >>> flat = np.ones((1, 1))
    >>> rise_bounds(flat, flat, np.array([0.1]), np.array([0.1])).tolist()
    [1.0]
    """
    rates = np.log(np.maximum(above, 1e-300) / np.maximum(here, 1e-300)) / BESIDE
    width = np.where(rates > 0.0, above_end[:, None], below_end[:, None])
    return np.asarray(np.max(here * np.exp(np.minimum(RISE * np.abs(rates) * width, 700.0)), axis=1))


def _groups(brackets: Sequence[Bracket]) -> list[list[int]]:
    """Places of the brackets with the same frequency and ends."""
    groups: dict[tuple[float, float, float], list[int]] = {}
    for k, bracket in enumerate(brackets):
        groups.setdefault((bracket.omega, *bracket.ends), []).append(k)
    return list(groups.values())


def _values(search: Search, metric: LoopMetric, omega: FloatArray, points: FloatArray) -> FloatArray:
    """All normalised singular values at some frequencies and points: shape (frequencies, N, r)."""
    return _singular_values(search, metric, search.loop.at_each(omega), search.loop.delta(points))


def _singular_values(search: Search, metric: LoopMetric, each: ClosedLoop, delta: ComplexArray) -> FloatArray:
    """What :func:`_values` gives, of loops that are closed, for N diagonals of Delta (N, 32)."""
    loop = search.loop
    return np.array(
        [singular_values(loop.responses(closed, metric, delta)) * loop.scale(metric, closed.omega) for closed in each]
    )


def _higher(search: Search, metric: LoopMetric, brackets: Sequence[Bracket], largest: float) -> list[Bracket]:
    """Those of some brackets whose peaks may exceed the largest one, by slopes."""
    # What slopes say of each bracket's peak: those at one frequency together, loops closed for many at once
    bounds, groups, loop = np.zeros(len(brackets)), _groups(brackets), search.loop
    for start in range(0, len(groups), TOGETHER):
        part = groups[start : start + TOGETHER]
        both = np.array([brackets[group[0]].omega * np.exp([0.0, BESIDE]) for group in part])
        closed = loop.at_each(both.ravel())
        for k, group in enumerate(part):
            omega, ends = brackets[group[0]].omega, np.clip(brackets[group[0]].ends, *metric.band)
            delta = loop.delta(np.array([brackets[place].point for place in group]))
            here, above = _singular_values(search, metric, closed[2 * k : 2 * k + 2], delta)
            below_end, above_end = np.abs(np.log(ends / omega))
            bounds[group] = rise_bounds(here, above, np.full(len(group), below_end), np.full(len(group), above_end))
    return [bracket for bracket, bound in zip(brackets, bounds) if bound > (1.0 + SAME) * largest]


def _narrowed(search: Search, metric: LoopMetric, brackets: Sequence[Bracket]) -> list[Bracket]:
    """Brackets with the same frequency and ends a few times as narrow."""
    low, high = np.clip(brackets[0].ends, *metric.band)
    if not low < high:
        return list(brackets)
    omega = np.unique([*np.geomspace(low, high, PARTS + 1), np.clip(brackets[0].omega, low, high)])
    values, narrowed = _values(search, metric, omega, np.array([b.point for b in brackets])).max(axis=2), []
    for bracket, gains in zip(brackets, values.T):
        k = int(gains.argmax())
        ends = float(omega[max(k - 1, 0)]), float(omega[min(k + 1, len(omega) - 1)])
        narrowed.append(Bracket(float(gains[k]), float(omega[k]), ends, bracket.point))
    return narrowed


class _Refinement:
    """Where the peak in a bracket is, by the values and slopes at frequencies that it asks for one after the other.

    Parameters
    ----------
    bracket : Bracket
    band : (float, float)
        Frequencies of the metric [rad/s].
    """

    def __init__(self, bracket: Bracket, band: tuple[float, float]) -> None:
        self.bracket = bracket
        self.best: Peak = bracket.value, bracket.omega
        self.omega = bracket.omega
        self._x = float(np.log(bracket.omega))
        self._ends: list[float] = np.log(np.clip(bracket.ends, *band)).tolist()
        self._rates, self._bounds, self._weights, self._last = [0.0, 0.0], [np.inf, np.inf], [1.0, 1.0], -1

    def take(self, value: float, slope: float, largest: float) -> str:
        """Take a value and its slope over log frequency: ``"next"``, ``"found"``, or ``"lower"`` than the largest."""
        self.best, side = max(self.best, (value, self.omega)), int(slope <= 0.0)
        ends, rates, bounds, weights = self._ends, self._rates, self._bounds, self._weights
        ends[side], rates[side], weights[side] = self._x, slope / value, 1.0
        weights[1 - side] *= 0.5 if side == self._last else 1.0  # so that its end moves, too
        width, self._last = ends[1] - ends[0], side
        bounds[side] = value * np.exp(min(RISE * abs(rates[side]) * width, 700.0))
        if min(bounds) <= (1.0 + SAME) * largest:
            return "lower"
        following = ends[1 - side]  # where nothing is known on that side
        if all(map(np.isfinite, bounds)):
            rise, fall = weights[0] * rates[0], -weights[1] * rates[1]
            part = rise / (rise + fall) if rise + fall > 0.0 else 0.5
            following = ends[0] + float(np.clip(part, CLIP, 1.0 - CLIP)) * width
        if width <= ACCURACY or abs(following - self._x) <= ACCURACY:
            return "found"
        self._x, self.omega = following, float(np.exp(following))
        return "next"


def _refined(search: Search, metric: LoopMetric, brackets: Sequence[Bracket], largest: float) -> list[Peak | None]:
    """The peak in each bracket by its slopes; None where they say that it does not exceed the largest one.

    All of them take a step at a time, so that their loops are closed together. Where a second singular value is near
    the first one, which may rise where that one does not, a peak is sought by values alone.
    """
    refinements, peaks = (
        [_Refinement(bracket, metric.band) for bracket in brackets],
        list[Peak | None]([None] * len(brackets)),
    )
    active, sought = list(range(len(refinements))), list[int]()
    for _ in range(MOST):
        if not active:
            break
        closed = search.loop.at_each(np.array([refinements[k].omega for k in active]))
        points = np.array([refinements[k].bracket.point for k in active])
        values, _, slopes = search.loop.gains_with_slopes(closed, metric, points)
        going = list[int]()
        for k, value, slope in zip(active, values, slopes.tolist()):
            first, *others = value.tolist()
            beside = max([largest, *(one.best[0] for one in refinements[:k] + refinements[k + 1 :])])
            if not first > 0.0 or (others and others[0] >= NEAR * max(beside, first)):
                sought.append(k)
                continue
            said = refinements[k].take(first, slope, beside)
            going += [k] * (said == "next")
            peaks[k] = None if said == "lower" else refinements[k].best
        active = going
    for k in sought:
        largest = max([largest, *(peak[0] for peak in peaks if peak is not None)])
        peaks[k] = _sought(search, metric, brackets[k], largest)
    return peaks


def _sought(search: Search, metric: LoopMetric, bracket: Bracket, largest: float) -> Peak | None:
    """The peak in a bracket by values; None where those of its parts say that it does not exceed the largest one."""
    point, narrow = bracket.point[None], _narrowed(search, metric, [bracket])
    if largest and narrow[0].value <= largest and not _higher(search, metric, narrow, largest):
        return None
    bracket = max(bracket, *narrow, key=lambda b: b.value)

    def lower(x: float) -> float:
        return -float(search.loop.gains(search.loop.at(float(np.exp(x))), metric, point)[0])

    ends = np.log(np.clip(bracket.ends, *metric.band))
    minimum = scipy.optimize.minimize_scalar(lower, bounds=ends, method="bounded", options={"xatol": ACCURACY})
    return max((-float(minimum.fun), float(np.exp(minimum.x))), (bracket.value, bracket.omega))
