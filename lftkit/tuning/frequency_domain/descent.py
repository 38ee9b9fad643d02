"""Minimax descent: the largest of all scaled gains is lowered.

Every step minimises the largest linearised logarithm of the values plus a quadratic term in the Gauss-Newton metric
(a prox-linear method; Lewis and Wright 2016). Most pairs are far from the largest value: a step looks at those near
it, and all of them are looked at again after :data:`REFRESH` steps. Where that shows a larger value than before, the
steps since are taken back and the pairs that were missed stay in the set.

Hard gains that are met stay met: in a step they count as much above the largest soft value as they are above 1.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, IntArray
from lftkit.tuning.descent.prox_step import ACCEPTED, METRIC, prox_step
from lftkit.tuning.frequency_domain.blocks import entry_sizes, with_least_decay
from lftkit.tuning.frequency_domain.problem import ResponseProblem

REFRESH = 6
"""Steps between two looks at all pairs."""
KEEP, FEWEST, MOST = 0.4, 2000, 8000
"""Pairs above this part of the largest value are looked at, but not fewer and not more than these numbers."""
ENTRIES, NEAR = 4000, 0.5
"""Gains that are linearised: those above this part of the largest value, and their largest number."""
PLANES = 300
"""Of the first quadratic program of a step; others are added while they are violated."""
VISIBLE = 1e-3
"""Relative decrease that refutes a local minimum."""
RANDOM_DIRECTIONS, STEP_LENGTHS = 100, (1e-3, 1e-2, 1e-1)
"""Directions that are tried at a local minimum, and the lengths of the steps, of the entries' sizes."""
SHARPNESS = 6.0
RIDGE, PROPORTION = 1e-4, 1e-2


@dataclass(frozen=True)
class ResponseDescentOptions:
    """Limits of a descent.

    Parameters
    ----------
    iterations : int
    tolerance : float
        It is ``stalled`` when four looks at all pairs together lowered the value by less than this part.
    target : float
        It ends when the largest value is below.
    wall_limit : float
        [s].
    confirm : bool
        Where it would be ``stalled``, try steps in the metric of the entries' sizes and random directions; the descent
        goes on where they lower the value by 0.1 %, and is ``converged`` where none does.
    """

    iterations: int = 300
    tolerance: float = 2e-3
    target: float = 0.0
    wall_limit: float = np.inf
    confirm: bool = False


@dataclass(frozen=True)
class ResponseDescent:
    """Result of a descent.

    Parameters
    ----------
    x : ndarray
        Entries of all gain matrices.
    value : float
        Largest scaled value: of all gains and noises, hard ones as they are.
    values : ndarray, shape (gains,)
        Largest value of each gain.
    noise : ndarray, shape (noises,)
    worst_pair : ndarray of int, shape (gains,)
        Pair of each largest value.
    status : {"converged", "target", "stalled", "iterations", "out_of_time"}
    iterations : int
    """

    x: FloatArray
    value: float
    values: FloatArray
    noise: FloatArray
    worst_pair: IntArray
    status: str
    iterations: int


@dataclass(frozen=True)
class DescentState:
    """Where a descent is before a look at all pairs; with it, it goes on with the same bits.

    Parameters
    ----------
    x, best : ndarray
        Point that is looked at, and the best one before.
    weight : float
        Of the quadratic term.
    plain : bool
        Whether the metric is that of the entries' sizes.
    pairs : ndarray of int
        Pairs that the steps look at.
    history : list of float
        Largest values at the looks that lowered it.
    iteration, failures : int
    """

    x: FloatArray
    best: FloatArray
    weight: float
    plain: bool
    pairs: IntArray
    history: list[float]
    iteration: int
    failures: int

    def to_mapping(self) -> dict[str, Any]:
        """For JSON, which keeps every bit of a finite number."""
        return {**vars(self), **{name: getattr(self, name).tolist() for name in ("x", "best", "pairs")}}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> DescentState:
        """As :meth:`to_mapping` makes it."""
        arrays = {name: np.array(values[name], dtype=float) for name in ("x", "best")}
        return cls(**{**values, **arrays, "pairs": np.array(values["pairs"], dtype=np.intp)})


@dataclass
class _State:
    """Point, its linearisation, the weight of the quadratic term, and whether its metric is of the entries' sizes."""

    x: FloatArray
    weight: float = 1.0
    plain: bool = False
    pairs: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    factor: tuple[FloatArray, bool] | None = None


