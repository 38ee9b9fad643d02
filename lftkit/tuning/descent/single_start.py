"""One start: stabilise, descend smoothly, finish by the bundle method, confirm the point in another metric."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.bundle_method import BundleResult, minimise
from lftkit.tuning.descent.gain_moves import descended, gain_moves
from lftkit.tuning.descent.grid_source import FEASIBLE, GridSource, Point, point_at
from lftkit.tuning.descent.minimax.minimax import VISIBLE, DescentOptions, lower_point
from lftkit.tuning.descent.smooth_phase import negligible_value, smooth_phase
from lftkit.tuning.descent.starts import lowered_gain
from lftkit.tuning.pieces import HARD_TARGET, Oracle, OracleResult
from lftkit.tuning.problem import Evaluation, Problem, worst_values
from lftkit.tuning.status import TuningStatus

STABILISING_STEPS = 120
SCREENING_EVALUATIONS, SMOOTH_EVALUATIONS, CONFIRMING_EVALUATIONS = 100, 600, 80
EVALUATIONS_PER_ITERATION = 4  # of the smooth phase, for each quadratic program that is allowed
WORTH_REPEATING = 0.05  # relative decrease by a smooth phase that is worth another one
GROWN, GROWS, FALLS = 1e-3, 1.2, 1.5  # parts of the limit that a parameter has, growth and fall that show no minimum
GROWTH_EVALUATIONS = 150
MAX_CYCLES = 4  # of smooth phase and bundle method
ENDS = (TuningStatus.TARGET, TuningStatus.OUT_OF_TIME, TuningStatus.INTERRUPTED, TuningStatus.ITERATIONS)
CUT = (TuningStatus.OUT_OF_TIME, TuningStatus.INTERRUPTED)
ARITHMETIC = (ArithmeticError, ValueError)  # numpy and scipy raise them, LinAlgError too, for matrices out of range


@dataclass(frozen=True)
class StartResult:
    """Outcome of one start; `failure` says how its arithmetic failed."""

    status: TuningStatus
    x: FloatArray
    soft: float
    hard: float
    abscissa: float
    stationarity: float
    evaluations: int
    iterations: int
    failure: str = ""

    @property
    def settled(self) -> bool:
        """Feasible, and no soft requirement: no start has anything to lower."""
        return self.status is TuningStatus.CONVERGED and self.soft == -np.inf

    @property
    def rank(self) -> tuple[int, float]:
        """Sorts from the best to the worst: feasible ones by value, then by violation, then by instability."""
        if not np.isfinite(self.hard) and self.hard > 0:
            return 2, self.abscissa
        return (1, self.hard) if self.hard > 1.0 + FEASIBLE else (0, self.soft)


def screen(
    problem: Problem, x0: FloatArray, seed: int, limits: DescentOptions, evaluations: int = SCREENING_EVALUATIONS
) -> StartResult:
    """Stabilise and descend for a round of the smooth phase, by default a short one."""
    stable, steps = stabilise(problem, x0, np.random.default_rng(seed), limits)
    if not problem.stable(stable.x):
        return unstable(stable, steps)
    descent = smooth_phase(problem, stable.x, evaluations, limits.deadline, limits.target)
    count = stable.evaluations + descent.evaluations
    status = TuningStatus.OUT_OF_TIME if time.monotonic() > limits.deadline else TuningStatus.ITERATIONS
    if descent.point.feasible and descent.point.soft < limits.target:
        status = TuningStatus.TARGET
    elif descent.point.settled:
        status = TuningStatus.CONVERGED
    return _result(status, descent.point, 0.0 if descent.point.settled else np.inf, count, steps)


def tune_from(
    problem: Problem,
    x0: FloatArray,
    seed: int,
    limits: DescentOptions,
    band: float,
    *,
    smooth: bool = True,
    while_infeasible: bool = True,
) -> StartResult:
    """One start to its end; where the structure has no parameter, the one controller that it is.

    Parameters
    ----------
    problem : Problem
    x0 : ndarray, shape (size,)
    seed : int
    limits : DescentOptions
        Of the whole start.
    band : float
        Peaks above this fraction of the largest enter the quadratic programs.
    smooth : bool
        Whether it begins with smooth phases; not where a run that began there has ended with them.
    while_infeasible : bool
        Whether it goes on where the smooth phases end with a hard requirement violated.

    Returns
    -------
    StartResult
        Where the arithmetic fails on the way (a singular matrix, an overflow), the best point until then is ``failed``.
    """
    if not problem.structure.size:
        return only_point(problem)
    try:
        return _tuned_from(problem, x0, np.random.default_rng(seed), limits, band, smooth, while_infeasible)
    except ARITHMETIC as error:
        return failed(x0, error)


def _tuned_from(
    problem: Problem,
    x0: FloatArray,
    rng: np.random.Generator,
    limits: DescentOptions,
    band: float,
    smooth: bool,
    while_infeasible: bool,
) -> StartResult:
    stable, steps = stabilise(problem, x0, rng, limits)
    if not problem.stable(stable.x):
        return unstable(stable, steps)

    def oracle(x: FloatArray) -> OracleResult:
        return _oracle_result(problem, problem.evaluate(x, band=band))

    run, failure = _Run(problem, oracle, limits, rng, stable.x, stable.evaluations), ""
    try:
        status = run.to_the_end(smooth, while_infeasible)
    except KeyboardInterrupt:
        status = TuningStatus.INTERRUPTED
    except ARITHMETIC as error:
        status, failure = TuningStatus.FAILED, _described(error)
    result = _result(status, run.point, run.stationarity, run.evaluations, steps + run.steps)
    return replace(result, failure=failure)


def failed(x0: FloatArray, error: Exception) -> StartResult:
    """Result of a start whose arithmetic failed before it had a stable point."""
    return StartResult(TuningStatus.FAILED, x0, np.inf, np.inf, np.inf, np.inf, 0, 0, _described(error))


def _described(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def only_point(problem: Problem, x: FloatArray | None = None) -> StartResult:
    """One controller, that of a structure without parameters: ``converged`` if it meets all hard requirements."""
    point = point_at(problem, np.zeros(problem.structure.size) if x is None else x)
    if not point.found.abscissa < -problem.min_decay:
        return StartResult(TuningStatus.NOT_STABILISED, point.x, np.inf, np.inf, point.found.abscissa, np.inf, 1, 0)
    status = TuningStatus.CONVERGED if point.feasible else TuningStatus.INFEASIBLE
    return _result(status, point, 0.0, 1, 0)


def _result(status: TuningStatus, point: Point, stationarity: float, evaluations: int, steps: int) -> StartResult:
    evaluation = point.found
    return StartResult(status, point.x, point.soft, point.hard, evaluation.abscissa, stationarity, evaluations, steps)


class _Run:
    """Cycles of smooth phase and bundle method from a stable point."""

    def __init__(
        self,
        problem: Problem,
        oracle: Oracle,
        limits: DescentOptions,
        rng: np.random.Generator,
        x: FloatArray,
        evaluations: int,
    ) -> None:
        self._problem, self._oracle, self._limits, self._rng = problem, oracle, limits, rng
        self.point = point_at(problem, x)
        self.evaluations, self.steps, self.stationarity = evaluations, 0, np.inf

    def to_the_end(self, smooth: bool, while_infeasible: bool) -> TuningStatus:
        """Cycles until the point is confirmed or a limit is reached; the status."""
        limits, first = self._limits, self.point
        endless = smooth and self._smooth_repeatedly(EVALUATIONS_PER_ITERATION * limits.iterations)
        if self._settled():
            return TuningStatus.CONVERGED
        if endless or self._at_limit():
            return TuningStatus.UNBOUNDED
        if not (self.point.feasible or while_infeasible):
            return TuningStatus.ITERATIONS
        negligible = self._problem.negligible(first.soft) if first.feasible else 0.0
        if self.point.feasible and -np.inf < self.point.soft <= negligible:
            return TuningStatus.ITERATIONS  # the infimum is zero, and only approached
        confirmed = False
        limits = replace(limits, target=max(limits.target, negligible)) if negligible else limits
        for _ in range(MAX_CYCLES):
            if time.monotonic() > limits.deadline:
                return TuningStatus.OUT_OF_TIME
            left = max(limits.iterations - self.steps, 1)
            result = minimise(self._oracle, self.point.x, replace(limits, iterations=left), self._rng)
            self.stationarity = result.stationarity
            self._take(point_at(self._problem, result.x))
            self.evaluations, self.steps = self.evaluations + result.evaluations, self.steps + result.iterations
            if self._settled():
                return TuningStatus.CONVERGED
            if self._at_limit():
                return TuningStatus.UNBOUNDED
            if result.status in ENDS or self.steps >= limits.iterations:
                break
            confirmed = self._confirmed()
            if confirmed or time.monotonic() > limits.deadline:
                break
        if result.status is TuningStatus.TARGET and self._limits.target < limits.target:
            return TuningStatus.ITERATIONS
        late = time.monotonic() > limits.deadline
        return _status(result, self.point, confirmed, self.point.better_than(first, VISIBLE), late)

    def _settled(self) -> bool:
        """A point with nothing left to lower, whose stationarity is then zero."""
        if self.point.settled:
            self.stationarity = 0.0
        return self.point.settled

    def _at_limit(self) -> bool:
        """A feasible point with parameters as large as they may be."""
        return self.point.feasible and self._problem.at_limit(self.point.x).size > 0

    def _take(self, point: Point) -> None:
        """Keep `point` unless it is worse: rounding of the constraint apart, the bundle method never rises."""
        if not self.point.better_than(point):
            self.point = point

    def _smooth_repeatedly(self, evaluations: int) -> bool:
        """Smooth phases from the end of the last one, as long as they lower the value and within the evaluations.

        The p-norm of a new phase passes by kinks at which the prox-linear steps of the one before ended. Whether the
        value has no minimum, by :meth:`_falls_with_growth`.
        """
        last = self.evaluations + evaluations
        while True:
            before, left = self.point, last - self.evaluations
            self.point = self._smooth(min(SMOOTH_EVALUATIONS, left))
            if self._falls_with_growth():
                return True
            ended = left <= SMOOTH_EVALUATIONS or not self.point.feasible or self._at_limit()
            if ended or not self.point.better_than(before, WORTH_REPEATING) or time.monotonic() > self._limits.deadline:
                return False

    def _falls_with_growth(self) -> bool:
        """Whether a value that counts as zero still falls while large parameters grow: it has no minimum."""
        before = self.point
        if not before.feasible or self._share(before) < GROWN or before.soft > negligible_value(self._problem):
            return False
        self.point = self._smooth(GROWTH_EVALUATIONS)
        return self.point.soft <= before.soft / FALLS and self._share(self.point) >= GROWS * self._share(before)

    def _share(self, point: Point) -> float:
        """The largest parameter as a part of its limit."""
        return float(np.max(np.abs(point.x) / self._problem.limit))

    def _smooth(self, evaluations: int) -> Point:
        limits = self._limits
        smooth = smooth_phase(self._problem, self.point.x, evaluations, limits.deadline, limits.target)
        self.evaluations += smooth.evaluations
        return smooth.point

    def _confirmed(self) -> bool:
        """Whether no smooth phase, random direction or descent from more gain lowers the value; if one does, move."""
        other = self._smooth(CONFIRMING_EVALUATIONS)
        if not other.better_than(self.point, VISIBLE):
            source = GridSource(self._problem, self._rng, self._limits.deadline)
            x = lower_point(source, self.point)
            self.evaluations += source.evaluations
            confirming = self._with_more_gain() if x is None else point_at(self._problem, x)
            if confirming is None:
                return time.monotonic() <= self._limits.deadline
            other = confirming
        self.point = other
        return False

    def _with_more_gain(self) -> Point | None:
        """A point visibly better that a descent from a larger gain leads to, or None."""
        limits = self._limits
        for x in gain_moves(self._problem, self.point.x):
            reached, used = descended(self._problem, x, CONFIRMING_EVALUATIONS, limits.deadline, limits.target)
            self.evaluations += used
            if reached.better_than(self.point, VISIBLE):
                return reached
            if time.monotonic() > limits.deadline:
                break
        return None


def unstable(stable: BundleResult, steps: int) -> StartResult:
    """Result of a start that stabilised no loop."""
    status = stable.status if stable.status in CUT else TuningStatus.NOT_STABILISED
    return StartResult(
        status, stable.x, np.inf, np.inf, stable.result.objective, stable.stationarity, stable.evaluations, steps
    )


def _status(result: BundleResult, point: Point, confirmed: bool, moved: bool, late: bool) -> TuningStatus:
    if result.status in CUT:
        return result.status
    if late and not confirmed:
        return TuningStatus.OUT_OF_TIME
    if not point.feasible:
        return TuningStatus.INFEASIBLE
    if result.status is TuningStatus.TARGET or (result.status is TuningStatus.CONVERGED and confirmed):
        return result.status
    return TuningStatus.ITERATIONS if moved and result.status is TuningStatus.ITERATIONS else TuningStatus.STALLED


def stabilise(
    problem: Problem, x0: FloatArray, rng: np.random.Generator, limits: DescentOptions
) -> tuple[BundleResult, int]:
    """Descend on the spectral abscissa until every model is stable with some margin; at last lower the gain."""
    worst, _ = problem.stability_pieces(x0, 0.0)
    band = max(0.3 * abs(worst), 1e-3)
    if worst < -problem.min_decay:
        return BundleResult(x0, OracleResult(worst, -np.inf, ()), TuningStatus.TARGET, 0.0, 0, 1), 0

    def oracle(x: FloatArray) -> OracleResult:
        value, pieces = problem.stability_pieces(x, band)
        return OracleResult(value, -np.inf, tuple(pieces))

    target = min(-0.1 * worst, -2.0 * problem.min_decay)
    stabilising = replace(limits, iterations=min(limits.iterations, STABILISING_STEPS), tolerance=1e-5, target=target)
    if np.isfinite(worst):
        bundle = minimise(oracle, x0, stabilising, rng)
    else:  # the loop has no solution there, and no slope
        bundle = BundleResult(x0, OracleResult(worst, -np.inf, ()), TuningStatus.NOT_STABILISED, np.inf, 0, 1)
    if not problem.stable(bundle.x) and bundle.status not in CUT:
        lowered = lowered_gain(problem, x0)
        if lowered is not None:
            result = OracleResult(problem.abscissa(lowered), -np.inf, ())
            return BundleResult(lowered, result, TuningStatus.TARGET, 0.0, 0, bundle.evaluations), bundle.iterations
    return bundle, bundle.iterations


def _oracle_result(problem: Problem, evaluation: Evaluation) -> OracleResult:
    soft, hard = worst_values(problem, evaluation)
    if not np.isfinite(soft) and soft < 0:
        soft = 0.0  # only hard requirements: any feasible point is optimal
    return OracleResult(soft, hard - HARD_TARGET, evaluation.pieces, evaluation.barriers)
