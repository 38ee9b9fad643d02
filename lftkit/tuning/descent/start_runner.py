"""Runs the starts of a tuning run, in this process or in parallel ones, with the same result.

Given starts run first, then batches of random ones: all of a batch are screened in short rounds and the best carried
on. Batches follow until one finds nothing better, or until most of the starts of one end at the same value (Boender and
Rinnooy Kan 1987: many descents that end at one minimum make another one unlikely). What is done depends on the work
only, never on the clock: the deadline is a cap, and :attr:`StartSearch.complete` says whether it was reached.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from lftkit.support.progress import Progress
from lftkit.support.workers import Workers
from lftkit.tuning.descent.direct_search import (
    direct_cycles,
    direct_polish,
    direct_restarts,
    direct_screen,
    perturbed,
)
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.single_start import (
    ARITHMETIC,
    SMOOTH_EVALUATIONS,
    StartResult,
    failed,
    screen,
    tune_from,
)
from lftkit.tuning.descent.smooth_phase import negligible_value
from lftkit.tuning.descent.starts import Start
from lftkit.tuning.problem import Problem
from lftkit.tuning.status import TuningStatus

Work = Callable[[Problem, Start, DescentOptions, float], StartResult]

CARRIED = 6  # starts of a batch that are carried on after the screening; no more batches than one with so few starts
MAX_BATCHES = 20
VANISHING = 10.0  # times the value that counts as zero: below it the infimum is zero, and only approached
PERTURBATIONS = -2.0, 0.0  # decades of the relative size of a perturbation of the best point
BETTER = 1e-4  # relative decrease that counts as something better
FIRST = 8  # starts of the first batch that are screened before the others
PORTION, CARRIED_OF_PORTION = 4, 2  # starts of a first look that are screened together, and those carried on
DESCENDED = 0.7  # of the time for the smooth phases of few starts
AGREED = 0.5, 4  # part of the screened random starts, or number of those carried on, whose ends make further ones idle
SAME = 1e-4  # relative difference of values after the screening up to which two starts count as one


@dataclass(frozen=True)
class StartSearch:
    """Results of the starts that were begun, whether those were all, and whether no other start is worth beginning."""

    results: tuple[StartResult, ...]
    complete: bool
    ended: bool = False

    @property
    def best(self) -> StartResult:
        """The best; of equal ones the first."""
        return min(self.results, key=lambda run: run.rank)


def run_starts(
    problem: Problem,
    first: Sequence[Start],
    batch: Callable[[int], Sequence[Start]],
    limits: DescentOptions,
    band: float,
    workers: int,
    progress: Progress,
    batches: int = MAX_BATCHES,
) -> StartSearch:
    """The given starts, then batches of others until one finds nothing better.

    Parameters
    ----------
    problem : Problem
    first : sequence of Start
    batch : callable
        The starts of a batch by its number; empty where there are none.
    limits : DescentOptions
        Of each start; the deadline is that of the whole.
    band : float
    workers : int
        Processes.
    progress : Progress
    batches : int
        Most batches.
    """
    runner = _Runner(problem, limits, band, workers, progress)
    direct = ExactValue.suits(problem)
    runner.run(direct_polish if direct and batch(0) else _full, first)
    for number in range(batches):
        starts = batch(number)
        if not starts or not runner.going_on or (direct and _vanished(runner)):
            break
        before = min((r.rank for r in runner.results), default=(3, np.inf))
        few, agreed = len(starts) <= CARRIED, False
        if few:
            runner.run_shared(starts)
        elif direct:
            mixed = _with_perturbed(starts, runner.results)
            agreed = _run_batch(runner, mixed, direct_screen, direct_polish, FIRST if not number else len(mixed))
            if runner.best.rank[0] != 2:
                runner.run(direct_restarts, [Start(starts[0].seed, runner.best.x)])
        else:
            agreed = _run_batch(runner, starts, _screened, _full, FIRST if not number else len(starts))
        after = min((r.rank for r in runner.results), default=(3, np.inf))
        fruitless = after[0] == before[0] and not after[1] < before[1] - BETTER * abs(before[1])
        if few or agreed or (number and fruitless):
            break
    unfinished = direct and bool(runner.results) and runner.best.status is TuningStatus.ITERATIONS
    if unfinished and batches > 1 and runner.best.soft > VANISHING * runner.floor:
        runner.run(_full, [Start(0, runner.best.x)])
    return runner.found()


def run_given(
    problem: Problem,
    starts: Sequence[Start],
    work: Work,
    limits: DescentOptions,
    band: float,
    workers: int,
    progress: Progress,
) -> StartSearch:
    """The given starts alone, each by the work. The other parameters are those of :func:`run_starts`."""
    runner = _Runner(problem, limits, band, workers, progress)
    runner.run(work, starts)
    return runner.found()


def run_first(
    problem: Problem,
    starts: Sequence[Start],
    limits: DescentOptions,
    band: float,
    workers: int,
    progress: Progress,
) -> StartSearch:
    """A few starts at a time are screened and the best of them carried on, on the exact value.

    So the best value falls soon, also where one start takes seconds. Parameters are those of :func:`run_starts`.
    """
    runner = _Runner(problem, limits, band, workers, progress)
    for begin in range(0, len(starts), PORTION):
        portion = starts[begin : begin + PORTION]
        runner.run(direct_cycles, _carried(portion, runner.run(direct_screen, portion), CARRIED_OF_PORTION))
    return runner.found()


def _with_perturbed(starts: Sequence[Start], results: Sequence[StartResult]) -> list[Start]:
    """The starts of a batch, every second one replaced by a perturbed copy of the best point so far."""
    best = min(results, key=lambda run: run.rank, default=None)
    if best is None or best.rank[0] == 2:
        return list(starts)
    changed = []
    for start in starts:
        if start.number % 2:
            rng = np.random.default_rng(start.seed)
            changed.append(replace(start, x=perturbed(best.x, PERTURBATIONS, rng)))
        else:
            changed.append(start)
    return changed


def _run_batch(runner: _Runner, starts: Sequence[Start], first: Work, second: Work, portion: int) -> bool:
    """Starts by the work `first`, the best that differ carried on by `second`; whether most end at the best value.

    Those after the first `portion` only if these do not agree.
    """
    screened = runner.run(first, starts[:portion])
    if not _most_agree(runner, starts, screened):
        screened += runner.run(first, starts[portion:])
    if not runner.going_on:
        return False
    ends = runner.run(second, _carried(starts, screened))
    return _most_agree(runner, starts, screened) or _agreeing(runner, ends) >= AGREED[1]


def _carried(starts: Sequence[Start], screened: Sequence[StartResult], most: int = CARRIED) -> list[Start]:
    """The best that differ, at most so many, from where their screening ended; unstable ones where no other is."""
    carried: list[Start] = []
    ranks: list[tuple[int, float]] = []
    for k in sorted(range(len(screened)), key=lambda k: (screened[k].rank, k)):
        kind, value = screened[k].rank
        if kind == 2 and ranks and ranks[0][0] < 2:
            break
        if len(carried) < most and not any(
            kind == other[0] and abs(value - other[1]) <= SAME * abs(value) for other in ranks
        ):
            ranks.append((kind, value))
            carried.append(Start(starts[k].seed, screened[k].x))
    return carried


def _most_agree(runner: _Runner, starts: Sequence[Start], screened: Sequence[StartResult]) -> bool:
    """Most of the random starts ended at the best value so far."""
    random = [result for start, result in zip(starts, screened) if start.x is None]
    return len(random) >= AGREED[1] and _agreeing(runner, random) >= max(AGREED[0] * len(random), AGREED[1])


def _agreeing(runner: _Runner, results: Sequence[StartResult]) -> int:
    """Number of results that have the best value so far and meet all hard requirements."""
    best = min((r.soft for r in runner.results if r.rank[0] == 0), default=-np.inf)
    level = best + SAME * abs(best) if np.isfinite(best) else best
    return sum(r.rank[0] == 0 and r.soft <= level for r in results)


def _vanished(runner: _Runner) -> bool:
    """The best value so far counts as zero: no start finds a lower one."""
    return any(r.rank[0] == 0 and r.soft <= runner.floor for r in runner.results)


class _Runner:
    """Results so far, and whether every start was begun."""

    def __init__(self, problem: Problem, limits: DescentOptions, band: float, workers: int, progress: Progress) -> None:
        self._problem, self._limits, self._band = problem, limits, band
        self._workers, self._progress = workers, progress
        self.results: list[StartResult] = []
        self.complete = True

    @cached_property
    def floor(self) -> float:
        """Value that counts as zero."""
        return negligible_value(self._problem)

    @property
    def going_on(self) -> bool:
        """Neither was a limit reached nor the run stopped by the user or by its target."""
        return self.complete and not self._ended(self.results)

    def found(self) -> StartSearch:
        """What there is so far."""
        return StartSearch(tuple(self.results), self.complete, self._ended(self.results))

    def _ended(self, results: Sequence[StartResult]) -> bool:
        """No other start is worth beginning: also where gains grew to their limit and the value to what counts as zero.

        The problem lacks a requirement then, whichever start finds the lowest value.
        """
        grown = any(r.status is TuningStatus.UNBOUNDED and r.rank <= (0, self.floor) for r in results)
        return grown or ended(results)

    @property
    def best(self) -> StartResult:
        """The best so far; of equal ones the first."""
        return min(self.results, key=lambda run: run.rank)

    def run(self, work: Work, starts: Sequence[Start], share: float | None = None) -> list[StartResult]:
        """Results of the starts begun before the deadline, in order, each with its part of a share of the time.

        Parts of the time left are equal: what one start does not need, those after it have. Without a share any start
        may take all of it.
        """
        if not starts or not self.going_on:
            return []
        serial = self._workers == 1 or len(starts) == 1
        new = self._serial(work, starts, share) if serial else self._parallel(work, starts, share)
        self.complete = time.monotonic() <= self._limits.deadline
        self.results += new
        return new

    def run_shared(self, starts: Sequence[Start]) -> None:
        """Starts to their ends, each with its part of the time; where that ended the best, it goes on in the rest.

        Those that a smooth phase leads to the same value count as one.
        """
        several = len(starts) > 1
        differing = _carried(starts, self.run(_descended, starts, DESCENDED)) if several else starts
        self.run(_full, differing, 1.0)
        if self.results and self.going_on and self.best.status is TuningStatus.OUT_OF_TIME:
            self.run(_full, [Start(starts[0].seed, self.best.x)])

    def _within(self, deadline: float, parts: int) -> DescentOptions:
        """Limits with the first of so many equal parts of the time left until `deadline`."""
        now = time.monotonic()
        return replace(self._limits, deadline=deadline if parts <= 1 else now + (deadline - now) / parts)

    def _end(self, share: float | None) -> float:
        """The deadline, or that of a share of the time left."""
        now, deadline = time.monotonic(), self._limits.deadline
        return deadline if share is None else now + share * (deadline - now)

    def _serial(self, work: Work, starts: Sequence[Start], share: float | None) -> list[StartResult]:
        results: list[StartResult] = []
        end = self._end(share)
        for k, start in enumerate(starts):
            try:
                limits = self._within(end, len(starts) - k if share is not None else 1)
                results.append(_attempted(work, self._problem, start, limits, self._band))
            except KeyboardInterrupt:
                results.append(_interrupted(self._problem, start))
            self._progress.report(len(results), len(starts), best=min(r.soft for r in results))
            if self._ended(results) or time.monotonic() > self._limits.deadline:
                break
        return results

    def _parallel(self, work: Work, starts: Sequence[Start], share: float | None) -> list[StartResult]:
        results: list[StartResult] = []
        count = min(self._workers, len(starts))
        rounds = -(-len(starts) // count) if share is not None else 1  # of the processes, one after another
        first = self._within(self._end(share), rounds).deadline
        part = first - time.monotonic() if rounds > 1 else 0.0
        deadlines = [first + (k // count) * part if k >= count else first for k in range(len(starts))]
        limits = [replace(self._limits, deadline=deadline) for deadline in deadlines]
        remote = partial(_remote, work, self._problem, self._band)
        try:
            with Workers(count) as workers:
                for result in workers.each(remote, list(zip(range(len(starts)), starts, limits))):
                    if result is not None:
                        results.append(result)
                    self._progress.report(len(results), len(starts), best=min(r.soft for r in results))
        except KeyboardInterrupt:
            all_results = results or [_interrupted(self._problem, starts[0])]
            return [replace(min(all_results, key=lambda r: r.rank), status=TuningStatus.INTERRUPTED)]
        ends = [k for k, r in enumerate(results) if self._ended([r])]
        return results[: ends[0] + 1] if ends else results  # those that one process would have run


def ended(results: Sequence[StartResult]) -> bool:
    """The user stopped the run, the target was reached, or a feasible point is all that is asked for."""
    return any(r.settled or r.status in (TuningStatus.INTERRUPTED, TuningStatus.TARGET) for r in results)


def _attempted(work: Work, problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """Result of a start; where its arithmetic fails, too, so that the other starts keep theirs."""
    try:
        return work(problem, start, limits, band)
    except ARITHMETIC as error:
        return failed(np.zeros(problem.structure.size) if start.x is None else start.x, error)


def _full(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    return tune_from(problem, start.parameters(problem), start.seed, limits, band)


def while_feasible(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """To the end, unless the smooth phases end with a hard requirement violated."""
    return tune_from(problem, start.parameters(problem), start.seed, limits, band, while_infeasible=False)


def while_infeasible(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """From where :func:`while_feasible` has ended so."""
    return tune_from(problem, start.parameters(problem), start.seed, limits, band, smooth=False)


def _screened(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    return screen(problem, start.parameters(problem), start.seed, limits)


def _descended(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    return screen(problem, start.parameters(problem), start.seed, limits, SMOOTH_EVALUATIONS)


def _remote(work: Work, problem: Problem, band: float, item: tuple[int, Start, DescentOptions]) -> StartResult | None:
    """In another process, whose steady clock is this one's: nothing is begun after the deadline but the first start."""
    number, start, limits = item
    if number and time.monotonic() > limits.deadline:
        return None
    return _attempted(work, problem, start, limits, band)


def _interrupted(problem: Problem, start: Start) -> StartResult:
    x = start.parameters(problem)
    return StartResult(TuningStatus.INTERRUPTED, x, np.inf, np.inf, problem.abscissa(x), np.inf, 0, 0)
