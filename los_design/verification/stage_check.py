"""One stage of the implemented loop at many parameter points: gammas with refined peaks, stability, kept margins.

All points share the frequencies of one grid: at each of them the loop is closed once and every point costs a solution
of order 48 (:mod:`los_loop.implemented_loop`). Each point has, besides, the frequencies of its loop's slow modes:
they are narrower than the steps of the grid. Peaks near the largest of a metric are refined between the grid's
frequencies. Stability is that of the eigenvalues of the exact periodic loop at every point. One more tick of delay and
other gains are checked by them where the sensitivities leave a doubt (:func:`los_loop.margins.doubtful`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.optimize

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.arrays import BoolArray, FloatArray, IntArray
from lftkit.support.workers import Workers
from los_design.search.worst_case_search import Search
from los_design.search.worst_points import WorstPoint
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop, LoopMetric
from los_loop.margins import change_names, changed_loops, doubtful
from los_loop.sampled_loop import radius_of
from los_loop.spec import ADDED, APPLIED

Values = Mapping[str, float]
SLOW_STEP, FAST_STEP = 0.03, 0.003
"""Relative step of the grid below and above :data:`FINE_FROM`."""
FINE_FROM, FINE_TO = 60.0, 1000.0
NEAR = 0.8
"""Peaks above this part of the largest one of their metric are refined."""
RISE, SAME = 2.0, 1e-5
"""Not those that stay below the largest one with this many times the slope at their value, up to the end of their
bracket, unless a second singular value is near it, too; peaks that differ by less than the last part are one."""
ACCURACY = 1e-6
"""Of the frequency of a refined peak; its value is then exact to better than 1e-4."""
CHUNK = 75
"""Parameter points that a process looks at together."""
DRIFTS: FloatArray = np.asarray(np.geomspace(1e-5, 1e-2, 19)[:-1], dtype=float)
"""Frequencies [rad/s] below the grid: a change that makes a slow pole of a controller unstable shows there."""
NARROW, AROUND = 0.01, 3e-3
"""Damping ratio of the modes that are looked at one by one, and the relative half-width of their brackets."""


@dataclass(frozen=True)
class StageCheck:
    """Worst values of a stage over parameter points.

    Parameters
    ----------
    stage : str
    worst : dict of str to WorstPoint
        By metric, over the stable points.
    stable : ndarray of bool
        For each point, whether the loop is stable.
    unstable_changes : list of list of str
        For each point, the changes of :func:`los_loop.margins.changed_loops` that make it unstable.
    envelope : dict of str to ndarray
        Largest value over the points at each frequency of :func:`grid`, by metric.
    """

    stage: str
    worst: dict[str, WorstPoint]
    stable: BoolArray
    unstable_changes: list[list[str]]
    envelope: dict[str, FloatArray]


@dataclass(frozen=True)
class Bracket:
    """A value of a metric, its frequency, the frequencies between which its peak is refined, and its point."""

    value: float
    omega: float
    ends: tuple[float, float]
    point: FloatArray


def grid() -> FloatArray:
    """Frequencies [rad/s] of a check: fine where the structure's modes are."""
    slow = np.geomspace(LOWEST, FINE_FROM, int(np.log(FINE_FROM / LOWEST) / SLOW_STEP))
    fine = np.geomspace(FINE_FROM, FINE_TO, int(np.log(FINE_TO / FINE_FROM) / FAST_STEP))
    above = np.geomspace(FINE_TO, HIGHEST, int(np.log(HIGHEST / FINE_TO) / SLOW_STEP))
    return np.asarray(np.unique(np.concatenate([slow, fine, above])), dtype=float)


