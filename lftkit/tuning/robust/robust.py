"""Robust structured design: rounds of tuning on a few models and a search for the worst others.

What enters is, of every requirement, one model for each of its highest peaks.

The wall limit is shared, by default as follows. A third of it is for the given starts in the first round, or for the
first random one where none is given: what they get is the same with further starts as without. Another third is for
all further starts. A later round tunes for at most half of the time that is left. What a share does not need, those
after it have. The best two ends of the first round are searched for worse parameters, both are tuned on all that were
found, and the better of them goes on.
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
from lftkit.errors import InputError
from lftkit.support.progress import Progress
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked
from lftkit.tuning.descent.grid_source import FEASIBLE
from lftkit.tuning.descent.single_start import tune_from
from lftkit.tuning.descent.starts import start_checked, start_sizes
from lftkit.tuning.feasibility import feasibility_runs
from lftkit.tuning.goals import Goal, resolved_build
from lftkit.tuning.lexicographic import tuned_in_order
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.result import Round, TuningResult, WorstCase
from lftkit.tuning.robust.worst_case import Box, Build, WorstCaseOptions, worst_case
from lftkit.tuning.rounds import CUT, Worse, in_rounds
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.structures import Structure
from lftkit.tuning.tuner import ALL_MET, all_met, limits_from, limits_of, result_of, tune


@checked
@dataclass(frozen=True)
class RobustOptions:
    """Limits of a robust design.

    Parameters
    ----------
    tuning : TuningOptions
        The first round uses all starts, later rounds go on from the best points of the first, then from the best one.
        `wall_limit` is for the whole, and shared: a start that its share ends goes on in the next round, and the
        result depends on the clock then. A start that fails is left.
        Soft worst cases up to `met` do not count: a target below it leaves a distance for the parameters between the
        models. A tuning whose certificate is at most that on all models is ``converged``.
    search : WorstCaseOptions
        Of the search for worse parameters after each round.
    slack : float
        A worst case counts only if it exceeds the tuned value, or the target, by more than this fraction.
    max_rounds : int
    first_share : float
        Part of the wall limit for the given starts in the first round, and for all further ones.
    round_share : float
        Part of the time left that the tuning of a later round may take.
    carried : int
        Most ends of the first round that are searched for worse parameters, and go on.
    """

    tuning: TuningOptions = field(default_factory=TuningOptions)
    search: WorstCaseOptions = field(default_factory=WorstCaseOptions)
    slack: float = 0.01
    max_rounds: int = 12
    first_share: float = 1.0 / 3.0
    round_share: float = 0.5
    carried: int = 2

    def __post_init__(self) -> None:
        if not self.slack >= 0.0:
            raise InputError(f"slack must be zero or positive, got {self.slack}")
        if self.max_rounds < 1 or self.carried < 1:
            raise InputError(f"expected max_rounds >= 1 and carried >= 1, got {self.max_rounds} and {self.carried}")
        if not (0.0 < self.first_share <= 1.0 and 0.0 < self.round_share <= 1.0):
            raise InputError(
                f"first_share and round_share must be above 0 and at most 1, got {self.first_share} and "
                f"{self.round_share}"
            )


@checked
def tune_robust(
    build: Build,
    box: Box,
    requirements: Sequence[TuningRequirement | Goal],
    structure: Structure,
    *,
    active: Sequence[Mapping[str, float]] = (),
    initial: Sequence[ArrayLike] = (),
    loop_delay: float = 0.0,
    options: RobustOptions | None = None,
) -> TuningResult:
    """Tune `structure` so that the requirements hold for all parameters in `box`.

    Parameters
    ----------
    build : callable
        From parameter values by name to a :class:`System`.
    box : mapping of str to (lowest, highest)
    requirements, structure, initial, loop_delay
        As in :func:`lftkit.tuning.tune`.
    active : sequence of mapping
        Parameters that are active from the beginning; the middle of the box where none is given. Goals take the ports
        of the first of them.
    options : RobustOptions, optional

    Returns
    -------
    TuningResult
        Values and certificate are those of the active models, evaluations and iterations those of all rounds, starts
        those of the first round.

    Raises
    ------
    ValueError
        Options of another class; as :func:`lftkit.tuning.tune`.
    """
    options = options or RobustOptions()
    if not isinstance(options, RobustOptions):
        raise InputError(f"options must be RobustOptions, got {type(options).__name__}")
    start_time = time.monotonic()
    middle = {name: 0.5 * (low + high) for name, (low, high) in box.items()}
    chosen = [dict(parameters) for parameters in active] or [middle]
    ready, needs = resolved_build(build, requirements, chosen[0])
    starting = [start_checked(x, structure) for x in initial]
    if options.tuning.lexicographic:
        return _in_order(ready, box, needs, structure, loop_delay, options, chosen, starting)
    with one_thread(), Progress("robust design", options.tuning.progress) as progress:
        design = _Design(ready, box, needs, structure, loop_delay, options, start_time, chosen, starting, progress)
        ended = in_rounds(design, options.max_rounds, deadline=design.deadline)
    advice = _advice(ended.status, ended.tuned, design.starts)
    return replace(
        ended.tuned,
        status=ended.status,
        advice=advice,
        seconds=time.monotonic() - start_time,
        evaluations=design.evaluations,
        iterations=design.iterations,
        starts=design.starts,
        worst=design.worst,
        active=tuple(chosen),
        rounds=tuple(design.rounds),
    )


def _in_order(
    build: Build,
    box: Box,
    requirements: Sequence[TuningRequirement],
    structure: Structure,
    loop_delay: float,
    whole: RobustOptions,
    active: Sequence[Mapping[str, float]],
    starting: Sequence[FloatArray],
) -> TuningResult:
    """Level by level; the models that one level has made active remain so."""
    models = list(active)

    def run(
        requirements: Sequence[TuningRequirement],
        structure: Structure,
        *,
        initial: Sequence[FloatArray],
        options: TuningOptions,
    ) -> TuningResult:
        rounds = whole.max_rounds if structure.size else 1  # one controller is searched once
        of_level = replace(whole, tuning=options, max_rounds=rounds)
        common: Any = {"active": models, "loop_delay": loop_delay, "options": of_level}
        result = tune_robust(build, box, requirements, structure, initial=initial, **common)
        models[:] = result.active
        return result

    return tuned_in_order(run, requirements, structure, starting, whole.tuning, whole.slack)


@dataclass
class _Design:
    """Models at parameter values: worse is what the search over the box finds."""

    build: Build
    box: Box
    requirements: tuple[TuningRequirement, ...]
    structure: Structure
    loop_delay: float
    options: RobustOptions
    start_time: float
    chosen: list[dict[str, float]]
    given: list[FloatArray]
    progress: Progress
    rounds: list[Round] = field(default_factory=list)
    worst: tuple[WorstCase, ...] = ()
    carried: list[TuningResult] = field(default_factory=list)
    searched: list[tuple[WorstCase, ...]] = field(default_factory=list)
    starts: tuple[float, ...] = ()
    evaluations: int = 0
    iterations: int = 0

    @property
    def deadline(self) -> float:
        """Of the whole."""
        return self.start_time + self.options.tuning.wall_limit

    @cached_property
    def problem(self) -> Problem:
        """With the models that are active."""
        models = [self.build(p).named(_label(p)) for p in self.chosen]
        problem = Problem(models, self.requirements, self.structure, loop_delay=self.loop_delay)
        problem.limit = limits_from(self.options.tuning, start_sizes(problem, self.given, self.options.tuning.seed))
        return problem

    def tuned(self, number: int) -> TuningResult:
        """All starts in the first round, of which the best go on; later the best of those. By the worst found."""
        first = not self.carried
        runs = sorted(self._first_round() if first else self._gone_on(), key=_rank)
        kept = [runs[0], *(run for run in runs[1:] if first and _another(run, runs[0]))][: self.options.carried]
        judged = [(self._worst(run, number), run) for run in kept[:1]]
        judged += [(self._worst(run, number), run) for run in kept[1:] if time.monotonic() < self.deadline]
        judged.sort(key=lambda pair: self._merit(pair[0]))
        self.carried, self.searched = [run for _, run in judged], [worst for worst, _ in judged]
        return self.carried[0]

    def _gone_on(self) -> list[TuningResult]:
        runs: list[TuningResult] = []
        for run in self.carried:
            runs.append(self._again(run))
            if runs[-1].status is TuningStatus.INTERRUPTED:
                break
        return runs

    def _first_round(self) -> list[TuningResult]:
        """The given starts, or the first random one, as they would be alone, and the further ones."""
        whole, share = self.options.tuning, self.options.first_share
        # on some of the models less than `met` leaves a distance for the parameters between them
        options = replace(whole, wall_limit=share * whole.wall_limit, met=-np.inf, progress=False)
        alone = replace(options, starts=0 if self.given else min(options.starts, 1))
        runs = [self._started(self.given, alone)]
        count = options.starts - alone.starts if self.structure.size else 0
        # No further start is wanted where one was interrupted or at the target, or left nothing to lower
        enough = runs[0].soft == -np.inf or runs[0].advice == ALL_MET
        enough = enough and runs[0].status is TuningStatus.CONVERGED
        ended = runs[0].status in (TuningStatus.TARGET, TuningStatus.INTERRUPTED)
        if count and not (enough or ended) and time.monotonic() < self.deadline:
            runs.append(self._started((), replace(options, starts=count, seed=options.seed + alone.starts)))
        self.starts = tuple(value for run in runs for value in run.starts)
        self.problem.least = runs[0].lower_bound  # and so that of more models
        return runs

    def _started(self, starting: Sequence[FloatArray], options: TuningOptions) -> TuningResult:
        left = max(min(options.wall_limit, self.deadline - time.monotonic()), 1.0)
        common: Any = {"loop_delay": self.loop_delay, "options": replace(options, wall_limit=left)}
        return self._judged(tune(self.problem.models, self.requirements, self.structure, initial=starting, **common))

    def _again(self, tuning: TuningResult) -> TuningResult:
        """A tuning gone on with, on all models that are active, in its share of the time left."""
        tuning_options, problem, start_time = self.options.tuning, self.problem, time.monotonic()
        seed, band = tuning_options.seed, tuning_options.band
        share = max(self.options.round_share * (self.deadline - start_time), 1.0)
        limits = limits_of(tuning_options, start_time + share)
        runs = [tune_from(problem, tuning.x, seed, limits, band)]
        runs += feasibility_runs(problem, runs, seed, limits, band)
        return self._judged(result_of(problem, runs, time.monotonic() - start_time))

    def _merit(self, worst: Sequence[WorstCase]) -> tuple[float, float]:
        """Violation of the hard requirements and largest soft value, of the worst cases."""
        soft, hard = self._largest(worst)
        return hard if hard > 1.0 + FEASIBLE else 0.0, soft

    def _largest(self, worst: Sequence[WorstCase]) -> tuple[float, float]:
        soft = max((w.value for w, r in zip(worst, self.requirements) if not r.hard), default=-np.inf)
        return soft, max((w.value for w, r in zip(worst, self.requirements) if r.hard), default=-np.inf)

    def _judged(self, tuning: TuningResult) -> TuningResult:
        """``converged`` where the certificate says that nothing above `met` is left on the models."""
        self.evaluations, self.iterations = self.evaluations + tuning.evaluations, self.iterations + tuning.iterations
        if tuning.status is TuningStatus.OUT_OF_TIME and time.monotonic() < self.deadline:  # of a share alone
            tuning = replace(tuning, status=TuningStatus.ITERATIONS, advice=TuningStatus.ITERATIONS.advice)
        ended = tuning.status is TuningStatus.TARGET or tuning.status in CUT
        if ended or not all_met(self.requirements, tuning.certificate, self.options.tuning.met):
            return tuning
        return replace(tuning, status=TuningStatus.CONVERGED, advice=ALL_MET, stationarity=0.0)

    def worse(self, number: int, tuned: TuningResult, last: bool) -> Worse[dict[str, float]]:
        """Parameters at which a requirement exceeds what the tuning reached."""
        self.worst = self.searched[0]
        soft, hard = self._largest(self.worst)
        elapsed = time.monotonic() - self.start_time
        ended = Round(len(self.problem.models), tuned.soft, tuned.hard, soft, hard, elapsed)
        self.rounds.append(ended)
        of_hard = "" if ended.hard == -np.inf else f"; hard {ended.hard:.4g}, worst {ended.worst_hard:.4g}"
        self.progress.print(
            f"round {number + 1}: {ended.models} models, tuned {ended.soft:.4g}, worst found {ended.worst_soft:.4g}"
            f"{of_hard} ({ended.seconds:.0f} s)"
        )
        new = self._new(tuned, self.worst)
        for run, worst in zip(self.carried[1:], self.searched[1:]):
            new += self._new(run, worst, new) if new else []
        return Worse(new, unfinished=tuned.status is TuningStatus.ITERATIONS)

    def add(self, tuned: TuningResult, worse: Worse[dict[str, float]]) -> None:
        """More models."""
        for parameters in worse.new:
            self.chosen.append(parameters)
            self.problem.add_model(self.build(parameters).named(_label(parameters)))

    def _worst(self, tuning: TuningResult, number: int) -> tuple[WorstCase, ...]:
        left, search = self.deadline - time.monotonic(), self.options.search
        effort = replace(search, seed=search.seed + number, wall_limit=max(1.0, min(search.wall_limit, left)))
        cases = worst_case(
            self.build, self.box, tuning.controller, self.requirements, loop_delay=self.loop_delay, options=effort
        )
        return tuple(self._or_active(w, tuning, i) for i, w in enumerate(cases))

    def _or_active(self, worst: WorstCase, tuning: TuningResult, i: int) -> WorstCase:
        """What a search found, or an active model that is worse: a search that the time ends may not come so far."""
        k = int(np.argmax(tuning.values[i]))
        value, omega = float(tuning.values[i, k]), float(tuning.peak_frequencies[i, k])
        return worst if worst.value >= value else replace(worst, value=value, omega=omega, parameters=self.chosen[k])

    def _new(
        self, tuning: TuningResult, worst: tuple[WorstCase, ...], known: Sequence[dict[str, float]] = ()
    ) -> list[dict[str, float]]:
        new: list[dict[str, float]] = []
        options = self.options.tuning
        for w, r in zip(worst, self.requirements):
            level = max(1.0, tuning.hard) if r.hard else max(tuning.soft, options.target)
            level *= 1.0 + self.options.slack
            level = level if r.hard else max(level, options.met)
            for value, parameters in ((w.value, w.parameters), *w.others):
                if value > level and all(self._differs(parameters, c) for c in [*self.chosen, *known, *new]):
                    new.append(dict(parameters))
        return new

    def _differs(self, a: Mapping[str, float], b: Mapping[str, float]) -> bool:
        return any(abs(a[n] - b[n]) > 1e-4 * (high - low) for n, (low, high) in self.box.items() if n in b)


def _label(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{k}={v:.6g}" for k, v in parameters.items())


def _rank(tuning: TuningResult) -> tuple[int, float]:
    """From the best to the worst: feasible ones by value, then by violation, then by instability."""
    if tuning.certificate is None:
        return 2, tuning.abscissa
    return (0, tuning.soft) if tuning.feasible else (1, tuning.hard)


def _another(tuning: TuningResult, best: TuningResult) -> bool:
    """Worth being searched beside the best: as feasible as it, and not the same."""
    (kind, value), (least, lowest) = _rank(tuning), _rank(best)
    return kind == least < 2 and abs(value - lowest) > 1e-4 * abs(lowest)


def _advice(status: TuningStatus, tuning: TuningResult, starts: tuple[float, ...]) -> str:
    lost = sum(np.isposinf(starts))
    left = f"; {lost} of {len(starts)} starts ended without a feasible point" if lost else ""
    if status is TuningStatus.CONVERGED:
        return f"no worse parameters were found; a longer search or other seeds may still find some{left}"
    return (tuning.advice if status is tuning.status else status.advice) + left
