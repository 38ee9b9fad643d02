"""Starts of problems of few states: BFGS on the exact largest value (Lewis and Overton 2013) between smooth phases.

An evaluation costs less than a tenth of one on a grid, so that many starts can be tried. The p-norm of the smooth phase
passes by local minima in which the exact value is caught; the exact value finishes, in the Gauss-Newton metric: optima
of dynamic controllers are often approached along valleys of fast controller poles and large gains that cancel.
"""

from __future__ import annotations

import time

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.gain_moves import gain_moves
from lftkit.tuning.descent.grid_source import Point, point_at
from lftkit.tuning.descent.metric import Metric
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.quasi_newton import QuasiNewtonResult, quasi_newton
from lftkit.tuning.descent.single_start import StartResult, stabilise, unstable
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.descent.smooth_phase import negligible_value, smooth_phase
from lftkit.tuning.descent.starts import Start
from lftkit.tuning.problem import Problem
from lftkit.tuning.status import TuningStatus

STABILISING_STEPS = 200
SMOOTH_EVALUATIONS = 120
SCREENING_STEPS, POLISHING_STEPS = 120, 1000
SCREENING_TOLERANCE, POLISHING_TOLERANCE = 1e-5, 1e-7  # of the logarithm
CYCLES, VISIBLE = 4, 1e-4
RESTARTS, MAX_ROUNDS = 10, 10  # descents from perturbed copies of the best point in a round; rounds
RESTART_SIZES = -3.0, 0.0  # decades of the size of such a perturbation, in the Gauss-Newton metric
METRIC_FLOOR = 1e-6  # of its eigenvalues, relative
RESTART_STEPS, RESTART_TOLERANCE = 400, 1e-8  # of the logarithm
MAX_MOVES = 8  # rounds of descents from points of more gain


