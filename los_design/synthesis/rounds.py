"""Design in rounds: tune on samples, search the implemented loop for worse parameters, add them, repeat.

The descent (on :mod:`lftkit.tuning.responses`) sees the implemented loop at the frequencies and parameter points
of :mod:`los_design.synthesis.pair_problem`; the search (:mod:`los_design.search.worst_case_search`) sees it everywhere,
by ascents. What is added are the worst points of the bands in which a requirement exceeds what the descent reached. A
design is ``converged`` when a thorough search finds none.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.job import Job
from lftkit.tuning import Descent, DescentOptions, DescentState, TuningStatus, descend
from lftkit.tuning.responses import ResponseLook, ResponseProblem, ResponseSource
from lftkit.tuning.responses.source import soft_level
from lftkit.tuning.rounds import Worse, in_rounds
from los_design.search.worst_case_search import SearchOptions, apart
from los_design.search.worst_points import WorstPoint
from los_design.synthesis.pair_problem import ALONE, BOTH, STAGE_NAMES, named
from los_design.synthesis.provenance import commit
from los_design.synthesis.round_state import Outcome, RoundState
from los_design.synthesis.task import Task, first_points, sample_around, sample_peaks, stable_point

Report = Callable[[str], None]
MAX_NEW = 16
"""Points that a round adds at most."""
SLACK = 3e-3
"""A worst point counts only if it exceeds 1, or what the descent reached above 1, by more than this part."""
UNSEEN = 0.01
"""Where there is one, all points that exceed what the descent reached by this part are added; by :data:`SLACK` where
soft gains are minimised."""
NEAR = 0.9
"""Searches look at requirements above this part of the largest value; the last one of a round at all."""
MAX_HIDDEN = 12
"""Times that a design goes on for peaks of the nominal loop that its samples have missed."""
FAR_ABOVE = 2.0
"""Times what is tuned for. Above it nothing is searched: a descent that ended by itself ends the design, another one
goes on in the next round."""
TOLERANCE = 2e-3
"""A descent ends when four looks at all samples together lower the value by less than this part."""


@dataclass(frozen=True)
class Effort:
    """Limits of a design in rounds; they end it, not the time: otherwise the result depends on the machine.

    Parameters
    ----------
    rounds : int
    points : int
        Random parameter points of the first round: half of them corners.
    ends : bool
        Whether most parameters of the other half are at an end of their range; otherwise they are uniform in it.
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
    ends: bool = False


def design_in_rounds(
    task: Task,
    start: Callable[[], FloatArray],
    effort: Effort,
    report: Report = lambda text: None,
    job: Job | None = None,
) -> Outcome:
    """Tune, search, add, until the thorough search finds nothing worse or the rounds are over.

    While the nominal loop has peaks that were missed (:meth:`los_design.synthesis.task.Task.missed_peaks`), the rounds
    begin anew with samples at them, :data:`MAX_HIDDEN` times and within the wall limit.

    Parameters
    ----------
    task : Task
    start : callable
        Gives the entries of both gain matrices; they must stabilise the nominal telescope. Not called where a design
        goes on.
    effort : Effort
    report : callable
        Receives one line for each step.
    job : Job, optional
        Its record keeps the state in and after each descent and each search.
    """
    begin = time.monotonic()
    state = _begin(task, start, effort, report, job)
    while True:
        outcome = _in_rounds(_Design(task, state, effort, report, job, begin))
        if not (peaks := task.missed_peaks(outcome.x, outcome.tuned)):
            return outcome
        if time.monotonic() >= begin + task.wall_limit:
            return replace(outcome, status=TuningStatus.OUT_OF_TIME)
        if len(state.hidden) >= MAX_HIDDEN:
            return replace(outcome, status=TuningStatus.ROUNDS)
        at = ", ".join(f"{omega:.5g}" for omega in peaks)
        report(f"goes on: the nominal loop has peaks beside the samples at {at} rad/s")
        state.hidden.append((len(state.added), peaks))
        state.number, state.descent, state.searched, state.exceeded = 0, None, 0, []
        sample_peaks(task, peaks)
        state.save(job)


def _in_rounds(design: _Design) -> Outcome:
    """The rounds from a state."""
    task, state, effort = design.task, design.state, design.effort
    ended = in_rounds(design, effort.rounds, state.number - (state.descent is not None))
    worst, values = _worst(task, design.found)
    searched = design.searched(ended.tuned)
    status = TuningStatus.CONVERGED if searched and not ended.worse.goes_on else ended.status
    active = [task.samples.open_loop.values(p) for p in state.points]
    tuned = _tuned(task, design.problem, ended.tuned.point)
    return Outcome(state.x, status, tuned, worst, values, active, state.commits)


