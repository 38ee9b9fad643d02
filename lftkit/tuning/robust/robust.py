"""Robust structured design: rounds of tuning on a few models and a search for the worst others.

What enters is, of every requirement, one model for each of its highest peaks.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.support.progress import Progress
from lftkit.support.threads import one_thread
from lftkit.tuning.descent.single_start import tune_from
from lftkit.tuning.descent.starts import start_checked, start_sizes
from lftkit.tuning.feasibility import feasibility_runs
from lftkit.tuning.goals import Goal, resolved_build
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import Requirement
from lftkit.tuning.result import Round, TuningResult, WorstCase
from lftkit.tuning.robust.worst_case import Box, Build, WorstCaseOptions, worst_case
from lftkit.tuning.rounds import CUT, Worse, in_rounds
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.structures import Structure
from lftkit.tuning.tuner import (
    ALL_MET,
    TuningOptions,
    all_met,
    limits_from,
    limits_of,
    result_of,
    tune,
)


def tune_robust(
    build: Build,
    box: Box,
    requirements: Sequence[Requirement | Goal],
    structure: Structure,
    *,
    nominal: Mapping[str, float] | None = None,
    active: Sequence[Mapping[str, float]] = (),
    initial: Sequence[ArrayLike] = (),
    loop_delay: float = 0.0,
    slack: float = 0.01,
    met: float = -np.inf,
    max_rounds: int = 12,
    options: TuningOptions | None = None,
    search: WorstCaseOptions | None = None,
) -> TuningResult:
    """Tune `structure` so that the requirements hold for all parameters in `box`.

    Parameters
    ----------
    build : callable
        From parameter values by name to a :class:`System`.
    box : mapping of str to (lowest, highest)
    requirements, structure, initial, loop_delay
        As in :func:`lftkit.tuning.tune`.
    nominal : mapping, optional
        First active parameters; the middle of the box otherwise.
    active : sequence of mapping
        More parameters that are active from the beginning.
    slack : float
        A worst case counts only if it exceeds the tuned value, or the target, by more than this fraction.
    met : float
        Soft worst cases up to this value do not count: a target below it leaves a distance for the parameters
        between the models. A tuning whose certificate is at most that on all models is ``converged``.
    max_rounds : int
    options : TuningOptions, optional
        The first round uses all starts, later rounds go on from the best point. `wall_limit` is for the whole.
    search : WorstCaseOptions, optional

    Returns
    -------
    TuningResult
        Values and certificate are those of the active models, evaluations and iterations those of all rounds.
    """
    options, search = options or TuningOptions(), search or WorstCaseOptions()
    start_time = time.monotonic()
    middle = {name: 0.5 * (low + high) for name, (low, high) in box.items()}
    chosen = [dict(nominal) if nominal is not None else middle, *(dict(a) for a in active)]
    ready, needs = resolved_build(build, requirements, chosen[0])
    given = [start_checked(x, structure) for x in initial]
    with one_thread(), Progress("robust design", options.progress) as progress:
        common = (loop_delay, options, search, start_time, slack, met, chosen, given, progress)
        design = _Design(ready, box, needs, structure, *common)
        found = in_rounds(design, max_rounds, deadline=design.deadline)
    advice = _advice(found.status, found.tuned)
    return replace(
        found.tuned,
        status=found.status,
        advice=advice,
        seconds=time.monotonic() - start_time,
        evaluations=design.evaluations,
        iterations=design.iterations,
        worst=design.worst,
        active=tuple(chosen),
        rounds=tuple(design.rounds),
    )


@dataclass
class _Design:
    """Models at parameter values: worse is what the search over the box finds."""

    build: Build
    box: Box
    requirements: tuple[Requirement, ...]
    structure: Structure
    loop_delay: float
    options: TuningOptions
    search: WorstCaseOptions
    start_time: float
    slack: float
    met: float
    chosen: list[dict[str, float]]
    given: list[FloatArray]
    progress: Progress
    rounds: list[Round] = field(default_factory=list)
    worst: tuple[WorstCase, ...] = ()
    tuning: TuningResult | None = None
    evaluations: int = 0
    iterations: int = 0

    @property
    def deadline(self) -> float:
        """Of the whole."""
        return self.start_time + self.options.wall_limit

    @cached_property
    def problem(self) -> Problem:
        """With the models that are active."""
        models = [self.build(p).named(_label(p)) for p in self.chosen]
        problem = Problem(models, self.requirements, self.structure, loop_delay=self.loop_delay)
        problem.limit = limits_from(self.options, start_sizes(problem, self.given, self.options.seed))
        return problem

    def tuned(self, number: int) -> TuningResult:
        """All starts in the first round; later ones go on from the best point."""
        left, problem = max(self.deadline - time.monotonic(), 1.0), self.problem
        if self.tuning is None:
            options = replace(self.options, wall_limit=left, progress=False)
            common: Any = {"initial": self.given, "loop_delay": self.loop_delay, "options": options}
            self.tuning = self._judged(tune(problem.models, self.requirements, self.structure, **common))
            return self.tuning
        start_time, seed, band = time.monotonic(), self.options.seed, self.options.band
        limits = limits_of(self.options, start_time + left)
        runs = [tune_from(problem, self.tuning.x, seed, limits, band)]
        runs += feasibility_runs(problem, runs, seed, limits, band)
        self.tuning = self._judged(result_of(problem, runs, time.monotonic() - start_time))
        return self.tuning

    def _judged(self, tuning: TuningResult) -> TuningResult:
        """``converged`` where the certificate says that nothing above `met` is left on the models."""
        self.evaluations, self.iterations = self.evaluations + tuning.evaluations, self.iterations + tuning.iterations
        ended = tuning.status is TuningStatus.TARGET or tuning.status in CUT
        if ended or not all_met(self.requirements, tuning.certificate, self.met):
            return tuning
        return replace(tuning, status=TuningStatus.CONVERGED, advice=ALL_MET, stationarity=0.0)

    def worse(self, number: int, tuned: TuningResult, last: bool) -> Worse[dict[str, float]]:
        """Parameters at which a requirement exceeds what the tuning reached."""
        self.worst = self._worst(tuned, number)
        self.rounds.append(self._round(self.problem, tuned, self.worst))
        self.progress.print(_line(number, self.rounds[-1]))
        return Worse(self._new(tuned, self.worst), unfinished=tuned.status is TuningStatus.ITERATIONS)

    def add(self, tuned: TuningResult, worse: Worse[dict[str, float]]) -> None:
        """More models."""
        for parameters in worse.new:
            self.chosen.append(parameters)
            self.problem.add_model(self.build(parameters).named(_label(parameters)))

    def _worst(self, tuning: TuningResult, number: int) -> tuple[WorstCase, ...]:
        left = self.start_time + self.options.wall_limit - time.monotonic()
        effort = replace(
            self.search, seed=self.search.seed + number, wall_limit=max(1.0, min(self.search.wall_limit, left))
        )
        return worst_case(
            self.build, self.box, tuning.controller, self.requirements, loop_delay=self.loop_delay, options=effort
        )

    def _round(self, problem: Problem, tuning: TuningResult, worst: tuple[WorstCase, ...]) -> Round:
        soft = max((w.value for w, r in zip(worst, self.requirements) if not r.hard), default=-np.inf)
        hard = max((w.value for w, r in zip(worst, self.requirements) if r.hard), default=-np.inf)
        return Round(len(problem.models), tuning.soft, tuning.hard, soft, hard, time.monotonic() - self.start_time)

    def _new(self, tuning: TuningResult, worst: tuple[WorstCase, ...]) -> list[dict[str, float]]:
        new: list[dict[str, float]] = []
        for w, r in zip(worst, self.requirements):
            level = (max(1.0, tuning.hard) if r.hard else max(tuning.soft, self.options.target)) * (1.0 + self.slack)
            level = level if r.hard else max(level, self.met)
            for value, parameters in ((w.value, w.parameters), *w.others):
                if value > level and all(self._differs(parameters, c) for c in self.chosen + new):
                    new.append(dict(parameters))
        return new

    def _differs(self, a: Mapping[str, float], b: Mapping[str, float]) -> bool:
        return any(abs(a[n] - b[n]) > 1e-4 * (high - low) for n, (low, high) in self.box.items() if n in b)


def _label(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{k}={v:.6g}" for k, v in parameters.items())


def _line(number: int, r: Round) -> str:
    hard = "" if r.hard == -np.inf else f"; hard {r.hard:.4g}, worst {r.worst_hard:.4g}"
    return (
        f"round {number + 1}: {r.models} models, tuned {r.soft:.4g}, worst found {r.worst_soft:.4g}{hard} "
        f"({r.seconds:.0f} s)"
    )


def _advice(status: TuningStatus, tuning: TuningResult) -> str:
    if status is TuningStatus.CONVERGED:
        return "no worse parameters were found; a longer search or other seeds may still find some"
    return tuning.advice if status is tuning.status else status.advice