def direct_screen(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """Stabilise and descend; every second start without a smooth phase."""
    run = _Direct(problem, limits)
    stable = run.stabilised(start.parameters(problem), start.seed)
    if isinstance(stable, StartResult):
        return stable
    run.begin(stable)
    if start.number % 2 == 0:
        run.smooth()
    run.descend_a_little()
    return run.result()


def direct_polish(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """Descend to the end, then from points of more gain."""
    return _polished(problem, start, limits, follow=True)


def direct_cycles(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """Descend to the end: exact value and smooth phase in turn until neither lowers the value."""
    return _polished(problem, start, limits, follow=False)


def _polished(problem: Problem, start: Start, limits: DescentOptions, *, follow: bool) -> StartResult:
    run = _Direct(problem, limits)
    stable = run.stabilised(start.parameters(problem), start.seed)
    if isinstance(stable, StartResult):
        return stable
    run.begin(stable)
    for _ in range(CYCLES):
        before = run.point
        run.descend()
        if run.late():
            break
        run.smooth()
        if not run.point.better_than(before, VISIBLE):
            break
    if follow:
        run.follow_gain()
    return run.result()


def direct_restarts(problem: Problem, start: Start, limits: DescentOptions, band: float) -> StartResult:
    """From a stable point: descents from perturbed copies of the best point so far, until a round brings little."""
    run = _Direct(problem, limits)
    run.begin(start.parameters(problem))
    run.restart(np.random.default_rng(start.seed))
    return run.result()


def perturbed(x: FloatArray, decades: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """A copy of `x` (size,) with relative changes, their size uniform in the decades; small entries change, too."""
    size = np.abs(x) + 0.1 * float(np.sqrt(np.mean(x**2)))
    return np.asarray(x + 10.0 ** rng.uniform(*decades) * size * rng.standard_normal(len(x)))


class _Direct:
    """The best point of a start, by its exact values."""

    def __init__(self, problem: Problem, limits: DescentOptions) -> None:
        self._problem, self._limits = problem, limits
        self._value = ExactValue(problem)
        size = problem.structure.size
        self._metric = Metric(np.eye(size), np.eye(size))
        self.point: Point
        self._evaluations, self._floor = 0, negligible_value(problem)

    def stabilised(self, x: FloatArray, seed: int) -> FloatArray | StartResult:
        """A stable point, or the result of a start that found none."""
        if self._problem.stable(x):
            return x
        target = -max(1e-3, 2.0 * self._problem.min_decay)
        descent = quasi_newton(
            self._value.abscissa,
            x,
            self._metric,
            steps=STABILISING_STEPS,
            tolerance=1e-9,
            floor=target,
            stop=self.late,
        )
        if self._problem.stable(descent.x):
            return descent.x
        stable, steps = stabilise(self._problem, descent.x, np.random.default_rng(seed), self._limits)
        if not self._problem.stable(stable.x):
            return unstable(stable, steps)
        return stable.x

    def begin(self, x: FloatArray) -> None:
        """Start from the stable point `x` (size,)."""
        self.point = point_at(self._problem, x)

    def smooth(self) -> None:
        """A smooth phase."""
        target = max(self._limits.target, self._floor)
        if self.point.soft <= target:
            return
        descent = smooth_phase(self._problem, self.point.x, SMOOTH_EVALUATIONS, self._limits.deadline, target)
        self._evaluations += descent.evaluations
        self._take(descent.point)

    def descend(self) -> None:
        """Quasi-Newton on the exact value to the end, in the Gauss-Newton metric."""
        self._descend(POLISHING_STEPS, POLISHING_TOLERANCE, self._gauss_newton())

    def descend_a_little(self) -> None:
        """Quasi-Newton on the exact value, in the parameters as they are."""
        self._descend(SCREENING_STEPS, SCREENING_TOLERANCE, self._metric)

    def _descend(self, steps: int, tolerance: float, metric: Metric) -> None:
        if np.isfinite(self._value(self.point.x)[0]):
            self._take(point_at(self._problem, self._descended(self.point.x, steps, tolerance, metric).x))

    def _descended(self, x: FloatArray, steps: int, tolerance: float, metric: Metric) -> QuasiNewtonResult:
        floor = float(np.log(max(self._limits.target, self._floor)))
        return quasi_newton(self._value, x, metric, steps=steps, tolerance=tolerance, floor=floor, stop=self.late)

    def restart(self, rng: np.random.Generator) -> None:
        """Descents from perturbed copies of the best point.

        At a kink the line search ends a descent early, next to a direction that lowers the value.
        """
        for _ in range(MAX_ROUNDS):
            before, metric = self.point, self._gauss_newton()
            for _ in range(RESTARTS):
                if self.late() or self.point.soft <= max(self._floor, self._limits.target):
                    return
                step = 10.0 ** rng.uniform(*RESTART_SIZES) * rng.standard_normal(len(before.x))
                x = self.point.x + metric.step(step)
                if self._problem.stable(x):
                    self._restart_from(x, metric)
            if not self.point.better_than(before, VISIBLE):
                return

    def _gauss_newton(self) -> Metric:
        point = self.point
        return SmoothObjective(self._problem, point.x, point.found).metric(point.x, METRIC_FLOOR)

    def _restart_from(self, x: FloatArray, metric: Metric) -> None:
        descent = self._descended(x, RESTART_STEPS, RESTART_TOLERANCE, metric)
        if np.exp(descent.value) < self.point.soft:
            self._take(point_at(self._problem, descent.x))

    def follow_gain(self) -> None:
        """Descents from points of more gain, as long as they lower the value."""
        before: FloatArray | None = None
        for _ in range(MAX_MOVES):
            kept = self.point
            for x in gain_moves(self._problem, kept.x, before):
                if self.late() or self.point.soft <= self._floor:
                    return
                trial, best = point_at(self._problem, x), self.point
                if not np.isfinite(trial.soft):
                    continue
                self.point = trial
                self.descend()
                if not self.point.better_than(best):
                    self.point = best
            if not self.point.better_than(kept, VISIBLE):
                return
            before = kept.x

    def result(self) -> StartResult:
        """The best point so far."""
        point, target = self.point, self._limits.target
        status = TuningStatus.OUT_OF_TIME if self.late() else TuningStatus.ITERATIONS
        status = TuningStatus.UNBOUNDED if self._problem.at_limit(point.x).size else status
        status = TuningStatus.TARGET if point.soft < target else status
        count = self._evaluations + self._value.evaluations
        return StartResult(status, point.x, point.soft, point.hard, point.found.abscissa, np.inf, count, 0)

    def _take(self, point: Point) -> None:
        if point.better_than(self.point):
            self.point = point

    def late(self) -> bool:
        """The time is used up."""
        return time.monotonic() > self._limits.deadline
