"""The tuner: minimise the worst soft requirement over all active models subject to the hard ones.

Every start first stabilises all models (descent on the spectral abscissa), then descends on the requirements. Starts
run in parallel processes; the best of them is certified on the assembled closed loops by another route.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lti.progress import Progress
from lti.state_space_model import StateSpace
from lti.threads import one_thread
from robust_design.certificate import Certificate, certify
from robust_design.descent import Descent, DescentOptions, StopReason, minimise
from robust_design.pieces import OracleResult
from robust_design.problem import MIN_DECAY, Evaluation, Problem, worst_values
from robust_design.requirements import Requirement
from robust_design.starts import lowered_gain, start_checked, starts_of
from robust_design.structures import Structure, controller

FloatArray = NDArray[np.float64]

ADVICE = {
    "converged": "stationary point; other starts may find a better one",
    "stalled": "no further progress, certificate above tolerance: try other starts or another form of the structure",
    "iterations": "still improving when the iterations ran out: allow more",
    "target": "the target value was reached",
    "not_stabilised": (
        "no start made every model stable: raise the order, give a stabilising start, use more starts, or check that "
        "the commands and measurements reach the unstable poles"
    ),
    "infeasible": (
        "a hard requirement stays above 1: make it soft to see what is reachable, relax its bound, or raise the order"
    ),
    "out_of_time": "the wall limit was reached; the best point so far is given: allow more time or start from it",
    "interrupted": "stopped by the user; the best point so far is given",
}
FEASIBLE = 1e-6


@dataclass(frozen=True)
class TuningOptions:
    """Limits of a tuning run.

    Parameters
    ----------
    starts : int
        Random starts beside the given ones.
    seed : int
        Same seed, same result bit for bit (as long as the wall limit is not what ends the run).
    wall_limit : float
        Seconds for the whole run.
    workers : int
        Processes; with more than one, guard the calling script by ``if __name__ == "__main__":``.
    iterations : int
        Most quadratic programs of a start.
    tolerance : float
        See :class:`robust_design.descent.DescentOptions`.
    target : float
        Stop as soon as the worst soft value is below, hard ones kept.
    band : float
        Peaks above this fraction of the largest enter the quadratic programs.
    progress : bool
        Show a progress line.
    """

    starts: int = 3
    seed: int = 0
    wall_limit: float = 600.0
    workers: int = 1
    iterations: int = 300
    tolerance: float = 1e-4
    target: float = -np.inf
    band: float = 0.3
    progress: bool = False

    def __post_init__(self) -> None:
        if self.starts < 0 or self.workers < 1 or self.iterations < 1:
            raise ValueError(
                "expected starts >= 0, workers >= 1 and iterations >= 1, got "
                f"{self.starts}, {self.workers} and {self.iterations}"
            )
        if not self.wall_limit > 0:
            raise ValueError(f"wall_limit must be positive [s], got {self.wall_limit}")
        if not 0 < self.band < 1:
            raise ValueError(f"band must be between 0 and 1, got {self.band}")


@dataclass(frozen=True)
class TuningResult:
    """A tuned controller with its certificate.

    Parameters
    ----------
    status : str
        ``converged``, ``target``, ``stalled``, ``iterations``, ``not_stabilised``, ``infeasible``, ``out_of_time`` or
        ``interrupted``.
    advice : str
        What to do about it.
    controller : StateSpace
        Best point so far.
    x : ndarray, shape (size,)
        Its parameters.
    soft, hard : float
        Worst soft and hard values (normalised) over requirements and models; minus infinity where there are none.
    values : ndarray, shape (requirements, models)
    peak_frequencies : ndarray, shape (requirements, models)
        Frequencies of the values [rad/s].
    abscissa : float
        Largest real part of the closed-loop poles [rad/s].
    stationarity : float
        Norm of the smallest convex combination of the nearly active scaled gradients.
    certificate : Certificate or None
        Norms and eigenvalues recomputed on the assembled closed loops; None where the loop is unstable.
    seconds : float
    evaluations, iterations : int
        Of all starts.
    starts : tuple of float
        Final worst soft value of every start (infinite: not stabilised or not feasible).
    """

    status: str
    advice: str
    controller: StateSpace
    x: FloatArray
    soft: float
    hard: float
    values: FloatArray
    peak_frequencies: FloatArray
    abscissa: float
    stationarity: float
    certificate: Certificate | None
    seconds: float
    evaluations: int
    iterations: int
    starts: tuple[float, ...]
    requirement_names: tuple[str, ...] = field(default=())

    @property
    def feasible(self) -> bool:
        """All hard requirements met."""
        return self.hard <= 1.0 + FEASIBLE


@dataclass(frozen=True)
class Run:
    """Outcome of one start."""

    status: str
    x: FloatArray
    soft: float
    hard: float
    abscissa: float
    stationarity: float
    evaluations: int
    iterations: int


def tune(
    models: Sequence[StateSpace],
    requirements: Sequence[Requirement],
    structure: Structure,
    *,
    initial: Sequence[ArrayLike] = (),
    loop_delay: float = 0.0,
    min_decay: float = MIN_DECAY,
    options: TuningOptions | None = None,
) -> TuningResult:
    """Tune `structure` against `requirements` on all `models` at once.

    Parameters
    ----------
    models : sequence of Model
        Active models, for instance one plant at several parameter values.
    requirements : sequence
        :class:`HinfGain`, :class:`H2Gain`, :class:`ClosedLoopPoles`, :class:`ControllerPoles`, soft or hard.
    structure : Structure
    initial : sequence of array_like, shape (size,)
        Given starts, taken before the random ones.
    loop_delay : float
        Delay of the loop [s].
    min_decay : float
        Stable means that every closed-loop pole decays faster than this [rad/s].
    options : TuningOptions, optional

    Returns
    -------
    TuningResult

    Raises
    ------
    ValueError
        Ports that do not exist, sizes that do not fit, no start at all.

    Examples
    --------
    A disturbance on 1 / (s + 1) with u = k y: the loop's gain is 1 / (1 - k), the command's -k / (1 - k) is
    held at 0.8.

    >>> plant = StateSpace([[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]],
    ...               [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)])
    >>> from robust_design.structures import gain
    >>> from robust_design.requirements import HinfGain
    >>> result = tune([plant], [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)],
    ...               gain([("y", 1)], [("u", 1)]))
    >>> result.status, round(result.controller.D.item(), 4), round(result.soft, 4)
    ('converged', -4.0, 0.2)
    """
    options = options or TuningOptions()
    start_time = time.monotonic()
    deadline = start_time + options.wall_limit
    problem = Problem(models, requirements, structure, loop_delay=loop_delay, min_decay=min_decay)
    given = [start_checked(x, structure.size) for x in initial]
    jobs = [(x, seed) for x, seed in starts_of(given, options.starts, options.seed, problem)]
    if not jobs:
        raise ValueError("nothing to start from: give initial parameters or starts >= 1")
    # one thread: the matrices are small, and the result must not depend on how many cores there are
    with one_thread(), Progress("tuning", options.progress) as progress:
        if options.workers == 1 or len(jobs) == 1:
            runs = _serial(problem, jobs, options, deadline, progress)
        else:
            runs = _parallel(problem, jobs, options, deadline, progress)
    return result_of(problem, runs, time.monotonic() - start_time)


def tune_from(problem: Problem, x0: FloatArray, seed: int, options: TuningOptions, deadline: float) -> Run:
    """One start: stabilise, then descend (used by :func:`tune` and by the robust outer loop)."""
    rng = np.random.default_rng(seed)
    stable, first = _stabilise(problem, x0, rng, options, deadline)
    if stable.result.objective >= -problem.min_decay:
        status = {"deadline": "out_of_time", "interrupted": "interrupted"}.get(stable.reason, "not_stabilised")
        return Run(
            status, stable.x, np.inf, np.inf, stable.result.objective, stable.stationarity, stable.evaluations, first
        )
    found = minimise(
        lambda x: _oracle_result(problem, problem.evaluate(x, band=options.band)),
        stable.x,
        DescentOptions(options.iterations, options.tolerance, target=options.target, deadline=deadline),
        rng,
    )
    soft, hard = found.result.objective, found.result.constraint + 1.0
    return Run(
        _status(found, hard),
        found.x,
        soft,
        hard,
        problem.abscissa(found.x),
        found.stationarity,
        stable.evaluations + found.evaluations,
        first + found.iterations,
    )


def _stabilise(
    problem: Problem, x0: FloatArray, rng: np.random.Generator, options: TuningOptions, deadline: float
) -> tuple[Descent, int]:
    """Descend on the spectral abscissa until every model is stable with some margin; at last lower the gain."""
    worst, _ = problem.stability_pieces(x0, 0.0)
    band = max(0.3 * abs(worst), 1e-3)
    if worst < -problem.min_decay:
        return Descent(x0, OracleResult(worst, -np.inf, ()), StopReason.TARGET, 0.0, 0, 1), 0

    def oracle(x: FloatArray) -> OracleResult:
        value, pieces = problem.stability_pieces(x, band)
        return OracleResult(value, -np.inf, tuple(pieces))

    target = min(-0.1 * worst, -2.0 * problem.min_decay)
    limits = DescentOptions(min(options.iterations, 120), 1e-5, target=target, deadline=deadline)
    found = minimise(oracle, x0, limits, rng)
    if found.result.objective >= -problem.min_decay and found.reason not in (
        StopReason.DEADLINE,
        StopReason.INTERRUPTED,
    ):
        lowered = lowered_gain(problem, x0)
        if lowered is not None:
            result = OracleResult(problem.abscissa(lowered), -np.inf, ())
            return Descent(lowered, result, StopReason.TARGET, 0.0, 0, found.evaluations), found.iterations
    return found, found.iterations


def _oracle_result(problem: Problem, evaluation: Evaluation) -> OracleResult:
    soft, hard = worst_values(problem, evaluation)
    if not np.isfinite(soft) and soft < 0:
        soft = 0.0  # only hard requirements: any feasible point is optimal
    return OracleResult(soft, hard - 1.0, evaluation.pieces, evaluation.barriers)


def _status(found: Descent, hard: float) -> str:
    if found.reason in ("interrupted", "deadline"):
        return "interrupted" if found.reason == "interrupted" else "out_of_time"
    if hard > 1.0 + FEASIBLE:
        return "infeasible"
    return {"stationary": "converged", "nearly stationary": "converged"}.get(found.reason, found.reason)


def _serial(
    problem: Problem, jobs: list[tuple[FloatArray, int]], options: TuningOptions, deadline: float, progress: Progress
) -> list[Run]:
    runs: list[Run] = []
    for x, seed in jobs:
        runs.append(tune_from(problem, x, seed, options, deadline))
        progress.report(len(runs), len(jobs), best=min(runs, key=_rank).soft)
        if runs[-1].status in ("interrupted", "target") or time.monotonic() > deadline:
            break
    return runs


def _parallel(
    problem: Problem, jobs: list[tuple[FloatArray, int]], options: TuningOptions, deadline: float, progress: Progress
) -> list[Run]:
    runs: dict[int, Run] = {}
    left = deadline - time.monotonic()
    pool = ProcessPoolExecutor(min(options.workers, len(jobs)), mp_context=get_context("spawn"))
    with pool:
        futures = {pool.submit(_remote, problem, x, seed, options, left): i for i, (x, seed) in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                runs[futures[future]] = future.result()
                progress.report(len(runs), len(jobs), best=min(runs.values(), key=_rank).soft)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            x = jobs[0][0]
            none = Run("interrupted", x, np.inf, np.inf, problem.abscissa(x), np.inf, 0, 0)
            best = min(runs.values(), key=_rank, default=none)
            return [replace(best, status="interrupted")]
    return [runs[i] for i in sorted(runs)]


def _remote(problem: Problem, x: FloatArray, seed: int, options: TuningOptions, left: float) -> Run:
    with one_thread():
        return tune_from(problem, x, seed, options, time.monotonic() + left)


def _rank(run: Run) -> tuple[int, float]:
    if not np.isfinite(run.soft):
        return 2, run.abscissa
    return (1, run.hard) if run.hard > 1.0 + FEASIBLE else (0, run.soft)


def result_of(problem: Problem, runs: Sequence[Run], seconds: float) -> TuningResult:
    """Best of several starts, certified."""
    best = min(runs, key=_rank)
    found = problem.evaluate(best.x, gradients=False)
    soft, hard = worst_values(problem, found)
    K = controller(problem.structure, best.x)
    stable = found.abscissa < -problem.min_decay
    certificate = certify(problem.models, K, problem.requirements, problem.loop_delay) if stable else None
    status, advice = best.status, ADVICE[best.status]
    if certificate is not None and np.any(certificate.values > found.values * 1.002 + 1e-9):
        advice += "; the certificate is above the tuned value somewhere: start again from this point"
    return TuningResult(
        status,
        advice,
        K,
        best.x,
        soft,
        hard,
        found.values,
        found.peak_frequencies,
        found.abscissa,
        best.stationarity,
        certificate,
        seconds,
        sum(r.evaluations for r in runs),
        sum(r.iterations for r in runs),
        tuple(r.soft if r.hard <= 1.0 + FEASIBLE else np.inf for r in runs),
        tuple(r.name for r in problem.requirements),
    )