def check_stage(
    loop: ImplementedLoop,
    points: Sequence[Values],
    *,
    changes: bool = True,
    tick: Callable[[], None] = lambda: None,
    workers: Workers | None = None,
) -> StageCheck:
    """Evaluate a stage at parameter points.

    Parameters
    ----------
    loop : ImplementedLoop
        Of the stage ``isolator``, ``fsm`` or ``fsm+pma``.
    points : sequence of mapping
    changes : bool
        Check the changed loops, too.
    tick : callable
        Called once for each point.
    workers : Workers, optional
        Processes; the result does not depend on them.
    """
    if not points:
        raise ValueError("points must hold at least one parameter point, got none")
    workers = workers or Workers()
    search = Search(loop)
    chunks = [_Chunk(points[k : k + CHUNK], changes, k == 0) for k in range(0, len(points), CHUNK)]
    parts: list[_Part] = []
    for part in workers.each(partial(_look, search), chunks):
        parts.append(part)
        for _ in part.stable:
            tick()
    stable = np.concatenate([part.stable for part in parts])
    brackets = {name: [b for part in parts for b in part.brackets[name]] for name in search.metrics}
    found = workers.map(partial(_worst, search), list(brackets.items()) if stable.any() else [])
    unstable = [names for part in parts for names in part.unstable_changes]
    envelope = {name: np.max([part.envelope[name] for part in parts], axis=0) for name in search.metrics}
    return StageCheck(loop.stage, dict(zip(search.metrics, found)), stable, unstable, envelope)


@dataclass(frozen=True)
class _Chunk:
    """Parameter points that are looked at together, whether with changed loops, and whether they are the first ones."""

    points: Sequence[Values]
    changes: bool
    first: bool


@dataclass(frozen=True)
class _Part:
    """What :class:`StageCheck` holds, for a chunk, with brackets of the largest values of each metric."""

    stable: BoolArray
    brackets: dict[str, list[Bracket]]
    unstable_changes: list[list[str]]
    envelope: dict[str, FloatArray]


def _look(search: Search, chunk: _Chunk) -> _Part:
    """Stability, largest values and changed loops of a chunk of points."""
    found, modes = [], list[FloatArray]()
    for values in chunk.points:
        loop = search.loop.sampled_at(values)[1]
        multipliers = loop.multipliers()
        found.append(radius_of(multipliers, loop.frame_ticks) < 1.0)
        modes.append(loop.slow_modes(multipliers, FINE_FROM, NARROW))
    stable = np.array(found)
    cube = np.array([search.loop.point(dict(values)) for values in chunk.points])
    metrics, omega = search.metrics, grid()
    doubt = np.zeros((len(cube), len(change_names(search.loop.stage))), dtype=bool)
    doubt[0] |= chunk.first  # one point is checked by eigenvalues, whatever its responses say
    for w in DRIFTS:
        doubt |= doubtful(search.loop.sensitivities(search.loop.at(float(w)), cube), float(w), search.loop.stage)
    peaks, envelope = _largest(search.loop, metrics, omega, cube, stable, doubt)
    narrow = _at_modes(search.loop, metrics, modes, cube, stable, doubt)
    unstable = [_lost(search, values, doubt[i]) if chunk.changes else [] for i, values in enumerate(chunk.points)]
    brackets = {name: _brackets(metrics[name], omega, *peaks[name], cube) + narrow[name] for name in metrics}
    return _Part(stable, brackets, unstable, envelope)


def _lost(search: Search, values: Values, doubt: BoolArray) -> list[str]:
    """Those changes of gain and delay in doubt that make the loop unstable at a point."""
    if not doubt.any():
        return []
    changed = zip(doubt, changed_loops(search.loop.sampled_at(values)[1], search.loop.stage))
    return [name for doubted, (name, make) in changed if doubted and not make().spectral_radius() < 1.0]


