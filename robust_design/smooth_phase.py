"""Smooth phase of a start: quasi-Newton rounds on the p-norm of all gains, each in a new Gauss-Newton metric.

After every round the exact values decide: the point is kept if they fell; otherwise the frequencies that the grid had
missed are added and the round is repeated from the last point, shorter.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robust_design.gains import unresolved
from robust_design.problem import Evaluation, Problem, worst_values
from robust_design.quasi_newton import quasi_newton
from robust_design.smooth_objective import SmoothObjective

FloatArray = NDArray[np.float64]

POWERS = (40.0, 150.0, 600.0)
STEPS, MIN_STEPS = 12, 3  # of a round
TOLERANCE = 1e-3  # decrease of the logarithm that is worth another round
NEGLIGIBLE = 1e-8  # fraction of the first value below which the infimum counts as zero
VIOLATION_WEIGHT = 10.0  # of hard values above 1 where two points are compared


@dataclass(frozen=True)
class SmoothPhase:
    """Best point of the smooth phase and the evaluations it took."""

    x: FloatArray
    evaluations: int
    rounds: int


def smooth_phase(problem: Problem, x: FloatArray, evaluations: int, deadline: float, target: float) -> SmoothPhase:
    """Lower the largest values from the stable point `x` (size,) with at most about this number of evaluations."""
    found = problem.evaluate(x, gradients=False)
    merit = _merit(problem, found)
    extra: tuple[FloatArray, ...] = tuple(np.zeros(0) for _ in problem.models)
    used, rounds, stage, steps = 1, 0, 0, STEPS
    floor = max(target, NEGLIGIBLE * merit, 1e-12)
    while stage < len(POWERS) and used < evaluations and time.monotonic() < deadline and merit > floor:
        objective = SmoothObjective(problem, x, found, extra)
        objective.power = POWERS[stage]
        result = quasi_newton(
            objective,
            x,
            objective.metric(x),
            steps=steps,
            tolerance=TOLERANCE / 10.0,
            stop=lambda: time.monotonic() > deadline,
        )
        new = problem.evaluate(result.x, gradients=False)
        new_merit = _merit(problem, new)
        used, rounds = used + objective.evaluations + 1, rounds + 1
        extra = tuple(_with_peaks(problem, k, e, new) for k, e in enumerate(objective.extra))
        if new_merit < merit * (1.0 - TOLERANCE):
            x, found, merit = result.x, new, new_merit
            steps = STEPS
        elif new_merit < merit:
            x, found, merit = result.x, new, new_merit
            stage += 1
        elif steps > MIN_STEPS and new_merit > merit * (1.0 + TOLERANCE):
            steps = max(MIN_STEPS, steps // 2)
        else:
            stage, steps = stage + 1, STEPS
    return SmoothPhase(x, used, rounds)


def _merit(problem: Problem, found: Evaluation) -> float:
    soft, hard = worst_values(problem, found)
    return max(soft, 0.0) + VIOLATION_WEIGHT * max(hard - 1.0, 0.0)


def _with_peaks(problem: Problem, k: int, extra: FloatArray, found: Evaluation) -> FloatArray:
    """Frequencies that the grid of model k had missed."""
    if not found.poles:
        return extra
    peaks = found.peak_frequencies[list(problem.hinf), k]
    missed = [extra, unresolved(problem.gains[k].grid.omega, found.poles[k]), peaks]
    return np.asarray(np.unique(np.concatenate(missed)))
