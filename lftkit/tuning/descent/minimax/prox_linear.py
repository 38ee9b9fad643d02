"""Prox-linear steps on a working set (Lewis and Wright 2016), the same for every source of values.

A step minimises the largest linearised value plus a quadratic term, whose weight replaces the line search: it rises
until the step brings what was predicted, and is carried from step to step. What the values are, what a point must be
besides, and the metric, is the working set's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, IntArray
from lftkit.tuning.descent.minimax.simplex_qp import prox_direction
from lftkit.tuning.source import LocalModel, Merit, WorkingSet

TRIALS = 10  # weights that are tried
ACCEPTED, GOOD, POOR = 0.1, 0.7, 0.3  # of the predicted decrease
LIGHTER, HEAVIER, REJECTED, LEAST = 1.0 / 3.0, 1.5, 4.0, 1e-5  # weight of the quadratic term
FIRST_WEIGHT = 1.0
METRIC = 3  # steps between two metrics
STAGNATION = 4  # steps that together must bring more than what counts as slow


@dataclass(frozen=True)
class ProxLinear:
    """Last point (size,), weight of the next step, steps taken."""

    x: FloatArray
    weight: float
    taken: int


def prox_linear(
    working: WorkingSet, x: FloatArray, *, weight: float = FIRST_WEIGHT, stop: Callable[[], bool] = lambda: False
) -> ProxLinear:
    """Lower the values of a working set from `x` (size,).

    Ends after its number of steps, where no weight brings a decrease, when :data:`STAGNATION` steps are slow, or at
    `stop`.
    """
    history: list[Merit] = []
    factor: Any = None
    for taken in range(working.steps):
        if stop():
            return ProxLinear(x, weight, taken)
        here = working.at(x)
        if here.merit[1] == np.inf:  # there are no values to lower
            return ProxLinear(x, FIRST_WEIGHT, taken)
        history = history or [here.merit]
        if taken % METRIC == 0:
            try:
                factor = here.factor()
            except (linalg.LinAlgError, ValueError):  # values too large for a metric: no step can be told
                return ProxLinear(x, FIRST_WEIGHT, taken)
        step = _step(here, factor, weight, working.planes, stop)
        if step is None:
            return ProxLinear(x, FIRST_WEIGHT, taken)
        weight = step
        x, merit = here.reached
        history.append(merit)
        if len(history) > STAGNATION and _slow(history[-1 - STAGNATION], merit, working.slow):
            return ProxLinear(x, weight, taken + 1)
    return ProxLinear(x, weight, working.steps)


def _step(here: LocalModel, factor: Any, weight: float, planes: int, stop: Callable[[], bool]) -> float | None:
    """Try steps of rising weight until one brings a tenth of what is predicted: weight of the next step, or None."""
    values, gradients = here.values, here.gradients
    chosen: IntArray = np.argsort(-values, kind="stable")[:planes]
    predicted = gained = 0.0
    for _ in range(TRIALS):
        step, predicted, chosen = prox_direction(values, gradients, factor, weight, chosen)
        gained = here.decrease(step, predicted) if predicted > 0.0 else -np.inf
        if gained > ACCEPTED * predicted or stop():
            break
        weight *= REJECTED
    if not gained > ACCEPTED * predicted:
        return None
    ratio = gained / predicted
    return max(weight * (LIGHTER if ratio > GOOD else HEAVIER if ratio < POOR else 1.0), LEAST)


def _slow(before: Merit, now: Merit, least: float) -> bool:
    """Neither the violation fell by `least` nor, without one, the largest value."""
    return before[0] - now[0] < least and (now[0] > 0.0 or before[1] - now[1] < least)
