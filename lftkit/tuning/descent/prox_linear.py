"""Prox-linear steps on all gains of a fixed grid at once (Lewis and Wright 2016), in the Gauss-Newton metric.

A step minimises the largest linearised logarithm of the values plus a quadratic term whose weight replaces the line
search. Hard requirements enter by the progress function of the bundle method, in logarithms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.simplex_qp import prox_direction
from lftkit.tuning.descent.smooth_objective import Linearisation, SmoothObjective

METRIC = 3  # steps between two metrics
PLANES, TRIALS = 120, 10  # planes of the first quadratic program of a step; weights that are tried
ACCEPTED, GOOD, POOR = 0.1, 0.7, 0.3  # of the predicted decrease
LIGHTER, HEAVIER, REJECTED, LEAST = 1.0 / 3.0, 1.5, 4.0, 1e-5  # weight of the quadratic term
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
        violation = max(hard, 0.0)
        offsets = _offsets(here, soft, violation)
        planes = np.argsort(-offsets, kind="stable")[:PLANES]
        for _ in range(TRIALS):
            d, predicted, planes = prox_direction(offsets, here.gradients, factor, weight, planes)
            new_soft, new_hard = objective.largest(x + d) if predicted > 0.0 else (np.inf, np.inf)
            gained = -max(new_soft - soft - violation, new_hard - violation)
            if gained > ACCEPTED * predicted or stop():
                break
            weight *= REJECTED
        if not gained > ACCEPTED * predicted:
            weight = 1.0
            break
        x, soft, hard = x + d, new_soft, new_hard
        ratio = gained / predicted
        weight = max(weight * (LIGHTER if ratio > GOOD else HEAVIER if ratio < POOR else 1.0), LEAST)
        history.append((soft, max(hard, 0.0)))
        taken += 1
        if len(history) > STAGNATION and _slow(history[-1 - STAGNATION], history[-1], tolerance):
            break
    return x, weight


def _slow(before: tuple[float, float], now: tuple[float, float], tolerance: float) -> bool:
    """Neither the violation fell by the tolerance nor, without one, the largest soft value."""
    return before[1] - now[1] < tolerance and (now[1] > 0.0 or before[0] - now[0] < tolerance)


def _offsets(here: Linearisation, soft: float, violation: float) -> FloatArray:
    """Values of the progress function's pieces at the present point (m,)."""
    return np.asarray(np.where(here.hard, here.values, here.values - soft) - violation)
