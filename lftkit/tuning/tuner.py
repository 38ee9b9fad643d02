"""The tuner: minimise the worst soft requirement over all active models subject to the hard ones.

Every start first stabilises all models (descent on the spectral abscissa), then descends on the requirements. Starts
run in parallel processes; the best of them is certified on the assembled closed loops by another route.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.progress import Progress
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked
from lftkit.systems.system import System
from lftkit.tuning.certificate import AGREEMENT, Certificate, certify
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.grid_source import FEASIBLE, point_at
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.single_start import StartResult, only_point, tune_from
from lftkit.tuning.descent.start_runner import (
    CARRIED,
    FIRST,
    MAX_BATCHES,
    StartSearch,
    run_first,
    run_given,
    run_starts,
    while_feasible,
    while_infeasible,
)
from lftkit.tuning.descent.starts import given_starts, random_starts, start_checked, start_sizes
from lftkit.tuning.feasibility import feasibility_runs
from lftkit.tuning.fixed_poles import slow_fixed_pole
from lftkit.tuning.full_order import reduced_starts
from lftkit.tuning.goals import Goal, resolved
from lftkit.tuning.lexicographic import tuned_in_order
from lftkit.tuning.lower_bound import full_order_bounds
from lftkit.tuning.nested_orders import embedded, lower_order
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem
from lftkit.tuning.refinement import agree, refined_runs
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.result import TuningResult
from lftkit.tuning.status import TuningStatus, inaccurate
from lftkit.tuning.structures.on_image import required_period
from lftkit.tuning.structures.structures import AffineStructure, Structure, controller

ALL_MET = "every soft value is at most the one that counts as met, by the certificate: nothing less is asked"
NEAR_BOUND = "the largest soft value is {:.2g} % above what any controller of any order can reach"
IMPOSSIBLE = "no controller of any order brings {} below {:.4g} times its bound: relax it, or make it soft"
NOTHING_FREE = "the structure has no free parameter: the values are those of the one controller that it is"
NOTHING_SOFT = "every hard requirement is met and there is no soft one: nothing is left to lower"


@checked
def tune(
    models: Sequence[System],
    requirements: Sequence[TuningRequirement | Goal],
    structure: Structure,
    *,
    initial: Sequence[ArrayLike] = (),
    loop_delay: float = 0.0,
    min_decay: float | None = None,
    options: TuningOptions | None = None,
) -> TuningResult:
    """Tune `structure` against `requirements` on all `models` at once.

    Parameters
    ----------
    models : sequence of System
        Active models, for instance one plant at several parameter values. For discrete time there is
        :func:`lftkit.tuning.discrete.tune_discrete`.
    requirements : sequence
        :class:`HinfGain`, :class:`H2Gain`, :class:`ClosedLoopPoles`, :class:`ControllerPoles` and the goals of
        :mod:`lftkit.tuning.goals`, soft or hard. Without a soft one the first controller that meets the hard ones is
        ``converged``.
    structure : Structure
        Without a free parameter its one controller is evaluated and certified: ``converged`` where it meets the hard
        requirements.
    initial : sequence of array_like, shape (size,)
        Given starts, taken before the random ones.
    loop_delay : float
        Delay of the loop [s].
    min_decay : float, optional
        Stable means that every closed-loop pole decays faster than this [rad/s]. Without it 1e-6, or half the decay of
        a slower stable pole that no controller moves, as that of a nearly integrating weight.
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

    >>> plant = System([[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]],
    ...               [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)])
    >>> from lftkit.tuning.structures.structures import gain
    >>> from lftkit.tuning.requirements import HinfGain
    >>> result = tune([plant], [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)],
    ...               gain([("y", 1)], [("u", 1)]), initial=[[-0.5]], options=TuningOptions(starts=0))
    >>> str(result.status), result.feasible, round(result.controller.D.item(), 3), round(result.soft, 4)
    ('converged', True, -4.0, 0.2)
    """
    options = options or TuningOptions()
    if any(model.dt for model in models):
        raise InputError("models must be in continuous time, got discrete ones: tune_discrete takes them")
    required_period(structure, 0.0)
    start_time = time.monotonic()
    deadline = start_time + options.wall_limit
    starting = [start_checked(x, structure) for x in initial]
    if structure.size and not (starting or options.starts):
        raise InputError("nothing to start from: give initial parameters or starts >= 1")
    ready, needs = resolved(models, requirements)
    if options.lexicographic:
        run = partial(tune, ready, loop_delay=loop_delay, min_decay=min_decay)
        return tuned_in_order(run, needs, structure, starting, options, AGREEMENT)
    problem = Problem(ready, needs, structure, loop_delay=loop_delay, min_decay=min_decay)
    problem.limit = limits_from(options, start_sizes(problem, starting, options.seed))
    bounds = full_order_bounds(problem)
    least = float(bounds[[not r.hard for r in needs]].max(initial=-np.inf))
    problem.least = least
    # A hard requirement that no controller meets
    impossible = next(
        (
            IMPOSSIBLE.format(requirement.name, lowest)
            for requirement, lowest in zip(problem.given, bounds.max(axis=1, initial=-np.inf).tolist())
            if requirement.hard and lowest > 1.01
        ),
        "",
    )
    known = options.gap > 0.0 and least > 0.0
    within, near = ((1.0 + share * options.gap) * least if known else -np.inf for share in (1.0, 0.9))
    met = max(options.met, within)
    # a little below, so that the upper side of the certificate is not above
    target = max(options.target, options.met * (1.0 - AGREEMENT))
    options = replace(options, target=max(target, near))
    if impossible:
        options = replace(options, starts=min(options.starts, 1), iterations=min(options.iterations, 20))
    if (fixed := slow_fixed_pole(problem.models, structure, problem.min_decay)) is not None:
        first = replace(only_point(problem, next(iter(starting), None)), status=TuningStatus.NOT_STABILISED)
        certified = result_of(problem, [first], time.monotonic() - start_time)
        return replace(certified, status=TuningStatus.NOT_STABILISED, advice=fixed.advice(problem.min_decay))
    # one thread: the matrices are small, and the result must not depend on how many cores there are
    with one_thread(), Progress("tuning", options.progress) as progress:
        alone = StartSearch((only_point(problem),), True) if not structure.size else None
        search = alone or _search(problem, starting, options, deadline, progress)
        runs = list(search.results)
        further: Any = options.seed, limits_of(options, deadline), options.band
        runs = [*runs, *feasibility_runs(problem, runs, *further, impossible=bool(impossible))]
        runs = [*runs, *refined_runs(problem, runs, *further)]
        runs = [*runs, *_gone_on(problem, runs, *further, target=target, met=met)]
        result = result_of(problem, runs, time.monotonic() - start_time)
    if all_met(problem.given, result.certificate, met):
        advice = ALL_MET if met <= options.met else NEAR_BOUND.format(100.0 * max(result.gap, 0.0))
        return replace(result, status=TuningStatus.CONVERGED, advice=advice, stationarity=0.0)
    if impossible and result.status is TuningStatus.INFEASIBLE:
        return replace(result, advice=impossible)
    settled = result.status is TuningStatus.CONVERGED and result.soft == -np.inf
    if search.complete or settled or result.status in (TuningStatus.INTERRUPTED, TuningStatus.TARGET):
        return result
    return replace(result, status=TuningStatus.OUT_OF_TIME, advice=_advice(TuningStatus.OUT_OF_TIME, result.at_bounds))


def _gone_on(
    problem: Problem,
    runs: Sequence[StartResult],
    seed: int,
    limits: DescentOptions,
    band: float,
    *,
    target: float,
    met: float,
) -> list[StartResult]:
    """The best start gone on with, to the target that was given, where only the tuner has it within the gap.

    The upper side of the certificate may be above `met` where the gap is less than their distance.
    """
    best = min(reversed(runs), key=lambda run: run.rank)
    if best.status is not TuningStatus.TARGET or best.soft <= target:
        return []
    certificate = certify(problem.models, controller(problem.structure, best.x), problem.given, problem.loop_delay)
    if all_met(problem.given, certificate, met):
        return []
    return [tune_from(problem, best.x, seed, replace(limits, target=target), band)]


def _search(
    problem: Problem,
    starting: Sequence[FloatArray],
    options: TuningOptions,
    deadline: float,
    progress: Progress,
    batches: int = MAX_BATCHES,
    *,
    asked: bool = True,
) -> StartSearch:
    """Given starts, the best controller of one order less (found likewise), batches of random starts.

    Beside the one of lower order stand reduced full-order controllers. Before the lower orders there is a look at the
    order that is asked for, in half of the time left: at few states and soft gains from random starts, else from the
    reduced controllers. Of these the ones that do not soon meet the hard requirements are carried on last.
    """
    limits = limits_of(options, deadline)
    common = limits, options.band, options.workers, progress
    first = run_starts(problem, given_starts(starting, options.seed), lambda _: (), *common)
    if not options.starts or first.ended or not first.complete:
        return first
    reduced, direct = reduced_starts(problem), ExactValue.suits(problem)
    if direct:
        of_order = _own_order_first(problem, options, deadline, progress) if asked else StartSearch((), True)
    else:
        half = limits_of(options, 0.5 * (time.monotonic() + deadline))
        of_order = run_given(problem, given_starts(reduced, options.seed), while_feasible, half, *common[1:])
    if of_order.ended:
        return StartSearch(first.results + of_order.results, of_order.complete, True)
    nested, all_of_it = _from_lower_order(problem, options, deadline, progress)
    points = [*nested, *(reduced if direct else ())]
    if direct and of_order.results and of_order.best.rank[0] < 2:
        points = sorted([of_order.best.x, *points], key=lambda x: point_at(problem, x).soft)  # unstable: last
    starts = given_starts(points, options.seed)
    rest = run_starts(problem, starts, lambda n: random_starts(options.starts, options.seed, n), *common, batches)
    late = StartSearch((), True, rest.ended)
    if not direct and rest.complete and not rest.ended:
        infeasible = [run.x for run in of_order.results if run.rank[0] == 1]
        late = run_given(problem, given_starts(infeasible, options.seed), while_infeasible, *common)
    complete = of_order.complete and all_of_it and rest.complete and late.complete
    return StartSearch(first.results + of_order.results + rest.results + late.results, complete, late.ended)


def _own_order_first(problem: Problem, options: TuningOptions, deadline: float, progress: Progress) -> StartSearch:
    """Random starts of a dynamic controller of few states before those of lower orders, in half of the time left.

    Descents of few seconds come near the best values of all where the search of the lower orders takes minutes.
    """
    few = options.starts <= CARRIED or lower_order(problem.structure) is None
    if few or not ExactValue.suits(problem):
        return StartSearch((), True)
    now = time.monotonic()
    limits = limits_of(options, now + 0.5 * (deadline - now))
    random = random_starts(FIRST, options.seed, MAX_BATCHES)  # those of a batch of their own
    return run_first(problem, random, limits, options.band, options.workers, progress)


def _from_lower_order(
    problem: Problem, options: TuningOptions, deadline: float, progress: Progress
) -> tuple[list[FloatArray], bool]:
    """Starts from the best of one order less, and whether its search was complete within half of the time left."""
    lower = lower_order(problem.structure)
    if lower is None:
        return [], True
    try:
        smaller = problem.with_structure(lower)
    except ValueError:  # an H2 norm that is infinite for every controller of the lower order
        return [], True
    smaller.limit = limits_from(options, start_sizes(smaller, [], options.seed))
    now = time.monotonic()
    batches = 1 if lower.order and ExactValue.suits(smaller) else MAX_BATCHES
    search = _search(smaller, [], options, now + 0.5 * (deadline - now), progress, batches, asked=False)
    if search.best.rank[0] == 2:
        return [], search.complete
    assert isinstance(problem.structure, AffineStructure)
    return embedded(problem.structure, lower, search.best.x, problem), search.complete


def limits_of(options: TuningOptions, deadline: float) -> DescentOptions:
    """Limits of one start."""
    return DescentOptions(options.iterations, options.tolerance, target=options.target, deadline=deadline)


def limits_from(options: TuningOptions, sizes: FloatArray) -> FloatArray:
    """Largest magnitudes of the parameters (size,) for the sizes of their starts."""
    # parameters that have to be large have a higher limit
    return np.asarray(np.maximum(options.parameter_limit, 1e3 * sizes))


def result_of(problem: Problem, runs: Sequence[StartResult], seconds: float) -> TuningResult:
    """Best of several starts, certified; of equal ones the last."""
    best = min(reversed(runs), key=lambda run: run.rank)
    x = best.x if problem.bounds is None else problem.bounds.clipped(best.x)
    evaluation, count = problem.evaluate(x, gradients=False), len(problem.given)
    values, frequencies = evaluation.values[:count], evaluation.peak_frequencies[:count]
    K = controller(problem.structure, x)
    stable = evaluation.abscissa < -problem.min_decay
    certificate = certify(problem.models, K, problem.given, problem.loop_delay) if stable else None
    status, differ = best.status, ""
    if certificate is not None and not agree(certificate, values):
        status, differ = TuningStatus.INACCURATE, inaccurate(values, certificate.values)
    if certificate is not None and not problem.loop_delay:
        # what the tuner has not seen between its frequencies, the certificate has
        gains = np.isin(np.arange(count), problem.hinf)[:, None] & np.isfinite(values)
        frequencies = np.where(gains, certificate.peak_frequencies, frequencies)
        values = np.where(np.isfinite(values), certificate.values, values)
    hard = np.array([r.hard for r in problem.given])
    # Names of the parameters (size,) that are at bounds of their own or at the limit of all
    names = getattr(problem.structure, "names", [f"x[{k}]" for k in range(len(x))])
    numbers = problem.at_limit(x) if problem.bounds is None else np.union1d(problem.at_limit(x), problem.bounds.at(x))
    at_bounds = tuple(names[k] for k in numbers)
    failures = [run.failure for run in runs if run.failure]
    failed = f"; {len(failures)} of {len(runs)} starts failed ({failures[0]})" if failures else ""
    return TuningResult(
        status,
        (_found(problem, best, status) or _advice(status, at_bounds, differ)) + failed,
        K,
        x,
        float(values[~hard].max(initial=-np.inf)),
        float(values[hard].max(initial=-np.inf)),
        values,
        frequencies,
        evaluation.abscissa,
        best.stationarity,
        certificate,
        seconds,
        sum(r.evaluations for r in runs),
        sum(r.iterations for r in runs),
        tuple(r.soft if r.hard <= 1.0 + FEASIBLE else np.inf for r in runs),
        tuple(r.name for r in problem.given),
        at_bounds,
        lower_bound=problem.least,
    )


def _found(problem: Problem, best: StartResult, status: TuningStatus) -> str:
    """What is to be said of a run in which nothing was minimised; empty for others."""
    if status is not best.status:
        return ""
    if not problem.structure.size:
        return NOTHING_FREE
    return NOTHING_SOFT if best.settled else ""


def all_met(requirements: Sequence[TuningRequirement], certificate: Certificate | None, met: float) -> bool:
    """Whether the certificate's upper sides are at most `met`, those of hard requirements 1."""
    if certificate is None or not met > -np.inf:
        return False
    limits = np.array([1.0 + FEASIBLE if requirement.hard else met for requirement in requirements])
    return bool(np.all(certificate.upper <= limits[:, None]))


def _advice(status: TuningStatus, at_bounds: tuple[str, ...], differ: str = "") -> str:
    said = differ or status.advice
    return f"{said}; at their bounds: {', '.join(at_bounds)}" if at_bounds else said
