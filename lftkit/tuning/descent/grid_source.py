"""State-space models as the source of a descent: a look takes exact values, the steps all gains on a fixed grid.

Hard requirements enter by the progress function of the bundle method, in logarithms. The grid is refined where the
point of a look has peaks and closed-loop poles; what a look shows beyond it belongs to the next grid.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.minimax.minimax import VISIBLE
from lftkit.tuning.descent.smooth_objective import SmoothObjective, same_h2
from lftkit.tuning.gains.gains import unresolved
from lftkit.tuning.pieces import HARD_TARGET
from lftkit.tuning.problem import Evaluation, Problem, worst_values
from lftkit.tuning.source import Merit, lower

FEASIBLE = 1e-6  # excess over 1 that a hard value may have
RANDOM_DIRECTIONS, STEP_LENGTHS = 100, (1e-3, 1e-2, 1e-1)


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

    @property
    def settled(self) -> bool:
        """All models stable, all hard requirements met, and no soft one: nothing is left to lower."""
        return self.soft == -np.inf and self.hard <= HARD_TARGET

    @property
    def merit(self) -> Merit:
        """Violation, and the largest soft value."""
        return 0.0 if self.feasible else self.hard, max(self.soft, 0.0)

    def better_than(self, other: Point, tolerance: float = 0.0) -> bool:
        """Feasible where `other` is not, or lower by more than the relative `tolerance`."""
        return lower(self.merit, other.merit, tolerance) and not lower(other.merit, self.merit)


def point_at(problem: Problem, x: FloatArray, *, quick: bool = False) -> Point:
    """Exact values at `x` (size,), without gradients; `quick`: H2 norms of the first model for all."""
    evaluation = problem.evaluate(x, gradients=False, h2_once=quick)
    return Point(x, evaluation, *worst_values(problem, evaluation), quick)


class GridSource:
    """A problem on state-space models, as a descent sees it.

    Parameters
    ----------
    problem : Problem
    rng : Generator, optional
        Of the random directions.
    deadline : float
        Value of ``time.monotonic()`` after which no direction is tried.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator | None = None, deadline: float = np.inf) -> None:
        self._problem, self._rng, self._deadline = problem, rng or np.random.default_rng(0), deadline
        self._extra: tuple[FloatArray, ...] = tuple(np.zeros(0) for _ in problem.models)
        self._thin = True  # until a grid without the frequencies of small gains has missed an unstable pole
        self._near_limit = False  # until a trial or a look was outside the limit of stability
        self._quick = False
        self._evaluated = 0
        self._seen: Point | None = None
        self._objective: SmoothObjective | None = None

    @property
    def evaluations(self) -> int:
        """So far, on grids and exact ones."""
        return self._evaluated + (0 if self._objective is None else self._objective.evaluations)

    def begin(self, x: FloatArray) -> FloatArray:
        """The start as it is: a look says whether it is stable."""
        return x

    def look(self, x: FloatArray) -> Point:
        """Exact values; H2 norms of the first model alone from then on where they are the same for all."""
        if self._seen is not None and np.array_equal(self._seen.x, x):
            return self._seen
        self._seen = point = point_at(self._problem, x, quick=self._quick)
        if not self._evaluated and len(self._problem.models) > 1 and self._problem.h2 and point.found.poles:
            self._quick = same_h2(self._problem, point.found)
        self._evaluated += 1
        return point

    def stable(self, x: FloatArray) -> bool:
        """Looks have said so."""
        return True

    def note(self, look: Point, level: float = np.inf) -> None:
        """Remember the frequencies of the last grid, and the peaks and poles that it had missed."""
        if self._objective is not None:
            self._thin = bool(look.found.poles)
            self._near_limit = self._objective.limit_watch.near or not look.found.poles
            more = self._objective.extra
            self._extra = tuple(_with_peaks(self._problem, k, e, look.found) for k, e in enumerate(more))

    def working_set(self, look: Point) -> SmoothObjective:
        """All values on the grid of a look."""
        self._evaluated = self.evaluations
        hints: Any = {"thin": self._thin, "near_limit": self._near_limit}
        self._objective = SmoothObjective(self._problem, look.x, look.found, self._extra, **hints)
        return self._objective

    def trials(self, look: Point) -> Iterator[FloatArray]:
        """Random directions in the Gauss-Newton metric: points that are lower on the grid."""
        objective = self.working_set(look)
        metric, (soft, hard) = objective.metric(look.x), objective.largest(look.x)
        for _ in range(RANDOM_DIRECTIONS):
            if time.monotonic() > self._deadline:
                return
            u = self._rng.standard_normal(len(look.x))
            x = look.x + metric.step(self._rng.choice(STEP_LENGTHS) * u / float(np.sqrt(u @ u)))
            new_soft, new_hard = objective.largest(x)
            met = new_soft < soft - VISIBLE and new_hard <= 0.0
            if met if look.feasible else new_hard < hard - VISIBLE:
                yield x

    def memory(self) -> list[Any]:
        """Frequencies beside the first grid of each model, and whether small gains may be left out."""
        return [self._thin, *(e.tolist() for e in self._extra)]

    def recall(self, memory: list[Any]) -> None:
        """Continue with these frequencies."""
        self._thin, self._extra = bool(memory[0]), tuple(np.array(e, dtype=float) for e in memory[1:])


def _with_peaks(problem: Problem, k: int, extra: FloatArray, evaluation: Evaluation) -> FloatArray:
    """Frequencies that the grid of model k had missed."""
    if not evaluation.poles:
        return extra
    peaks = evaluation.peak_frequencies[list(problem.hinf), k]
    missed = [extra, unresolved(problem.gains[k].grid.omega, evaluation.poles[k]), peaks]
    return np.asarray(np.unique(np.concatenate(missed)))
