"""Gradient sampling for nonsmooth functions (Burke, Lewis and Overton, SIAM J. Optim. 15, 751-779, 2005).

A step goes along the shortest convex combination of gradients at points sampled in a ball; where that is short, or no
step descends, the ball shrinks. A rival of the tuner in ``benchmarks/tuning.py``.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

RADIUS, SHRINK = 0.1, 0.1  # of the ball, relative to 1 + |x|
SHORT = 1e-6  # length of the combination, relative to the gradient, below which the ball shrinks
SMALLEST = 1e-8
ARMIJO, HALVINGS = 1e-4, 30

Function = Callable[[np.ndarray], tuple[float, np.ndarray]]


def shortest_combination(gradients: np.ndarray) -> np.ndarray:
    """The shortest vector (n,) in the convex hull of the rows (k, n)."""
    size = np.abs(gradients).max()
    if not size > 0.0:
        return np.zeros(gradients.shape[1])
    # of nonnegative weights with sum 1: least squares with the sum as an equation, scaled back afterwards
    rows = np.vstack([gradients.T / size, np.ones(len(gradients))])
    weights = nnls(rows, np.append(np.zeros(gradients.shape[1]), 1.0))[0]
    return np.asarray(weights @ gradients / weights.sum())


def by_sampling(function: Function, x: np.ndarray, deadline: float, seed: int = 0) -> np.ndarray:
    """Point that gradient sampling reaches from an `x` with a finite value until `deadline` (``time.monotonic``)."""
    rng = np.random.default_rng(seed)
    f, g = function(x)
    radius = RADIUS * (1.0 + float(np.linalg.norm(x)))
    smallest = SMALLEST * radius / RADIUS
    while radius > smallest and time.monotonic() < deadline:
        gradients = [g]
        for direction in rng.standard_normal((len(x) + 1, len(x))):
            length = radius * rng.uniform() ** (1.0 / len(x)) / np.linalg.norm(direction)
            value, slope = function(x + length * direction)
            if np.isfinite(value):
                gradients.append(slope)
        d = shortest_combination(np.array(gradients))
        size = float(np.linalg.norm(d))
        step = _step(function, x, f, -d, size**2) if size > SHORT * np.linalg.norm(g) else None
        if step is None:
            radius *= SHRINK
        else:
            x, f, g = step
    return x


def _step(
    function: Function, x: np.ndarray, f: float, d: np.ndarray, decrease: float
) -> tuple[np.ndarray, float, np.ndarray] | None:
    """The first of halved steps with a sufficient decrease; None where there is none."""
    t = 1.0
    for _ in range(HALVINGS):
        value, slope = function(x + t * d)
        if value < f - ARMIJO * t * decrease:
            return x + t * d, value, slope
        t *= 0.5
    return None
