"""BFGS with a weak Wolfe line search in the coordinates of a metric (Lewis and Overton 2013).

Where the metric is renewed at every step no curvature is learned: this is the Gauss-Newton method with a line search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.metric import Metric

Function = Callable[[FloatArray], tuple[float, FloatArray]]

ARMIJO, WOLFE = 1e-4, 0.5
MAX_SEARCH = 25
FIRST_STEP = 0.3  # length of the first step in the metric
STAGNATION = 8  # steps that together must bring more than the tolerance


@dataclass(frozen=True)
class QuasiNewtonResult:
    """Best point, its value and gradient in the metric, steps taken."""

    x: FloatArray
    value: float
    gradient: FloatArray
    steps: int


def quasi_newton(
    function: Function,
    x: FloatArray,
    metric: Metric,
    *,
    steps: int,
    tolerance: float,
    floor: float = -np.inf,
    renewed: Callable[[FloatArray], Metric] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> QuasiNewtonResult:
    """Minimise `function` (infinite outside its domain) from `x` (n,), inside the domain.

    `renewed` gives a new metric after every step. Ends after `steps` steps, below `floor`, when :data:`STAGNATION`
    steps together bring less than `tolerance`, or at `stop`.
    """
    f, gx = function(x)
    g = metric.gradient(gx)
    H: FloatArray | None = None
    history = [f]
    taken = 0
    while taken < steps and f > floor and not stop():
        d = -g if H is None else -(H @ g)
        slope = float(g @ d)
        if not slope < 0.0:
            if H is None:
                break
            H = None
            continue
        first = min(1.0, FIRST_STEP / max(float(linalg.norm(d)), 1e-300)) if H is None else 1.0
        accepted = _weak_wolfe(function, x, f, slope, metric, d, first, stop)
        if accepted is None:
            if H is None:
                break
            H = None
            continue
        t, new_x, new_f, new_g = accepted
        s, y = t * d, new_g - g
        x, f, g = new_x, new_f, new_g
        if renewed is None:
            H = _updated(H, s, y)
        else:
            gradient = metric.inverse.T @ g
            metric = renewed(x)
            g = metric.gradient(gradient)
        history.append(f)
        taken += 1
        if len(history) > STAGNATION and history[-1 - STAGNATION] - f < tolerance:
            break
    return QuasiNewtonResult(x, f, g, taken)


def _updated(H: FloatArray | None, s: FloatArray, y: FloatArray) -> FloatArray | None:
    size = float(linalg.norm(s))
    if size < np.finfo(float).tiny:
        return H
    s, y = s / size, y / size  # the update is the same, and the products of short steps do not underflow
    sy = float(s @ y)
    if not sy > 1e-14 * float(linalg.norm(y)):
        return H
    if H is None:
        H = np.eye(len(s)) * (sy / float(y @ y))
    Hy = H @ y
    H = H + np.outer(s, s) * ((sy + float(y @ Hy)) / sy**2) - (np.outer(Hy, s) + np.outer(s, Hy)) / sy
    return np.asarray(0.5 * (H + H.T))


def _weak_wolfe(
    function: Function,
    x: FloatArray,
    f: float,
    slope: float,
    metric: Metric,
    d: FloatArray,
    first: float,
    stop: Callable[[], bool],
) -> tuple[float, FloatArray, float, FloatArray] | None:
    """Bisection and expansion; the last point of sufficient decrease if the budget ends before the Wolfe condition."""
    low, high, t = 0.0, np.inf, first
    best: tuple[float, FloatArray, float, FloatArray] | None = None
    for _ in range(MAX_SEARCH):
        if stop():
            break
        trial = x + metric.step(t * d)
        value, gx = function(trial)
        if not value <= f + ARMIJO * t * slope:
            high = t
        else:
            g = metric.gradient(gx)
            best = (t, trial, value, g)
            if float(g @ d) >= WOLFE * slope:
                return best
            low = t
        t = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
        if best is not None and high - low < 1e-3 * high:
            return best
    return best
