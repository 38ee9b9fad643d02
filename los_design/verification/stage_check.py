"""Stages of the implemented loop at many parameter points: gammas with refined peaks, stability, kept margins.

All points share the frequencies of one grid (:mod:`los_design.verification.sweep`). Each point has, besides, the
frequencies of its loop's slow modes: they are narrower than the steps of the grid. Peaks near the largest of a metric
are refined between the grid's frequencies. Stability is that of the eigenvalues of the exact periodic loop at every
point. One more tick of delay and other gains are checked by them where the sensitivities leave a doubt
(:func:`los_loop.margins.doubtful`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import logarithmic_grid
from lftkit.arrays import BoolArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.workers import Workers
from los_design.search.worst_case_search import Search
from los_design.search.worst_points import WorstPoint
from los_design.verification.peaks import Bracket, worst_of
from los_design.verification.sweep import Reach, Sweep, joined, sweep
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop, LoopMetric
from los_loop.margins import changed_loops
from los_loop.sampled_loop import radius_of
from titop_plant.disturbances.wheel_and_drive_tones import no_tones
from titop_plant.simulation.plant_step import step_matrix

Values = Mapping[str, float]
Item = TypeVar("Item")
Result = TypeVar("Result")
SLOW_STEP, FAST_STEP = 0.03, 0.003
"""Relative step of the grid below and above :data:`FINE_FROM`."""
FINE_FROM, FINE_TO = 60.0, 1000.0
CHUNK, BLOCKS = 10, 24
"""Parameter points that a process looks at together, and parts of the grid, each over its whole range."""
DRIFTS: FloatArray = np.asarray(np.geomspace(1e-5, 1e-2, 19)[:-1], dtype=float)
"""Frequencies [rad/s] below the grid: a change that makes a slow pole of a controller unstable shows there."""
NARROW, AROUND = 0.05, 5e-3
"""Damping ratio of the modes that are looked at one by one, and the relative half-width of their brackets. The peak of
one with 1 to 5 % hides between two frequencies of the grid where another peak of the point is a little larger there."""


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


def grid() -> FloatArray:
    """Frequencies [rad/s] of a check: fine where the structure's modes are."""
    slow = logarithmic_grid(LOWEST, FINE_FROM, SLOW_STEP)
    fine = logarithmic_grid(FINE_FROM, FINE_TO, FAST_STEP)
    above = logarithmic_grid(FINE_TO, HIGHEST, SLOW_STEP)
    return np.asarray(np.unique(np.concatenate([slow, fine, above])), dtype=float)


def check_stages(
    loops: Sequence[ImplementedLoop],
    points: Sequence[Values],
    *,
    changes: bool = True,
    tick: Callable[[], None] = lambda: None,
    workers: Workers | None = None,
) -> list[StageCheck]:
    """Evaluate stages of the same controllers at parameter points.

    Parameters
    ----------
    loops : sequence of ImplementedLoop
        Of the stages ``isolator``, ``fsm`` or ``fsm+pma``, around one open loop.
    points : sequence of mapping
    changes : bool
        Check the changed loops, too.
    tick : callable
        Called once for each point and stage.
    workers : Workers, optional
        Processes; the result does not depend on them.
    """
    if not points:
        raise InputError("points must hold at least one parameter point, got none")
    # Those of :func:grid, and the drifts below them, at which no metric counts
    workers, searches, omega = workers or Workers(), [Search(loop) for loop in loops], np.concatenate([DRIFTS, grid()])
    chunks = [slice(k, k + CHUNK) for k in range(0, len(points), CHUNK)]
    blocks = [np.arange(k, len(omega), BLOCKS) for k in range(BLOCKS)]
    metrics = sum(len(search.metrics) for search in searches)
    told = _Told(tick, len(points) * len(loops), len(chunks) + len(blocks) + metrics)
    cube = np.array([loops[0].point(dict(values)) for values in points])
    reaches = [Reach(search.loop, search.metrics, changes) for search in searches]

    def whole(stable: Sequence[BoolArray], each: Callable[..., list[list[Sweep]]]) -> list[Sweep]:
        return [joined(stage) for stage in zip(*each(workers, partial(_swept, reaches, omega, cube, stable), blocks))]

    swept = whole([np.ones(len(points), dtype=bool)] * len(loops), told.each)
    for one in swept:
        one.doubt[0] = changes  # one point is checked by eigenvalues, whatever its responses say
    items = [_Closely(points[chunk], cube[chunk], [one.doubt[chunk] for one in swept]) for chunk in chunks]
    closely = told.each(workers, partial(_looked_closely, reaches), items)
    stable = [np.concatenate([part[k].stable for part in closely]) for k in range(len(loops))]
    if not all(at_points.all() for at_points in stable):  # seldom: once more, without the values of unstable points
        swept = whole(stable, Workers.map)
    brackets = [
        (k, name, _brackets(metric, omega, swept[k], cube) + narrow)
        for k, search in enumerate(searches)
        for name, metric in search.metrics.items()
        for narrow in [[b for part in closely for b in part[k].narrow[name]]]
        if stable[k].any()
    ]
    worst = told.each(workers, partial(_worst_of, searches), brackets)
    told.rest()
    return [
        StageCheck(
            loop.stage,
            {name: one for (stage, name, _), one in zip(brackets, worst) if stage == k},
            stable[k],
            [names for part in closely for names in part[k].lost],
            {name: values[len(DRIFTS) :] for name, values in swept[k].envelope.items()},
        )
        for k, loop in enumerate(loops)
    ]


