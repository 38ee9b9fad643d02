"""Prox-linear steps on all gains of a fixed grid at once (Lewis and Wright 2016), in the Gauss-Newton metric.

A step minimises the largest linearised logarithm of the values plus a quadratic term whose weight replaces the line
search. Hard requirements enter by the progress function of the bundle method, in logarithms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.prox_step import METRIC, prox_step
from lftkit.tuning.descent.smooth_objective import Linearisation, SmoothObjective

PLANES = 120  # of the first quadratic program of a step
STAGNATION = 4  # steps that together must bring more than the tolerance


def prox_linear(
    objective: SmoothObjective,
    x: FloatArray,
    *,
    steps: int,
    tolerance: float,
    weight: float = 1.0,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[FloatArray, float]:
    """Lower the largest soft value from `x` (n,), the hard ones kept or lowered: last point, weight of the next step.

    Ends after `steps` steps, when :data:`STAGNATION` steps together bring less than `tolerance`, or at `stop`.
    """
    soft, hard = objective.largest(x)
    history = [(soft, max(hard, 0.0))]
    factor: Any = None
    taken = 0
    while taken < steps and not stop():
        here = objective.linearised(x)
        if taken % METRIC == 0 or factor is None:
            factor = linalg.cho_factor(objective.gauss_newton(x))
        trial = _Trial(objective, x, soft, max(hard, 0.0))
        offsets = _offsets(here, soft, trial.violation)
        step = prox_step(offsets, here.gradients, factor, weight, PLANES, trial, stop)
        weight = step.weight
        if not step.taken:
            break
        x, soft, hard = trial.reached
        history.append((soft, max(hard, 0.0)))
        taken += 1
        if len(history) > STAGNATION and _slow(history[-1 - STAGNATION], history[-1], tolerance):
            break
    return x, weight


@dataclass
class _Trial:
    """Decrease of the progress function by a step from a point, and the last point with its values."""

    objective: SmoothObjective
    start: FloatArray
    soft: float
    violation: float
    reached: tuple[FloatArray, float, float] = field(init=False)

    def __call__(self, step: FloatArray, predicted: float) -> float:
        x = self.start + step
        soft, hard = self.objective.largest(x)
        self.reached = x, soft, hard
        return -max(soft - self.soft - self.violation, hard - self.violation)


def _slow(before: tuple[float, float], now: tuple[float, float], tolerance: float) -> bool:
    """Neither the violation fell by the tolerance nor, without one, the largest soft value."""
    return before[1] - now[1] < tolerance and (now[1] > 0.0 or before[0] - now[0] < tolerance)


def _offsets(here: Linearisation, soft: float, violation: float) -> FloatArray:
    """Values of the progress function's pieces at the present point (m,)."""
    return np.asarray(np.where(here.hard, here.values, here.values - soft) - violation)
