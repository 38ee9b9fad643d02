"""Design in rounds: tune on samples, search the implemented loop for worse parameters, add them, repeat.

The descent (:mod:`lftkit.tuning.frequency_domain`) sees the implemented loop at the frequencies and parameter points
of :mod:`los_design.synthesis.pair_problem`; the search (:mod:`los_design.search.worst_case_search`) sees it everywhere,
by ascents. What is added are the worst points of the bands in which a requirement exceeds what the descent reached. A
design is
``converged`` when a thorough search finds none.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.support.workers import Workers
from lftkit.tuning.frequency_domain import (
    DescentState,
    ResponseDescent,
    ResponseDescentOptions,
    ResponseProblem,
    descend,
)
from los_design.search.worst_case_search import Search, SearchOptions, apart
from los_design.search.worst_points import WorstPoint
from los_design.synthesis.pair_problem import ALONE, BOTH, STAGE_NAMES, Samples, limits, named, pair_problem
from los_design.synthesis.provenance import commit
from los_design.synthesis.round_state import Kept, Outcome, RoundState
from los_loop.implemented_loop import ImplementedLoop
from los_loop.sampled_loop import sampled_loop

Report = Callable[[str], None]
MAX_NEW = 16
"""Points that a round adds at most."""
SLACK = 3e-3
"""A worst point counts only if it exceeds 1, or what the descent reached above 1, by more than this part."""
UNSEEN = 0.01
"""Where there is one, all points that exceed what the descent reached by this part are added."""
NEAR = 0.9
"""Searches look at requirements above this part of the largest value; the last one of a round at all."""
HALVINGS = 7
"""Of the way to an unstable point."""


@dataclass(frozen=True)
class Effort:
    """Limits of a design in rounds; they end it, not the time: otherwise the result depends on the machine.

    Parameters
    ----------
    rounds : int
    points : int
        Random parameter points of the first round: half of them corners.
    first, iterations : int
        Of the descent in the first and in the other rounds.
    target : float
        A descent ends below this value: the search finds what is above 1, and further points raise it.
    searches : tuple of SearchOptions
        Of a round: the next one where those before find nothing worse. Those before the last look only at what was too
        large in the round before. The last one looks at everything and decides; it is made in the last round in any
        case. Empty: one descent at the first points, nothing is searched.
    """

    rounds: int
    points: int
    first: int
    iterations: int
    target: float
    searches: tuple[SearchOptions, ...]


@dataclass(frozen=True)
class Task:
    """What is designed.

    Parameters
    ----------
    samples : Samples
    stages : tuple of stages
        Whose requirements count.
    tuned : tuple of int
        Which controllers are tuned.
    sampled : callable
        From the parameter vector to the sampled K_FSM and K_PMA.
    seed : int
    wall_limit : float
        Of the whole design [s].
    workers : Workers
        Processes of the searches; the result does not depend on them.
    known : tuple of WorstPoint
        Of another telescope's design: their parameters are among the first points, the first search climbs from them.
    """

    samples: Samples
    stages: tuple[tuple[int, ...], ...]
    tuned: tuple[int, ...]
    sampled: Callable[[FloatArray], tuple[SampledSystem, SampledSystem]]
    seed: int = 0
    wall_limit: float = np.inf
    workers: Workers = field(default_factory=Workers)
    known: tuple[WorstPoint, ...] = ()

    def search(self, x: FloatArray, stage: tuple[int, ...], options: SearchOptions) -> Search:
        """Search of a stage with the controllers of `x`."""
        return Search(ImplementedLoop(self.samples.open_loop, *self.sampled(x), STAGE_NAMES[stage]), options)

    def stable(self, x: FloatArray, values: Mapping[str, float] | None = None) -> bool:
        """Whether the loops of all stages are stable at a parameter point, default the nominal one."""
        loop = self.samples.open_loop
        plant, pair = loop.system.at(dict(values or {})), self.sampled(x)
        sensitivity = float(loop.parameters["fsm"]["los_sensitivity"])
        return all(
            sampled_loop(plant, *pair, loop=STAGE_NAMES[stage], los_sensitivity=sensitivity).spectral_radius() < 1.0
            for stage in self.stages
        )


def design_in_rounds(
    task: Task,
    start: Callable[[], FloatArray],
    effort: Effort,
    report: Report = lambda text: None,
    kept: Kept | None = None,
) -> Outcome:
    """Tune, search, add, until the thorough search finds nothing worse or the rounds are over.

    Parameters
    ----------
    task : Task
    start : callable
        Gives the entries of both gain matrices; they must stabilise the nominal telescope. Not called where a design
        goes on.
    effort : Effort
    report : callable
        Receives one line for each step.
    kept : (Path, mapping), optional
        File of the state in and after each descent and each search, and what it must have been made for.
    """
    begin = time.monotonic()
    state = _begin(task, start, effort, report, kept)
    while True:
        problem = pair_problem(task.samples, task.stages, task.tuned, task.workers.count)
        left = task.wall_limit - (time.monotonic() - begin)
        iterations = effort.first if state.number == 0 else effort.iterations

        def step(iteration: int, value: float, number: int = state.number + 1) -> None:
            report(f"round {number}, step {iteration}: {value:.4f} ({time.monotonic() - begin:.0f} s)")

        options = ResponseDescentOptions(
            iterations=iterations, target=effort.target, wall_limit=left, confirm=not effort.searches
        )
        if state.descent is None:
            state.descent = _stabilising(task, problem, state, options, step, kept)
            state.x, state.number, state.inside, state.watched = state.descent.x, state.number + 1, None, []
            state.save(kept)
        descent = state.descent
        late = descent.status == "out_of_time"
        unfinished = descent.value > 1.0 and (late or descent.status == "iterations")
        last = state.number >= effort.rounds or late
        searches = _searches(effort, state.searched, last, unfinished)
        found, new = _searched(task, state, problem, searches, kept)
        worst, values = _worst(task, found)
        report(_line(state.number, problem, descent, worst, values, time.monotonic() - begin))
        if last or not (new or unfinished) or not effort.searches:
            status = descent.status if not effort.searches else _status(bool(new) or unfinished, late)
            active = [task.samples.open_loop.values(p) for p in state.points]
            return Outcome(state.x, status, _tuned(problem, descent), worst, values, active, state.commits)
        state.known |= {name: points[:3] for name, points in found.items()}
        state.exceeded = sorted({named(p.requirement, _stage(p)) for p in new})
        if new:
            _add(task, state, new)
        state.descent, state.searched = None, 0
        state.save(kept)


def _begin(
    task: Task,
    start: Callable[[], FloatArray],
    effort: Effort,
    report: Report,
    kept: Kept | None,
) -> RoundState:
    """The state that is kept, or a new one; its parameter points are sampled."""
    state = RoundState.load(kept)
    if state is None:
        state = RoundState(np.array(start(), dtype=float), points=first_points(task, effort.points))
        _begin_with_known(task, state)
    else:
        report(
            f"goes on after {state.number} rounds"
            + ", before the searches of the last" * bool(state.descent)
            + ", in the descent of the next" * bool(state.inside)
        )
    state.commits += [now for now in [commit()] if now not in state.commits]
    first = len(state.points) - sum(state.added)
    task.samples.add(np.array(state.points[:first]))
    for end, count in zip(np.cumsum(state.added), state.added):
        _sample(task, state.around[end - count : end])
    state.save(kept)
    return state


def _begin_with_known(task: Task, state: RoundState) -> None:
    """Add the known worst points to a state without rounds."""
    for point in task.known:
        state.known.setdefault(named(point.requirement, _stage(point)), []).append(point)
        at = np.clip(task.samples.open_loop.point(dict(point.parameters)), 0.0, 1.0)
        at = _stable_point(task, state.x, at)
        if not any(np.allclose(at, other) for other in state.points):
            state.points.append(at)


def _status(worse: bool, late: bool) -> str:
    return "out_of_time" if worse and late else "rounds" if worse else "converged"


def _searches(effort: Effort, done: int, last: bool, unfinished: bool) -> list[tuple[int, SearchOptions, bool]]:
    """The searches of a round that are not done: number, options, whether it is the thorough one.

    The last round has the thorough one alone. A descent that is not at its end and above 1 goes on in the next round:
    the last of several searches waits.
    """
    final = len(effort.searches) - 1
    numbered = [(k, options, k == final) for k, options in enumerate(effort.searches)]
    if last:
        return numbered[final:]
    return [search for search in numbered[: final if unfinished and final else None] if search[0] >= done]


def _searched(
    task: Task,
    state: RoundState,
    problem: ResponseProblem,
    searches: Sequence[tuple[int, SearchOptions, bool]],
    kept: Kept | None,
) -> tuple[dict[str, list[WorstPoint]], list[WorstPoint]]:
    """Worst points by name, and those that are worse than what is known, of the first search that finds such."""
    assert state.descent is not None
    descent, found = state.descent, {}
    for k, options, final in searches:
        near = {g.name: bool(final or v > NEAR * descent.value) for g, v in zip(problem.gains, descent.values)}
        if state.exceeded and not final:
            near = {name: name in state.exceeded for name in near}
        found = _search(task, state.x, options, state.known, state.number, near)
        if new := _new(task, found, descent):
            return found, new
        if not final:
            state.searched = k + 1
            state.save(kept)
    return found, []


def _stabilising(
    task: Task,
    problem: ResponseProblem,
    state: RoundState,
    options: ResponseDescentOptions,
    step: Callable[[int, float], None],
    kept: Kept | None,
) -> ResponseDescent:
    """A descent that keeps stable what is; it is repeated with the parameter points at which its result is not."""
    loop = task.samples.open_loop
    state.watched = state.watched or [{}]

    def stable(x: FloatArray) -> bool:
        with ThreadPoolExecutor(task.workers.count) as pool:
            return all(pool.map(partial(task.stable, x), state.watched))

    def keep(inside: DescentState | None) -> None:
        state.inside = inside
        state.save(kept)

    while True:
        descent = descend(problem, state.x, stable, options, step, keep, state.inside)
        others = [v for v in map(loop.values, state.points) if v not in state.watched]
        with ThreadPoolExecutor(task.workers.count) as pool:
            there = list(pool.map(partial(task.stable, descent.x), others))
        lost = [v for v, stable_there in zip(others, there) if not stable_there and task.stable(state.x, v)]
        if not lost:
            return descent
        state.watched += lost[:3]
        keep(None)


def first_points(task: Task, count: int) -> list[FloatArray]:
    """The nominal point and `count` others of the box, the first half of them random corners."""
    rng, loop = np.random.default_rng(task.seed), task.samples.open_loop
    points = rng.uniform(size=(count, len(loop.names)))
    points[: count // 2] = np.round(points[: count // 2])
    return [loop.point({}), *points]


def _search(
    task: Task,
    x: FloatArray,
    options: SearchOptions,
    known: Mapping[str, Sequence[WorstPoint]],
    number: int,
    near: Mapping[str, bool],
) -> dict[str, list[WorstPoint]]:
    """Worst points by name of the requirements that are near their limits; each round has a seed of its own."""
    found = {}
    for stage in task.stages:
        seed = options.seed + 1000 * number + task.seed
        search = task.search(x, stage, replace(options, seed=seed))
        starts = [p for points in known.values() for p in points if p.stage == STAGE_NAMES[stage]]
        names = [n for n in limits(search.loop.parameters, stage) if n in search.metrics and near[named(n, stage)]]
        found.update({named(name, stage): points for name, points in search.run(names, starts, task.workers).items()})
    return found


def _stage(point: WorstPoint) -> tuple[int, ...]:
    return BOTH if point.stage == STAGE_NAMES[BOTH] else ALONE


def _value(task: Task, name: str, point: WorstPoint) -> float:
    """Value of a worst point, 1 being the share or limit that is tuned for."""
    share = limits(task.samples.open_loop.parameters, _stage(point))[point.requirement]
    return point.gamma * point.limit / share


def _worst(task: Task, found: Mapping[str, Sequence[WorstPoint]]) -> tuple[dict[str, WorstPoint], dict[str, float]]:
    worst = {name: points[0] for name, points in found.items() if points}
    return worst, {name: _value(task, name, point) for name, point in worst.items()}


def _new(task: Task, found: Mapping[str, Sequence[WorstPoint]], descent: ResponseDescent) -> list[WorstPoint]:
    """Worst points above what the descent reached, the largest first; none if none of them is above 1."""
    values = [(_value(task, name, point), point) for name, points in found.items() for point in points]
    if not any(value > max(1.0, descent.value) * (1.0 + SLACK) for value, _ in values):
        return []
    excess = [entry for entry in values if entry[0] > descent.value * (1.0 + UNSEEN)]
    new: list[WorstPoint] = []

    def pair(point: WorstPoint) -> tuple[float, FloatArray]:
        return point.omega, task.samples.open_loop.point(dict(point.parameters))

    for _, point in sorted(excess, key=lambda entry: -entry[0]):
        same = [p for p in new if p.requirement == point.requirement and p.stage == point.stage]
        if len(new) < MAX_NEW and all(apart(pair(point), pair(p)) for p in same):
            new.append(point)
    return new


def _add(task: Task, state: RoundState, new: Sequence[WorstPoint]) -> None:
    """Sample new points on the whole grid, and closely around their frequency."""
    loop = task.samples.open_loop
    around = [(float(p.omega), _stable_point(task, state.x, loop.point(dict(p.parameters)))) for p in new]
    _sample(task, around)
    state.points += [at for _, at in around]
    state.around += around
    state.added.append(len(around))


def _stable_point(task: Task, x: FloatArray, point: FloatArray) -> FloatArray:
    """A point; where the loop is unstable there, the last stable one on the way from the nominal point.

    Gains are large beside the boundary of stability, so that a descent moves it away; beyond it they are small again.
    """
    loop, stable, nominal = task.samples.open_loop, 0.0, task.samples.open_loop.point({})
    if task.stable(x, loop.values(point)):
        return point
    for step in 0.5 ** np.arange(1, HALVINGS + 1):
        if task.stable(x, loop.values(nominal + (stable + step) * (point - nominal))):
            stable += step
    return np.asarray(nominal + stable * (point - nominal))


def _sample(task: Task, around: Sequence[tuple[float, FloatArray]]) -> None:
    """Sample the points that a round added: in the same order when a design goes on, for the same bits."""
    task.samples.add(np.array([at for _, at in around]))
    for omega, at in around:
        task.samples.add_around(omega, at)


def _tuned(problem: ResponseProblem, descent: ResponseDescent) -> dict[str, float]:
    names = [gain.name for gain in problem.gains] + [noise.name for noise in problem.noises]
    return dict(zip(names, np.concatenate([descent.values, descent.noise]).tolist()))


def _line(
    number: int,
    problem: ResponseProblem,
    descent: ResponseDescent,
    worst: Mapping[str, WorstPoint],
    values: Mapping[str, float],
    seconds: float,
) -> str:
    searched = ", ".join(f"{name} {values[name]:.3f} at {p.omega:.4g} rad/s" for name, p in worst.items())
    noise = ", ".join(f"{n.name} {v:.3f}" for n, v in zip(problem.noises, descent.noise))
    return (
        f"round {number}: {len(problem.samples)} samples, {descent.status} at {descent.value:.4f}, {noise}; "
        f"worst found: {searched or 'not searched'} ({seconds:.0f} s)"
    )
