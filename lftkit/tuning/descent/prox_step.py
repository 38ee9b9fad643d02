"""One step of a prox-linear method (Lewis and Wright 2016): the part that is the same for every source of values.

A step minimises the largest linearised value plus a quadratic term, whose weight replaces the line search: it rises
until the step brings what was predicted, and is carried from step to step. Where the values come from, state-space
models or frequency responses, and what a point must be besides, is the caller's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.tuning.descent.simplex_qp import prox_direction

TRIALS = 10  # weights that are tried
ACCEPTED, GOOD, POOR = 0.1, 0.7, 0.3  # of the predicted decrease
LIGHTER, HEAVIER, REJECTED, LEAST = 1.0 / 3.0, 1.5, 4.0, 1e-5  # weight of the quadratic term
FIRST_WEIGHT = 1.0
METRIC = 3  # steps between two metrics


@dataclass(frozen=True)
class ProxStep:
    """Outcome of :func:`prox_step`.

    Parameters
    ----------
    taken : bool
        Some weight gave a decrease; otherwise the last trial is to be forgotten.
    weight : float
        Of the next step.
    """

    taken: bool
    weight: float


def prox_step(
    values: FloatArray,
    gradients: FloatArray,
    factor: Any,
    weight: float,
    planes: int,
    decrease: Callable[[FloatArray, float], float],
    stop: Callable[[], bool] = lambda: False,
) -> ProxStep:
    """Try steps of rising weight until one brings a tenth of what is predicted.

    Parameters
    ----------
    values, gradients : ndarray, shapes (m,) and (m, n)
        Of the pieces at the present point.
    factor
        Cholesky factor of the metric, of ``scipy.linalg.cho_factor``.
    weight : float
        Of the quadratic term.
    planes : int
        Largest values that enter the first quadratic program.
    decrease : callable
        From a step (n,) and its predicted decrease to the true one; minus infinity where the point is not admitted.
    stop : callable
        Whether to try no other weight.
    """
    chosen: IntArray = np.argsort(-values, kind="stable")[:planes]
    predicted = gained = 0.0
    for _ in range(TRIALS):
        step, predicted, chosen = prox_direction(values, gradients, factor, weight, chosen)
        gained = decrease(step, predicted) if predicted > 0.0 else -np.inf
        if gained > ACCEPTED * predicted or stop():
            break
        weight *= REJECTED
    if not gained > ACCEPTED * predicted:
        return ProxStep(False, FIRST_WEIGHT)
    ratio = gained / predicted
    return ProxStep(True, max(weight * (LIGHTER if ratio > GOOD else HEAVIER if ratio < POOR else 1.0), LEAST))
