"""Responses as the source of a descent: a look takes all pairs, the steps those near the largest value.

The metric is the Gauss-Newton matrix of errors and noise, plus a share of every entry's own size. Hard gains that are
met stay met: in a step they count as much above the largest soft value as they are above 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.tuning.descent.minimax.prox_linear import ACCEPTED, FIRST_WEIGHT, prox_linear
from lftkit.tuning.responses.blocks import entry_sizes, with_least_decay
from lftkit.tuning.responses.problem import ResponseProblem
from lftkit.tuning.source import Merit

FEASIBLE, RESTORING = 1e-6, 1.05
"""Excess over 1 that a hard gain may have; factor by which soft ones may rise in a step that lowers a violated one."""


@dataclass(frozen=True)
class ResponseLook:
    """Values of a point at all pairs.

    Parameters
    ----------
    x : ndarray
        Entries of all gain matrices.
    merit : (0, value)
        Largest value, hard gains as much above the largest soft one as they are above 1.
    values : ndarray, shape (gains,)
        Largest value of each gain.
    noise : ndarray, shape (noises,)
    raw : ndarray, shape (gains, pairs)
        Empty where only the largest ones are known.
    """

    x: FloatArray
    merit: Merit
    values: FloatArray
    noise: FloatArray
    raw: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), repr=False, compare=False)

    @property
    def value(self) -> float:
        """Largest value of all gains and noises, hard ones as they are."""
        return max(float(self.values.max()), float(self.noise.max(initial=0.0)))


class ResponseSource:
    """A problem on responses, as a descent sees it.

    Parameters
    ----------
    problem : ResponseProblem
    stable : callable
        Whether the loop is stable with these parameters; steps to others are not taken.
    """

    def __init__(self, problem: ResponseProblem, stable: Callable[[FloatArray], bool]) -> None:
        self.problem, self.stable = problem, stable
        self._pairs: IntArray = np.zeros(0, dtype=np.intp)

    def begin(self, x: FloatArray) -> FloatArray:
        """A start with the least decay of the controllers' own poles."""
        if not self.stable(x):
            raise InputError("start must be a stabilising controller, got one that is not")
        moved = with_least_decay(self.problem.blocks, np.array(x, dtype=float))
        if not np.array_equal(x, moved) and not self.stable(moved):
            raise InputError(
                "start must be a stabilising controller, got one that is not with poles of the least decay"
            )
        return moved

    def look(self, x: FloatArray) -> ResponseLook:
        """Values at all pairs."""
        raw, noise = self.problem.values(x), self.problem.noise(x)
        return ResponseLook(x, _merit(self.problem, raw, noise), raw.max(axis=1), noise, raw)

    def note(self, look: ResponseLook, level: float) -> None:
        """Add the pairs above a part of the level to those of the next working sets, from 2000 to 8000 of them."""
        largest = look.raw.max(axis=0)
        fewest, most = np.sort(largest)[-min(2000, len(largest))], 8000
        near = np.flatnonzero(largest >= min(0.4 * level, fewest))
        near = near[np.argsort(-largest[near], kind="stable")[:most]]
        self._pairs = np.union1d(self._pairs, near) if len(self._pairs) < most else np.sort(near)

    def working_set(self, look: ResponseLook) -> PairsWorkingSet:
        """The pairs so far."""
        return PairsWorkingSet(self.problem.at(self._pairs), self.stable)

    def trials(self, look: ResponseLook) -> Iterator[FloatArray]:
        """Steps in the metric of the entries' sizes, then random directions."""
        other, x, weight = ResponseSource(self.problem, self.stable), look.x.copy(), FIRST_WEIGHT
        other.note(other.look(x), look.merit[1])
        for _ in range(4):
            working = PairsWorkingSet(self.problem.at(other._pairs), self.stable, plain=True)
            trial = prox_linear(working, x, weight=weight)
            x, weight = trial.x, trial.weight
            yield x
        rng, sizes = np.random.default_rng(len(x)), entry_sizes(self.problem.blocks, look.x) * self.problem.free
        for _ in range(100):
            direction = sizes * rng.standard_normal(len(x))
            for length in (1e-3, 1e-2, 1e-1):
                yield with_least_decay(self.problem.blocks, np.asarray(look.x + length * direction))

    def memory(self) -> list[Any]:
        """Pairs of the next working set."""
        return list(self._pairs.tolist())

    def recall(self, memory: list[Any]) -> None:
        """Continue with these pairs."""
        self._pairs = np.array(memory, dtype=np.intp)


@dataclass
class PairsWorkingSet:
    """Some pairs of a problem.

    Parameters
    ----------
    problem : ResponseProblem
        With these pairs alone.
    stable : callable
    plain : bool
        Take the metric of the entries' sizes.
    planes : int
        Of the first quadratic program of a step; others are added while they are violated.
    steps : int
        Between two looks at all pairs.
    known : (point, values), optional
        The last point that was tried, with its scaled gains.
    """

    problem: ResponseProblem
    stable: Callable[[FloatArray], bool]
    plain: bool = False
    planes: int = 300
    steps: int = 6
    slow: float = -np.inf
    known: tuple[FloatArray, FloatArray] | None = None

    def at(self, x: FloatArray) -> PairsModel:
        """Linearised at the stable point `x`."""
        if self.known is None or self.known[0] is not x:
            self.known = x, self.problem.values(x)
        return PairsModel(self, x, self.known[1])


