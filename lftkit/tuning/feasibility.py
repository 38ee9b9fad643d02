"""Before a problem is called infeasible: the hard requirements alone, minimised from several starts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.single_start import StartResult, tune_from
from lftkit.tuning.descent.starts import Start, random_starts
from lftkit.tuning.pieces import HARD_TARGET
from lftkit.tuning.problem import Problem
from lftkit.tuning.status import TuningStatus

ENDED = (TuningStatus.CONVERGED, TuningStatus.STALLED)


def feasibility_runs(
    problem: Problem,
    runs: Sequence[StartResult],
    seed: int,
    limits: DescentOptions,
    band: float,
    *,
    impossible: bool = False,
    ends: int = 3,
    random: int = 4,
) -> list[StartResult]:
    """Further runs where the best of `runs` violates a hard requirement: on the hard requirements alone, then on all.

    The last result is feasible, or ``infeasible`` if every minimisation of the hard values ended by itself, or says
    which limit ended one. Where a lower bound shows that they are `impossible` none of that is tried. The hard ones
    alone are minimised from so many `ends` of the runs and so many `random` starts.
    """
    best = min(runs, key=lambda run: run.rank)
    if best.rank[0] != 1 or best.status is TuningStatus.INTERRUPTED or not problem.structure.size:
        return []
    if impossible:
        return [replace(best, status=TuningStatus.INFEASIBLE)]
    alone = [r.softened() for r in problem.given if r.hard]
    if not alone:
        return []
    only_hard = Problem(
        problem.models,
        alone,
        problem.structure,
        loop_delay=problem.loop_delay,
        pade_order=problem.pade_order,
        min_decay=problem.min_decay,
        limit=problem.limit,
    )
    limits_alone = replace(limits, target=HARD_TARGET)
    violating = sorted((r for r in runs if r.rank[0] == 1), key=lambda run: run.rank)[:ends]
    starts = [Start(seed, run.x) for run in violating] + random_starts(random, seed + 1, 0)
    results: list[StartResult] = []
    for start in starts:
        if time.monotonic() > limits.deadline:
            break
        results.append(tune_from(only_hard, start.parameters(problem), start.seed, limits_alone, band))
        if results[-1].soft <= 1.0:
            return [tune_from(problem, results[-1].x, start.seed, limits, band)]
        if results[-1].status is TuningStatus.INTERRUPTED:
            break
    # The point of least violation with the status that all minimisations allow
    stable, tried = [run for run in results if run.rank[0] == 0], len(results) == len(starts)
    limited = [run.status for run in stable if run.status not in ENDED]
    status = TuningStatus.INFEASIBLE if tried and not limited else (limited or [TuningStatus.OUT_OF_TIME])[0]
    least = min(stable, key=lambda run: run.soft, default=None)
    if least is None or least.soft >= best.hard:
        return [replace(best, status=status)]
    values = problem.evaluate(least.x, gradients=False).values
    soft = max(
        (float(values[i].max()) for i, r in enumerate(problem.requirements) if not r.hard), default=-float("inf")
    )
    return [replace(least, status=status, soft=soft, hard=least.soft)]