class _Told:
    """Tells of a number of steps as parts of the work are done."""

    def __init__(self, tick: Callable[[], None], steps: int, parts: int) -> None:
        self._tick, self._steps, self._parts, self._done = tick, steps, parts, 0

    def each(self, workers: Workers, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Results of a function for the items, each of which is a part."""
        results = []
        for result in workers.each(function, items):
            results.append(result)
            before = self._steps * self._done // self._parts
            self._done += 1
            for _ in range(self._steps * self._done // self._parts - before):
                self._tick()
        return results

    def rest(self) -> None:
        """Tell of the steps that are left: stages without a stable point have no parts of their own at the end."""
        for _ in range(self._steps * self._done // self._parts, self._steps):
            self._tick()


def _swept(
    reaches: Sequence[Reach], omega: FloatArray, cube: FloatArray, stable: Sequence[BoolArray], places: IntArray
) -> list[Sweep]:
    return sweep(reaches, omega, places, cube, stable)


@dataclass(frozen=True)
class _Closely:
    """Points that are looked at one by one: as values and of the unit cube, and their doubts by stage."""

    points: Sequence[Values]
    cube: FloatArray
    doubts: Sequence[BoolArray]


@dataclass
class _Seen:
    """Of a stage at some points: whether it is stable, values at slow modes by metric, changes that are unstable."""

    stable: list[bool]
    narrow: dict[str, list[Bracket]]
    lost: list[list[str]]


def _looked_closely(reaches: Sequence[Reach], item: _Closely) -> list[_Seen]:
    """Each stage by the eigenvalues of the exact periodic loop, and at the frequencies of its slow modes."""
    results = [_Seen([], {name: [] for name in reach.metrics}, []) for reach in reaches]
    for i, values in enumerate(item.points):
        plant = reaches[0].loop.system.at(values)
        commands = reaches[0].loop.ports.commands
        step = step_matrix(plant, no_tones(plant.B.shape[1] - commands))
        for reach, seen, doubts in zip(reaches, results, item.doubts):
            sampled, doubt = reach.loop.sampled_around(plant, step), doubts[i].copy()
            multipliers = sampled.multipliers()
            seen.stable.append(radius_of(multipliers, sampled.frame_ticks) < 1.0)
            if seen.stable[-1]:
                _at_modes(reach, sampled.slow_modes(multipliers, FINE_FROM, NARROW), item.cube[i], doubt, seen)
            changed = zip(doubt, changed_loops(sampled, reach.loop.stage)) if doubt.any() else ()
            seen.lost.append(
                [name for applies, (name, make) in changed if applies and not make().spectral_radius() < 1.0]
            )
    return results


def _at_modes(reach: Reach, modes: FloatArray, point: FloatArray, doubt: BoolArray, seen: _Seen) -> None:
    """Keep the values of each metric at the slow modes of a stable point, and mark `doubt`."""
    if not len(modes):
        return
    delta = reach.loop.delta(point[None])
    T = reach.responses(reach.loop.at_each(modes), delta.repeat(len(modes), 0))
    doubt |= reach.doubt(T, modes).any(axis=0)
    gains = {(rows.start, columns.start): largest_gains(T[:, rows, columns]) for rows, columns, _ in reach.blocks}
    for k, w in enumerate(modes.tolist()):
        for rows, columns, factors in reach.here(w):
            gain = float(gains[rows.start, columns.start][k])
            for name, factor in factors.items():
                seen.narrow[name].append(Bracket(gain * factor, w, (w * (1.0 - AROUND), w * (1.0 + AROUND)), point))


def _brackets(metric: LoopMetric, omega: FloatArray, swept: Sweep, cube: FloatArray) -> list[Bracket]:
    """The largest value of each point on the grid, with the neighbouring frequencies."""
    value, place = swept.value[metric.name], np.maximum(swept.place[metric.name], len(DRIFTS))
    brackets = []
    for v, k, point in zip(value, place, cube):
        low, high = np.clip([omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]], *metric.band)
        brackets.append(Bracket(float(v), float(omega[k]), (float(low), float(high)), point))
    return brackets


RESULTS = (Sweep, _Seen, Bracket, WorstPoint)
"""Classes of what the workers of a check give."""


def _worst_of(searches: Sequence[Search], item: tuple[int, str, Sequence[Bracket]]) -> WorstPoint:
    stage, name, brackets = item
    return worst_of(searches[stage], searches[stage].metrics[name], brackets)
