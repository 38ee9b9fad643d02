"""Smooth phase of a start: quasi-Newton rounds on the p-norm of all gains, then the minimax descent on the values.

Feasibility comes first. Hard requirements that are violated are lowered alone; from then on a point that violates one
is never kept. After every round the exact values decide: the point is kept if they fell; otherwise the frequencies that
the grid had missed are added.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.grid_source import GridSource, Point, point_at
from lftkit.tuning.descent.minimax.minimax import DescentOptions, descend
from lftkit.tuning.descent.minimax.prox_linear import prox_linear
from lftkit.tuning.descent.quasi_newton import quasi_newton
from lftkit.tuning.descent.smooth_objective import HARD_MARGIN, PENALTY, SLOW, STEPS
from lftkit.tuning.pieces import HARD_TARGET
from lftkit.tuning.problem import Problem

POWER = 40.0  # of the norm
WORTH = 0.12  # relative decrease by a round on the p-norm that is worth another one
PROGRESS = 3e-4  # relative decrease by a working set of the descent that is worth another one
RETRIES = 2  # working sets in a row that raised the values
PER_STEP = 2  # evaluations, at least
RESTORED = 1e-4  # relative decrease of a violated hard value that is worth another round
MORE_PENALTY = 10.0  # factor of the penalty after a round that came near the largest violation that is admitted
SCALE = 0.9  # quantile over frequency of the gain without feedback with which values are compared


@dataclass(frozen=True)
class SmoothPhase:
    """Best point of the smooth phase and the evaluations it took."""

    point: Point
    evaluations: int


def smooth_phase(
    problem: Problem,
    x: FloatArray,
    evaluations: int,
    deadline: float,
    target: float,
    *,
    report: Callable[[Point, int], None] = lambda point, used: None,
) -> SmoothPhase:
    """Lower the largest values from the stable point `x` (size,) with at most about this number of evaluations.

    `report` is told the best point and the evaluations after each round that lowered the soft values.
    """
    rounds = _Rounds(problem, x, evaluations, deadline, report)
    while not rounds.point.feasible and rounds.left > 0:
        if not rounds.restore():
            break
    if rounds.point.feasible and np.isfinite(rounds.point.soft):
        floor = max(target, problem.negligible(rounds.point.soft), 1e-12)
        rounds.smooth(floor)
        rounds.descend(floor)
    return SmoothPhase(rounds.checked(), rounds.source.evaluations)


def negligible_value(problem: Problem) -> float:
    """Value that counts as zero: the infimum is zero and only approached."""
    parts = [
        float(np.quantile(np.sqrt(np.sum(np.abs(P11) ** 2, axis=(1, 2))), SCALE))
        for loop in problem.gains
        for P11 in loop.grid.P11.values()
    ]
    return max(problem.negligible(max(parts, default=1.0)), 1e-290)


class _Rounds:
    """The point so far and what has been spent."""

    def __init__(
        self,
        problem: Problem,
        x: FloatArray,
        evaluations: int,
        deadline: float,
        report: Callable[[Point, int], None],
    ) -> None:
        self._problem, self._evaluations, self._deadline, self._report = problem, evaluations, deadline, report
        self.source = GridSource(problem)
        self.point = self.source.look(x)

    def checked(self) -> Point:
        """The point so far with the H2 norms of all models."""
        return point_at(self._problem, self.point.x) if self.point.quick else self.point

    @property
    def left(self) -> int:
        """Evaluations that are left, none after the deadline."""
        return 0 if self._late() else self._evaluations - self.source.evaluations

    def restore(self) -> bool:
        """One round on the hard values alone from an infeasible point; whether it made progress."""
        new = self._round(restoring=True)
        if not new.better_than(self.point, RESTORED):
            moved = prox_linear(self.source.working_set(self.point), self.point.x, stop=self._late)
            new = self._looked(moved.x)
        progress = new.better_than(self.point, RESTORED)
        if new.better_than(self.point):
            self.point = new
        return progress

    def smooth(self, floor: float) -> None:
        """Rounds on the p-norm of the soft values from a feasible point, which feasible points only replace."""
        multiplier, penalty = 0.0, PENALTY
        while self.left > 0 and self.point.soft > floor:
            new = self._round(multiplier=multiplier, penalty=penalty)
            if np.isfinite(new.hard) and new.hard > 0.0:
                excess = float(np.log(new.hard / HARD_TARGET))
                multiplier = max(0.0, multiplier + 2.0 * penalty * excess)
                penalty = penalty * MORE_PENALTY if excess > 0.5 * HARD_MARGIN else penalty
            before = self.point
            new = self._restored(new)
            if new.better_than(before):
                self.point = new
                self._report(new, self.source.evaluations)
            if not new.better_than(before, WORTH):
                return

    def descend(self, floor: float) -> None:
        """The minimax descent from a feasible point."""
        if self.left <= 0 or not self.point.soft > floor:
            return
        options = DescentOptions(self.left // PER_STEP, PROGRESS, floor, self._deadline, patience=1, retries=RETRIES)
        descent = descend(self.source, self.point.x, options, lambda _, p: self._report(p, self.source.evaluations))
        if descent.point.better_than(self.point):
            self.point = descent.point

    def _restored(self, new: Point) -> Point:
        """A stable point that violates hard requirements, brought back to feasible ones if its soft value is lower."""
        if not new.feasible and np.isfinite(new.hard) and new.soft < self.point.soft:
            for _ in range(RETRIES):
                if new.feasible or not np.isfinite(new.hard) or new.soft >= self.point.soft or self.left <= 0:
                    break
                new = self._looked(prox_linear(self.source.working_set(new), new.x, stop=self._late).x)
        return new

    def _round(self, *, multiplier: float = 0.0, penalty: float = PENALTY, restoring: bool = False) -> Point:
        start, objective = self.point, self.source.working_set(self.point)
        objective.begin(start.x, power=POWER, multiplier=multiplier, penalty=penalty, restoring=restoring)
        x = quasi_newton(
            objective,
            start.x,
            objective.metric(start.x),
            steps=STEPS,
            tolerance=SLOW,
            floor=float(np.log(HARD_TARGET if restoring else self._problem.negligible(max(start.soft, 1e-290)))),
            renewed=objective.metric,
            stop=self._late,
        ).x
        return self._looked(x)

    def _looked(self, x: FloatArray) -> Point:
        look = self.source.look(x)
        self.source.note(look)
        return look

    def _late(self) -> bool:
        return time.monotonic() > self._deadline
