"""Runs the starts of a tuning run, in this process or in parallel ones, with the same result."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from lti.progress import Progress
from lti.threads import one_thread
from robust_design.descent import DescentOptions
from robust_design.problem import Problem
from robust_design.single_start import StartResult, screen, tune_from
from robust_design.status import TuningStatus

FloatArray = NDArray[np.float64]
Job = tuple[FloatArray, int]
Work = Callable[[Problem, FloatArray, int, DescentOptions, float], StartResult]

CARRIED = 6  # random starts that are carried on after the screening
SCREENING_SHARE = 0.5  # of the wall limit


def run_starts(
    problem: Problem,
    jobs: Sequence[Job],
    given: int,
    limits: DescentOptions,
    band: float,
    workers: int,
    progress: Progress,
) -> list[StartResult]:
    """The first `given` jobs and the best of the screened others, each to its end; results of all jobs, in order.

    Parameters
    ----------
    problem : Problem
    jobs : sequence of (start, seed)
    given : int
    limits : DescentOptions
        Of each start; the deadline is that of the whole.
    band : float
    workers : int
        Processes.
    progress : Progress
    """
    runner = _Runner(problem, limits, band, workers, progress)
    results = runner.run(_full, jobs[:given]) if given else []
    others = jobs[given:]
    if not others or runner.ended(results):
        return results
    carried = list(others)
    if len(others) > CARRIED:
        half = time.monotonic() + SCREENING_SHARE * (limits.deadline - time.monotonic())
        screened = runner.run(_screen, others, half)
        if runner.ended(screened):
            return results + screened
        order = sorted(range(len(screened)), key=lambda k: (screened[k].rank, k))[:CARRIED]
        carried = [(screened[k].x, others[k][1]) for k in order]
        results += screened
    return results + runner.run(_full, carried)


class _Runner:
    def __init__(self, problem: Problem, limits: DescentOptions, band: float, workers: int, progress: Progress) -> None:
        self._problem, self._limits, self._band = problem, limits, band
        self._workers, self._progress = workers, progress

    @staticmethod
    def ended(results: Sequence[StartResult]) -> bool:
        """The user stopped the run or the target was reached."""
        return any(r.status in (TuningStatus.INTERRUPTED, TuningStatus.TARGET) for r in results)

    def run(self, work: Work, jobs: Sequence[Job], deadline: float | None = None) -> list[StartResult]:
        """Results of the jobs that were begun before the deadline, in order."""
        limits = self._limits if deadline is None else replace(self._limits, deadline=deadline)
        return (
            self._serial(work, jobs, limits)
            if self._workers == 1 or len(jobs) == 1
            else self._parallel(work, jobs, limits)
        )

    def _serial(self, work: Work, jobs: Sequence[Job], limits: DescentOptions) -> list[StartResult]:
        results: list[StartResult] = []
        for x, seed in jobs:
            try:
                results.append(work(self._problem, x, seed, limits, self._band))
            except KeyboardInterrupt:
                results.append(_interrupted(self._problem, x))
            self._progress.report(len(results), len(jobs), best=min(r.soft for r in results))
            if self.ended(results) or time.monotonic() > limits.deadline:
                break
        return results

    def _parallel(self, work: Work, jobs: Sequence[Job], limits: DescentOptions) -> list[StartResult]:
        results: dict[int, StartResult] = {}
        left = limits.deadline - time.monotonic()
        pool = ProcessPoolExecutor(min(self._workers, len(jobs)), mp_context=get_context("spawn"))
        with pool:
            futures = {
                pool.submit(_remote, work, self._problem, x, seed, limits, left, self._band): k
                for k, (x, seed) in enumerate(jobs)
            }
            try:
                for future in as_completed(futures):
                    results[futures[future]] = future.result()
                    best = min(r.soft for r in results.values())
                    self._progress.report(len(results), len(jobs), best=best)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                found = list(results.values()) or [_interrupted(self._problem, jobs[0][0])]
                return [replace(min(found, key=lambda r: r.rank), status=TuningStatus.INTERRUPTED)]
        return [results[k] for k in sorted(results)]


def _full(problem: Problem, x: FloatArray, seed: int, limits: DescentOptions, band: float) -> StartResult:
    return tune_from(problem, x, seed, limits, band)


def _screen(problem: Problem, x: FloatArray, seed: int, limits: DescentOptions, band: float) -> StartResult:
    return screen(problem, x, seed, limits)


def _remote(
    work: Work, problem: Problem, x: FloatArray, seed: int, limits: DescentOptions, left: float, band: float
) -> StartResult:
    with one_thread():
        return work(problem, x, seed, replace(limits, deadline=time.monotonic() + left), band)


def _interrupted(problem: Problem, x: FloatArray) -> StartResult:
    return StartResult(TuningStatus.INTERRUPTED, x, np.inf, np.inf, problem.abscissa(x), np.inf, 0, 0)