def descend(
    problem: ResponseProblem,
    x: FloatArray,
    stable: Callable[[FloatArray], bool],
    options: ResponseDescentOptions | None = None,
    report: Callable[[int, float], None] = lambda iteration, value: None,
    keep: Callable[[DescentState], None] = lambda state: None,
    goes_on: DescentState | None = None,
) -> ResponseDescent:
    """Lower the largest value from a stabilising start.

    Parameters
    ----------
    problem : ResponseProblem
    x : ndarray
        Start, :func:`lftkit.tuning.frequency_domain.parameters_of`.
    stable : callable
        Whether the loop is stable with these parameters; steps to others are not taken.
    options : ResponseDescentOptions, optional
    report : callable
        Receives the iteration and the largest value at each look at all pairs.
    keep : callable
        Receives the state before each look but the first.
    goes_on : DescentState, optional
        State of an interrupted descent with the same arguments: it goes on there.

    Raises
    ------
    ValueError
        A start that is not stable or has values that are not finite.
    """
    options = options or ResponseDescentOptions()
    if not stable(x):
        raise ValueError("start must be a stabilising controller, got one that is not")
    given, x = x, with_least_decay(problem.blocks, np.array(x, dtype=float))
    if not np.array_equal(given, x) and not stable(x):
        raise ValueError("start must be a stabilising controller, got one that is not with poles of the least decay")
    state, best, begin = _State(x), x.copy(), time.monotonic()
    history: list[float] = []
    at_best: tuple[FloatArray, FloatArray] | None = None
    iteration, failures, status = 0, 0, "iterations"
    if goes_on is not None:
        state = _State(goes_on.x.copy(), goes_on.weight, goes_on.plain, goes_on.pairs)
        best, history = goes_on.best.copy(), list(goes_on.history)
        iteration, failures = goes_on.iteration, goes_on.failures
    while True:
        if iteration and (goes_on is None or iteration > goes_on.iteration):
            keep(
                DescentState(state.x, best, state.weight, state.plain, state.pairs, list(history), iteration, failures)
            )
        raw, noise = problem.values(state.x), problem.noise(state.x)
        value = _merit(problem, raw, noise)
        if not np.isfinite(value):
            raise ValueError("start must have finite gains, got a value that is not")
        _collect(state, raw, min(value, history[-1] if history else np.inf))
        if history and value > history[-1]:
            state.x, state.weight, state.factor = best.copy(), 4.0 * state.weight, None
        else:
            history.append(value)
            best, at_best = state.x.copy(), (raw, noise)
            report(iteration, value)
        if history[-1] < options.target:
            status = "target"
        elif (len(history) > 4 and history[-5] < history[-1] * (1.0 + options.tolerance)) or failures > 3:
            status = "stalled"
        elif time.monotonic() - begin > options.wall_limit:
            status = "out_of_time"
        elif iteration < options.iterations:
            moved = _several(problem, state, stable)
            iteration += REFRESH
            failures = 0 if moved else failures + 1
            continue
        if status == "stalled" and options.confirm:
            lower = _lower_point(problem, best, history[-1], stable)
            if lower is None:
                status = "converged"
            elif iteration < options.iterations:
                state, history, failures, status = _State(lower, pairs=state.pairs), [], 0, "iterations"
                continue
        return _result(best, *(at_best or (problem.values(best), problem.noise(best))), status, iteration)


def _lower_point(
    problem: ResponseProblem, x: FloatArray, value: float, stable: Callable[[FloatArray], bool]
) -> FloatArray | None:
    """A stable point with a visibly lower largest value, by steps in another metric or in random directions."""

    def lower(at: FloatArray) -> bool:
        return _merit(problem, problem.values(at), problem.noise(at)) < value * (1.0 - VISIBLE) and stable(at)

    state = _State(x.copy(), plain=True)
    _collect(state, problem.values(x), value)
    for _ in range(4):
        _several(problem, state, stable)
        if lower(state.x):
            return state.x
    rng, sizes = np.random.default_rng(len(x)), entry_sizes(problem.blocks, x) * problem.free
    for _ in range(RANDOM_DIRECTIONS):
        direction = sizes * rng.standard_normal(len(x))
        for length in STEP_LENGTHS:
            tried = with_least_decay(problem.blocks, np.asarray(x + length * direction))
            if lower(tried):
                return tried
    return None