def _largest(
    loop: ImplementedLoop,
    metrics: Mapping[str, LoopMetric],
    omega: FloatArray,
    cube: FloatArray,
    stable: BoolArray,
    doubt: BoolArray,
) -> tuple[dict[str, tuple[FloatArray, IntArray]], dict[str, FloatArray]]:
    """For each metric the largest value of every point with its place in the grid, and the envelope; marks `doubt`."""
    value: dict[str, FloatArray] = {name: np.zeros(len(cube)) for name in metrics}
    place: dict[str, IntArray] = {name: np.zeros(len(cube), dtype=np.intp) for name in metrics}
    envelope: dict[str, FloatArray] = {name: np.zeros(len(omega)) for name in metrics}
    for k, w in enumerate(omega):
        closed = loop.at(float(w))
        T = loop.all_responses(closed, cube)
        doubt |= doubtful(T[:, APPLIED, ADDED], float(w), loop.stage)
        for name, metric in metrics.items():
            if metric.band[0] <= w <= metric.band[1]:
                gains = largest_gains(T[:, metric.rows, metric.columns]) * loop.scale(metric, float(w))
                gains = np.where(stable, gains, 0.0)
                higher = gains > value[name]
                value[name] = np.where(higher, gains, value[name])
                place[name] = np.where(higher, k, place[name])
                envelope[name][k] = float(gains.max())
    return {name: (value[name], place[name]) for name in metrics}, envelope


def _at_modes(
    loop: ImplementedLoop,
    metrics: Mapping[str, LoopMetric],
    modes: Sequence[FloatArray],
    cube: FloatArray,
    stable: BoolArray,
    doubt: BoolArray,
) -> dict[str, list[Bracket]]:
    """For each metric its values at the slow modes of every stable point; marks `doubt`."""
    found: dict[str, list[Bracket]] = {name: [] for name in metrics}
    for i in np.flatnonzero(stable):
        for w in modes[i]:
            closed = loop.at(float(w))
            doubt[i] |= doubtful(loop.sensitivities(closed, cube[i][None]), float(w), loop.stage)[0]
            for name, metric in metrics.items():
                if metric.band[0] <= w <= metric.band[1]:
                    value = float(loop.gains(closed, metric, cube[i][None])[0])
                    found[name].append(Bracket(value, float(w), (w * (1.0 - AROUND), w * (1.0 + AROUND)), cube[i]))
    return found


def _brackets(
    metric: LoopMetric, omega: FloatArray, value: FloatArray, place: IntArray, cube: FloatArray
) -> list[Bracket]:
    """The largest value of each point on the grid, with the neighbouring frequencies."""
    found = []
    for v, k, point in zip(value, place, cube):
        low, high = np.clip([omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]], *metric.band)
        found.append(Bracket(float(v), float(omega[k]), (float(low), float(high)), point))
    return found


def _worst(search: Search, item: tuple[str, Sequence[Bracket]]) -> WorstPoint:
    """Worst point of a metric, its peak and those near it refined."""
    name, brackets = item
    metric, best = search.metrics[name], (0.0, 0.0, search.loop.point({}))
    for bracket in sorted(brackets, key=lambda b: -b.value):
        if bracket.value < NEAR * best[0]:
            break
        if _reach(search, metric, bracket, best[0]) <= (1.0 + SAME) * best[0]:
            continue
        point = bracket.point[None]

        def lower(x: float, point: FloatArray = point) -> float:
            return -float(search.loop.gains(search.loop.at(float(np.exp(x))), metric, point)[0])

        ends = np.log(np.clip(bracket.ends, *metric.band))
        found = scipy.optimize.minimize_scalar(lower, bounds=ends, method="bounded", options={"xatol": ACCURACY})
        refined = max((-float(found.fun), float(np.exp(found.x))), (bracket.value, bracket.omega))
        if refined[0] > best[0]:
            best = (*refined, bracket.point)
    return search.confirmed(metric, *best[1:])


def _reach(search: Search, metric: LoopMetric, bracket: Bracket, largest: float) -> float:
    """What the peak in a bracket may reach by the slope at its value; a resonance's rise is below its tangent.

    Infinite if a second singular value is near the largest peak: it may rise where the first one does not.
    """
    closed = search.loop.at(bracket.omega)
    values = search.loop.all_gains(closed, metric, bracket.point)
    if len(values) > 1 and values[1] >= NEAR * largest:
        return np.inf
    value, _, slope = search.loop.gain(closed, metric, bracket.point)
    end = bracket.ends[1] if slope > 0.0 else bracket.ends[0]
    return float(value * np.exp(RISE * slope / value * np.log(end / bracket.omega)))
