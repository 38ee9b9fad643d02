"""Smooth phase of a start: quasi-Newton rounds on the p-norm of all gains, each in a new Gauss-Newton metric.

Feasibility comes first. Hard requirements that are violated are lowered alone; from then on a point that violates one
is never kept. After every round the exact values decide: the point is kept if they fell; otherwise the frequencies that
the grid had missed are added and the round is repeated from the last point, shorter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.pieces import HARD_TARGET
from lftkit.tuning.descent.prox_linear import prox_linear
from lftkit.tuning.descent.quasi_newton import quasi_newton
from lftkit.tuning.descent.smooth_objective import HARD_MARGIN, PENALTY, SmoothObjective, same_h2
from lftkit.tuning.gains.gains import unresolved
from lftkit.tuning.problem import Evaluation, Problem, worst_values

POWERS = (40.0, np.inf)  # of the norm; infinity: prox-linear steps on the values themselves
WORTH = (0.12, 3e-4)  # relative decrease by a round at each power that is worth another one
STEPS, MIN_STEPS = 12, 3  # of a round
SLOW = 1e-4  # decrease of the logarithm by the last steps of a round below which it ends
RESTORED = 1e-4  # relative decrease of a violated hard value that is worth another round
RESTORING_STEPS = 6  # of a round that lowers hard values alone
MAX_RESTORATIONS = 2  # rounds that bring a point with a lower soft value back to the feasible ones
MORE_PENALTY = 10.0  # factor of the penalty after a round that came near the largest violation that is admitted
TOLERANCE = 1e-3  # relative increase by a round that asks for a shorter one
NEGLIGIBLE = 1e-8  # fraction of the first value below which the infimum counts as zero
FEASIBLE = 1e-6  # excess over 1 that a hard value may have


@dataclass(frozen=True)
class Point:
    """Parameters (size,) with their exact values; the H2 norms of the first model for all if `quick`."""

    x: FloatArray
    found: Evaluation
    soft: float
    hard: float
    quick: bool = False

    @cached_property
    def feasible(self) -> bool:
        """All models stable and all hard requirements met."""
        return bool(np.isfinite(self.soft) or self.soft < 0) and self.hard <= 1.0 + FEASIBLE

    def better_than(self, other: Point, tolerance: float = 0.0) -> bool:
        """Feasible where `other` is not, or lower by more than the relative `tolerance`."""
        if self.feasible != other.feasible:
            return self.feasible
        if self.feasible:
            return max(self.soft, 0.0) < max(other.soft, 0.0) * (1.0 - tolerance)
        return self.hard < other.hard * (1.0 - tolerance)


def point_at(problem: Problem, x: FloatArray, *, quick: bool = False) -> Point:
    """Exact values at `x` (size,), without gradients; `quick`: H2 norms of the first model for all."""
    found = problem.evaluate(x, gradients=False, h2_once=quick)
    return Point(x, found, *worst_values(problem, found), quick)


@dataclass(frozen=True)
class SmoothPhase:
    """Best point of the smooth phase and the evaluations it took."""

    point: Point
    evaluations: int
    rounds: int


def smooth_phase(
    problem: Problem,
    x: FloatArray,
    evaluations: int,
    deadline: float,
    target: float,
    *,
    report: Callable[[Point, int], bool] = lambda point, used: True,
) -> SmoothPhase:
    """Lower the largest values from the stable point `x` (size,) with at most about this number of evaluations.

    `report` is told the best point and the evaluations after each round on the soft values; False ends the phase.
    """
    rounds = _Rounds(problem, x, evaluations, deadline, target, report)
    while not rounds.point.feasible and rounds.left:
        if not rounds.restore():
            break
    if rounds.point.feasible and np.isfinite(rounds.point.soft):
        rounds.descend()
    return SmoothPhase(rounds.checked(), rounds.used, rounds.count)


class _Rounds:
    """The point so far, the frequencies that the grid had missed, and what has been spent."""

    def __init__(
        self,
        problem: Problem,
        x: FloatArray,
        evaluations: int,
        deadline: float,
        target: float,
        report: Callable[[Point, int], bool],
    ) -> None:
        self._problem, self._evaluations, self._deadline, self._target = problem, evaluations, deadline, target
        self._report = report
        self._extra: tuple[FloatArray, ...] = tuple(np.zeros(0) for _ in problem.models)
        self.point = point_at(problem, x)
        self._quick = len(problem.models) > 1 and len(problem.h2) > 0 and same_h2(problem, self.point.found)
        self.used, self.count = 1, 0
        self._weight = 1.0  # of the quadratic term of the next prox-linear step
        self._thin = True  # until a grid without the frequencies of small gains has missed an unstable pole

    def checked(self) -> Point:
        """The point so far with the H2 norms of all models."""
        return point_at(self._problem, self.point.x) if self.point.quick else self.point

    @property
    def left(self) -> bool:
        """Evaluations and time are left."""
        return self.used < self._evaluations and time.monotonic() < self._deadline

    def restore(self) -> bool:
        """One round on the hard values alone from an infeasible point; whether it made progress."""
        new = self._round(self.point, POWERS[0], STEPS, restoring=True)
        if not new.better_than(self.point, RESTORED):
            new = self._round(self.point, POWERS[-1], STEPS, restoring=True)
        progress = new.better_than(self.point, RESTORED)
        if new.better_than(self.point):
            self.point = new
        return progress

    def descend(self) -> None:
        """Rounds on the soft values from a feasible point, which feasible points only replace."""
        stage, steps, multiplier, penalty = 0, STEPS, 0.0, PENALTY
        floor = max(self._target, NEGLIGIBLE * self.point.soft, 1e-12)
        while stage < len(POWERS) and self.left and self.point.soft > floor:
            new = self._round(self.point, POWERS[stage], steps, multiplier=multiplier, penalty=penalty)
            if np.isfinite(new.hard) and new.hard > 0.0:
                excess = float(np.log(new.hard / HARD_TARGET))
                multiplier = max(0.0, multiplier + 2.0 * penalty * excess)
                penalty = penalty * MORE_PENALTY if excess > 0.5 * HARD_MARGIN else penalty
            new = self._restored(new)
            lower = new.better_than(self.point)
            if lower and new.better_than(self.point, WORTH[stage]):
                self.point, steps = new, STEPS
            elif lower:
                self.point, stage = new, stage + 1
            elif stage == len(POWERS) - 1 and steps > MIN_STEPS and self.point.better_than(new, TOLERANCE):
                steps = max(MIN_STEPS, steps // 2)
            else:
                stage, steps = stage + 1, STEPS
            if not self._report(self.point, self.used):
                break

    def _restored(self, new: Point) -> Point:
        """A stable point that violates hard requirements, brought back to feasible ones if its soft value is lower."""
        for _ in range(MAX_RESTORATIONS):
            if new.feasible or not np.isfinite(new.hard) or new.soft >= self.point.soft or not self.left:
                break
            new = self._round(new, POWERS[-1], RESTORING_STEPS, restoring=True)
        return new

    def _round(
        self,
        start: Point,
        power: float,
        steps: int,
        *,
        multiplier: float = 0.0,
        penalty: float = PENALTY,
        restoring: bool = False,
    ) -> Point:
        objective = SmoothObjective(self._problem, start.x, start.found, self._extra, thin=self._thin)
        objective.begin(start.x, power=power, multiplier=multiplier, penalty=penalty, restoring=restoring)
        if power == np.inf:
            x, self._weight = prox_linear(
                objective, start.x, steps=steps, tolerance=SLOW, weight=self._weight, stop=self._late
            )
        else:
            x = quasi_newton(
                objective,
                start.x,
                objective.metric(start.x),
                steps=steps,
                tolerance=SLOW,
                floor=float(np.log(HARD_TARGET if restoring else NEGLIGIBLE * max(start.soft, 1e-290))),
                renewed=objective.metric,
                stop=self._late,
            ).x
        new = point_at(self._problem, x, quick=self._quick)
        self.used, self.count = self.used + objective.evaluations + 1, self.count + 1
        self._thin = bool(new.found.poles)
        self._extra = tuple(_with_peaks(self._problem, k, e, new.found) for k, e in enumerate(objective.extra))
        return new

    def _late(self) -> bool:
        return time.monotonic() > self._deadline


def _with_peaks(problem: Problem, k: int, extra: FloatArray, found: Evaluation) -> FloatArray:
    """Frequencies that the grid of model k had missed."""
    if not found.poles:
        return extra
    peaks = found.peak_frequencies[list(problem.hinf), k]
    missed = [extra, unresolved(problem.gains[k].grid.omega, found.poles[k]), peaks]
    return np.asarray(np.unique(np.concatenate(missed)))