def _merit(problem: ResponseProblem, raw: FloatArray, noise: FloatArray) -> float:
    """Largest value, hard gains lifted."""
    level = _level(problem, raw, noise)
    return max(float(_lifted(problem, raw, level).max()), float(noise.max(initial=0.0)))


def _level(problem: ResponseProblem, raw: FloatArray, noise: FloatArray) -> float:
    """Largest soft value."""
    soft = raw[~problem.hard]
    return max(float(soft.max(initial=0.0)), float(noise.max(initial=0.0)))


def _lifted(problem: ResponseProblem, raw: FloatArray, level: float) -> FloatArray:
    """Hard gains as much above the largest soft value as they are above 1."""
    return np.asarray(np.where(problem.hard[:, None], raw * max(level, 1.0), raw))


def _collect(state: _State, raw: FloatArray, value: float) -> None:
    """The pairs that the next steps look at."""
    largest = raw.max(axis=0)
    fewest = np.sort(largest)[-min(FEWEST, len(largest))]
    near = np.flatnonzero(largest >= min(KEEP * value, fewest))
    near = near[np.argsort(-largest[near], kind="stable")[:MOST]]
    state.pairs = np.union1d(state.pairs, near) if len(state.pairs) < MOST else np.sort(near)


def _several(problem: ResponseProblem, state: _State, stable: Callable[[FloatArray], bool]) -> bool:
    """Steps until the next look at all pairs; whether the last one found a descent."""
    near = problem.at(state.pairs)
    for k in range(REFRESH):
        if k % METRIC == 0:
            state.factor = None
        if not _step(near, state, stable):
            return k > 0
    return True


def _step(problem: ResponseProblem, state: _State, stable: Callable[[FloatArray], bool]) -> bool:
    """One step of the prox-linear method; False if no weight of the quadratic term gives a descent.

    `problem` has the pairs of the state alone.
    """
    free = problem.free
    raw = problem.values(state.x)
    noise, noise_gradients = problem.noise_slopes(state.x)
    level = _level(problem, raw, noise)
    lifted = _lifted(problem, raw, level)
    entries = np.argwhere(lifted > NEAR * lifted.max())
    order = np.argsort(-lifted[entries[:, 0], entries[:, 1]], kind="stable")[:ENTRIES]
    values, gradients, owners = problem.slopes(state.x, entries[order])
    lift = np.where(problem.hard[owners], max(level, 1.0), 1.0)
    f = np.concatenate([values * lift, noise])
    G = np.vstack([gradients * (lift / np.maximum(values * lift, 1e-12))[:, None], noise_gradients / noise[:, None]])
    G, f = G[:, free], np.log(np.maximum(f, 1e-12))
    if state.factor is None:
        sizes = entry_sizes(problem.blocks, state.x)[free]
        metric: FloatArray = np.zeros((len(sizes), len(sizes)))
        if not state.plain:
            metric = problem.metric(state.x, lifted, SHARPNESS)[free][:, free]
        state.factor = _factor(metric, sizes)
    current, now = float(f.max()), state.x

    def decrease(direction: FloatArray, predicted: float) -> float:
        """Of the largest value; minus infinity where it is too small, or else where the loop is not stable."""
        x = now.copy()
        x[free] += direction
        state.x = x = with_least_decay(problem.blocks, x)
        found = np.concatenate([_lifted(problem, problem.values(x), level).ravel(), problem.noise(x)])
        reached = float(np.log(found.max())) if np.isfinite(found).all() else np.inf
        return current - reached if reached < current - ACCEPTED * predicted and stable(x) else -np.inf

    step = prox_step(f, G, state.factor, state.weight, PLANES, decrease)
    state.weight = step.weight
    if not step.taken:
        state.x = now
    return step.taken


def _factor(H: FloatArray, sizes: FloatArray) -> tuple[FloatArray, bool]:
    """Factor of a metric in which changes of the size of an entry count, even if the gains do not feel them."""
    factor: Any = linalg.cho_factor(H + RIDGE * np.diag(np.diag(H)) + PROPORTION * np.diag(1.0 / sizes**2))
    return factor[0], bool(factor[1])


def _result(x: FloatArray, raw: FloatArray, noise: FloatArray, status: str, iterations: int) -> ResponseDescent:
    values, worst_pair = raw.max(axis=1), raw.argmax(axis=1)
    value = max(float(values.max()), float(noise.max(initial=0.0)))
    return ResponseDescent(x, value, values, noise, worst_pair, status, iterations)