@dataclass
class _Design:
    """Samples at parameter points: worse is what the search of the implemented loop finds."""

    task: Task
    state: RoundState
    effort: Effort
    report: Report
    job: Job | None
    begin: float
    found: dict[str, list[WorstPoint]] = field(default_factory=dict)

    @cached_property
    def problem(self) -> ResponseProblem:
        """With the samples that are active."""
        return self.task.problem()

    def tuned(self, number: int) -> Descent[ResponseLook]:
        """The descent of a round; the one that is kept if its searches were not all made."""
        effort, state = self.effort, self.state
        if state.descent is None:
            options = DescentOptions(
                effort.iterations if number else effort.first,
                TOLERANCE,
                effort.target,
                self.begin + self.task.wall_limit,
                confirm=not effort.searches,
            )
            descended = _stabilising(self.task, self.problem, state, options, partial(self._step, number), self.job)
            if descended.status is TuningStatus.ITERATIONS and np.array_equal(descended.x, state.x):
                descended = replace(descended, status=TuningStatus.STALLED)  # another one would do the same
            state.descent = descended
            state.x, state.number, state.inside, state.watched = state.descent.x, number + 1, None, []
            state.save(self.job)
        return state.descent

    def _step(self, number: int, iteration: int, look: ResponseLook) -> None:
        self.report(f"round {number + 1}, step {iteration}: {look.merit[1]:.4f} ({self._seconds():.0f} s)")

    def _seconds(self) -> float:
        return time.monotonic() - self.begin

    def searched(self, tuned: Descent[ResponseLook]) -> bool:
        """Whether worse parameters are searched after a descent."""
        far = bool(self.problem.least_level) and tuned.point.value > FAR_ABOVE
        return bool(self.effort.searches) and not far

    def worse(self, number: int, tuned: Descent[ResponseLook], last: bool) -> Worse[WorstPoint]:
        """Worst points above what the descent reached."""
        ended = tuned.status not in (TuningStatus.OUT_OF_TIME, TuningStatus.ITERATIONS)
        if self.effort.searches and not self.searched(tuned):
            self.found = {}
            self.report(_far_above(_tuned(self.task, self.problem, tuned.point)))
            return Worse([], not ended)
        unfinished = tuned.point.value > self.problem.least_level and not ended
        searches = _searches(self.effort, self.state.searched, last, unfinished)
        self.found, new = _searched(self.task, self.state, self.problem, searches, self.job)
        line = _line(number + 1, self.problem, tuned, *_worst(self.task, self.found), self._seconds())
        self.report(line)
        return Worse(new, unfinished and bool(self.effort.searches))

    def add(self, tuned: Descent[ResponseLook], worse: Worse[WorstPoint]) -> None:
        """Sample the worst points."""
        state = self.state
        state.known |= {name: points[:3] for name, points in self.found.items()}
        state.exceeded = sorted({named(p.requirement, _stage(p)) for p in worse.new})
        if worse.new:
            _add(self.task, state, worse.new)
        state.descent, state.searched = None, 0
        vars(self).pop("problem", None)
        state.save(self.job)


def _begin(task: Task, start: Callable[[], FloatArray], effort: Effort, report: Report, job: Job | None) -> RoundState:
    """The state that a job has kept, or a new one; its parameter points are sampled."""
    state = RoundState.load(job)
    if state is None:
        state = RoundState(np.array(start(), dtype=float), points=first_points(task, effort.points, effort.ends))
    else:
        report(
            f"goes on after {state.number} rounds"
            + ", before the searches of the last" * bool(state.descent)
            + ", in the descent of the next" * bool(state.inside)
        )
    state.commits += [now for now in [commit()] if now not in state.commits]
    _sample_again(task, state)
    state.save(job)
    return state


def _sample_again(task: Task, state: RoundState) -> None:
    """Sample what a state has, in the order in which it came: for the same bits."""
    task.samples.add(np.array(state.points[: len(state.points) - sum(state.added)]))
    around = iter(state.around)
    for number in range(len(state.added) + 1):
        for peaks in (peaks for after, peaks in state.hidden if after == number):
            sample_peaks(task, peaks)
        if number < len(state.added):
            sample_around(task, [*islice(around, state.added[number])])


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
    job: Job | None,
) -> tuple[dict[str, list[WorstPoint]], list[WorstPoint]]:
    """Worst points by name, and those that are worse than what is known, of the first search that finds such."""
    assert state.descent is not None
    descent, worst = state.descent, {}
    for k, options, final in searches:
        near = {
            g.name: bool(final or v > NEAR * descent.point.value) for g, v in zip(problem.gains, descent.point.values)
        }
        if state.exceeded and not final:
            near = {name: name in state.exceeded for name in near}
        worst = _search(task, state.x, options, state.known, state.number, near)
        if new := _new(task, worst, problem, descent.point):
            return worst, new
        if not final:
            state.searched = k + 1
            state.save(job)
    return worst, []