class PairsModel:
    """Linearised logarithms of gains and noise at a point.

    Parameters
    ----------
    working : PairsWorkingSet
    x : ndarray
    raw : ndarray, shape (gains, pairs)
        Scaled gains there.
    """

    def __init__(self, working: PairsWorkingSet, x: FloatArray, raw: FloatArray) -> None:
        self._working, self._problem, self._x = working, working.problem, x
        noise, self._noise_gradients = self._problem.noise_slopes(x)
        self._noise, self._lift = noise, _lift(self._problem, raw, noise)
        self._lifted = _lifted(self._problem, raw, self._lift)
        self.reached: tuple[FloatArray, Merit] = x, (0.0, np.inf)

    @cached_property
    def _linear(self) -> tuple[FloatArray, FloatArray]:
        problem, lifted = self._problem, self._lifted
        # The largest gains are linearised
        entries = np.argwhere(lifted > 0.5 * lifted.max())
        order = np.argsort(-lifted[entries[:, 0], entries[:, 1]], kind="stable")[:4000]
        values, gradients, owners = problem.slopes(self._x, entries[order])
        lift = np.where(problem.hard[owners], self._lift, 1.0)
        f = np.concatenate([values * lift, _lifted_noise(problem, self._noise, self._lift)])
        scaled = gradients * (lift / np.maximum(values * lift, 1e-12))[:, None]
        G = np.vstack([scaled, self._noise_gradients / np.maximum(self._noise, 1e-300)[:, None]])
        return np.log(np.maximum(f, 1e-12)), G[:, problem.free]

    @property
    def values(self) -> FloatArray:
        """Logarithms (m,), hard ones lifted."""
        return self._linear[0]

    @property
    def gradients(self) -> FloatArray:
        """Of the logarithms by the free entries (m, n)."""
        return self._linear[1]

    @property
    def merit(self) -> Merit:
        """Largest value, hard ones lifted."""
        return 0.0, float(self.values.max())

    def factor(self) -> Any:
        """Of a metric in which changes of the size of an entry count, even if the gains do not feel them."""
        free = self._problem.free
        sizes = entry_sizes(self._problem.blocks, self._x)[free]
        H: FloatArray = np.zeros((len(sizes), len(sizes)))
        if not self._working.plain:
            H = self._problem.metric(self._x, self._lifted, sharpness=6.0)[free][:, free]
        return linalg.cho_factor(H + 1e-4 * np.diag(np.diag(H)) + 1e-2 * np.diag(1.0 / sizes**2))

    def decrease(self, step: FloatArray, predicted: float) -> float:
        """Of the largest value; minus infinity where it is too small, or else where the loop is not stable."""
        x = self._x.copy()
        x[self._problem.free] += step
        x = with_least_decay(self._problem.blocks, x)
        raw, current = self._problem.values(x), float(self.values.max())
        self._working.known = x, raw
        noise = _lifted_noise(self._problem, self._problem.noise(x), self._lift)
        lifted = np.concatenate([_lifted(self._problem, raw, self._lift).ravel(), noise])
        value = float(np.log(lifted.max())) if np.isfinite(lifted).all() else np.inf
        self.reached = x, (0.0, value)
        admitted = value < current - ACCEPTED * predicted and self._working.stable(x)
        return current - value if admitted else -np.inf


def _merit(problem: ResponseProblem, raw: FloatArray, noise: FloatArray) -> Merit:
    """Largest value, hard ones lifted; where soft ones are minimised, hard ones above 1 are a violation."""
    if problem.least_level:
        lift = _lift(problem, raw, noise)
        largest = float(_lifted(problem, raw, lift).max())
        return 0.0, max(largest, float(_lifted_noise(problem, noise, lift).max(initial=0.0)))
    hard = _hard(problem, raw, noise)
    return 0.0 if hard <= 1.0 + FEASIBLE else hard, soft_level(problem, raw, noise)


def soft_level(problem: ResponseProblem, gains: FloatArray, noise: FloatArray) -> float:
    """Largest soft value of gains (gains, ...) and noise (noises,)."""
    soft = gains[~problem.hard]
    return max(float(soft.max(initial=0.0)), float(noise[~problem.hard_noise].max(initial=0.0)))


def _hard(problem: ResponseProblem, raw: FloatArray, noise: FloatArray) -> float:
    """Largest hard value."""
    return max(float(raw[problem.hard].max(initial=0.0)), float(noise[problem.hard_noise].max(initial=0.0)))


def _lift(problem: ResponseProblem, raw: FloatArray, noise: FloatArray) -> float:
    """Factor of hard values in a step: as much above the largest soft value as they are above 1.

    With the factor of the point that a step begins at, a step keeps hard values that are met below 1. Where they are
    violated and soft ones are minimised, these may rise by :data:`RESTORING`.
    """
    level = soft_level(problem, raw, noise)
    if problem.least_level:
        return max(level, problem.least_level)
    return level * (RESTORING if _hard(problem, raw, noise) > 1.0 + FEASIBLE else 1.0)


def _lifted(problem: ResponseProblem, raw: FloatArray, lift: float) -> FloatArray:
    """Gains, hard ones times `lift`."""
    return np.asarray(np.where(problem.hard[:, None], raw * lift, raw))


def _lifted_noise(problem: ResponseProblem, noise: FloatArray, lift: float) -> FloatArray:
    """Noise, hard ones times `lift`."""
    return np.asarray(np.where(problem.hard_noise, noise * lift, noise))