def _stabilising(
    task: Task,
    problem: ResponseProblem,
    state: RoundState,
    options: DescentOptions,
    step: Callable[[int, ResponseLook], None],
    job: Job | None,
) -> Descent[ResponseLook]:
    """A descent that keeps stable what is; it is repeated with the parameter points at which its result is not."""
    loop = task.samples.open_loop
    state.watched = state.watched or [{}]

    def stable(x: FloatArray) -> bool:
        with ThreadPoolExecutor(task.workers.count) as pool:
            return all(pool.map(partial(task.stable, x), state.watched))

    def keep(inside: DescentState | None) -> None:
        state.inside = inside
        state.save(job)

    while True:
        descent = descend(ResponseSource(problem, stable), state.x, options, step, keep, state.inside)
        others = [v for v in map(loop.values, state.points) if v not in state.watched]
        with ThreadPoolExecutor(task.workers.count) as pool:
            there = list(pool.map(partial(task.stable, descent.x), others))
        lost = [v for v, stable_there in zip(others, there) if not stable_there and task.stable(state.x, v)]
        if not lost:
            return descent
        state.watched += lost[:3]
        keep(None)


def _search(
    task: Task,
    x: FloatArray,
    options: SearchOptions,
    known: Mapping[str, Sequence[WorstPoint]],
    number: int,
    near: Mapping[str, bool],
) -> dict[str, list[WorstPoint]]:
    """Worst points by name of the requirements that are near their limits; each round has a seed of its own."""
    worst = {}
    for stage in task.stages:
        seed = options.seed + 1000 * number + task.seed
        search = task.search(x, stage, replace(options, seed=seed))
        starts = [p for points in known.values() for p in points if p.stage == STAGE_NAMES[stage]]
        names = [n for n in task.limits(stage) if n in search.metrics and near[named(n, stage)]]
        worst.update({named(name, stage): points for name, points in search.run(names, starts, task.workers).items()})
    return worst


def _stage(point: WorstPoint) -> tuple[int, ...]:
    return BOTH if point.stage == STAGE_NAMES[BOTH] else ALONE


def _value(task: Task, name: str, point: WorstPoint) -> float:
    """Value of a worst point, 1 being the share or limit that is tuned for."""
    share = task.limits(_stage(point))[point.requirement]
    return point.gamma * point.limit / share


def _worst(
    task: Task, by_requirement: Mapping[str, Sequence[WorstPoint]]
) -> tuple[dict[str, WorstPoint], dict[str, float]]:
    worst = {name: points[0] for name, points in by_requirement.items() if points}
    return worst, {name: _value(task, name, point) for name, point in worst.items()}


def reached(problem: ResponseProblem, look: ResponseLook) -> dict[str, float]:
    """What a point reaches, by requirement: the largest value of all gains and noises.

    Where soft gains are to be as small as hard ones allow: the largest soft value, and for a hard gain its limit.
    """
    if problem.least_level:
        return {gain.name: look.value for gain in problem.gains}
    soft = soft_level(problem, look.values, look.noise)
    return {gain.name: 1.0 if gain.hard else soft for gain in problem.gains}


def _new(
    task: Task, by_requirement: Mapping[str, Sequence[WorstPoint]], problem: ResponseProblem, look: ResponseLook
) -> list[WorstPoint]:
    """Worst points above what the descent reached, the largest first; none if none of them is above the least level."""
    levels, least = reached(problem, look), problem.least_level
    values = [
        (_value(task, name, point), levels[name], point) for name, points in by_requirement.items() for point in points
    ]
    if not any(value > max(least, level) * (1.0 + SLACK) for value, level, _ in values):
        return []
    unseen = UNSEEN if least else SLACK
    excess = [(value, point) for value, level, point in values if value > level * (1.0 + unseen)]
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
    around = [(float(p.omega), stable_point(task, state.x, loop.point(dict(p.parameters)))) for p in new]
    sample_around(task, around)
    state.points += [at for _, at in around]
    state.around += around
    state.added.append(len(around))


def _tuned(task: Task, problem: ResponseProblem, look: ResponseLook) -> dict[str, float]:
    names = [gain.name for gain in problem.gains] + [noise.name for noise in problem.noises]
    return {name: task.of_limit(name, value) for name, value in zip(names, [*look.values, *look.noise], strict=True)}


def _far_above(values: Mapping[str, float]) -> str:
    above = sorted(((value, name) for name, value in values.items() if value > 1.0), reverse=True)
    shown = ", ".join(f"{name} {value:.3g}" for value, name in above)
    return (
        f"the best controllers so far are at {above[0][0]:.3g} times what is tuned for ({shown}); if this remains, "
        "relax these limits, or lower noise and disturbances"
    )


def _line(
    number: int,
    problem: ResponseProblem,
    descent: Descent[ResponseLook],
    worst: Mapping[str, WorstPoint],
    values: Mapping[str, float],
    seconds: float,
) -> str:
    searched = ", ".join(f"{name} {values[name]:.3f} at {p.omega:.4g} rad/s" for name, p in worst.items())
    noise = ", ".join(f"{n.name} {v:.3f}" for n, v in zip(problem.noises, descent.point.noise))
    return (
        f"round {number}: {len(problem.samples)} samples, {descent.status} at {descent.point.value:.4f}, {noise}; "
        f"worst found: {searched or 'not searched'} ({seconds:.0f} s)"
    )
