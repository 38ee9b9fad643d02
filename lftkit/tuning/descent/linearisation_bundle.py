"""Piecewise linear model of the progress function: active pieces, barriers, cutting planes, sampled gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.metric import Metric
from lftkit.tuning.pieces import HARD_TARGET, Oracle, OracleResult

USED_MARGIN = 0.9  # fraction of the linearised distance to the boundary of the domain that a step may use
MAX_PLANES, PLANES_PER_POINT = 60, 3
PLANE_CURVATURE = 1e-3  # planes taken far away lose weight with the square of the distance
MAX_SAMPLED, SAMPLED_PER_POINT = 120, 2
FIRST_RADIUS, RADIUS_REDUCTION = 1e-3, 0.2
MAX_POINTS = 20


@dataclass(frozen=True)
class Plane:
    """Linearisation ``value + gradient' (x - point)`` of one piece."""

    value: float
    gradient: FloatArray
    point: FloatArray
    hard: bool


@dataclass
class LinearisationBundle:
    """Linearisations that are kept beside the pieces of the present point.

    Parameters
    ----------
    planes : list of Plane
        From rejected trial points.
    sampled : list of Plane
        From points sampled around the present one (Burke, Lewis and Overton 2005).
    radius : float
        Radius of the next sampling, in the coordinates of the metric.
    rounds : int
        Samplings so far.
    """

    planes: list[Plane] = field(default_factory=list)
    sampled: list[Plane] = field(default_factory=list)
    radius: float = FIRST_RADIUS
    rounds: int = 0

    def clear(self) -> None:
        """Forget the linearisations after an accepted step."""
        self.planes, self.sampled = [], []
        self.radius = FIRST_RADIUS

    def add_rejected(self, result: OracleResult, point: FloatArray) -> None:
        """Keep the largest pieces of a rejected trial point."""
        new = [Plane(p.value, p.gradient, point, p.hard) for p in result.largest(PLANES_PER_POINT)]
        self.planes = [*self.planes, *new][-MAX_PLANES:]

    def sample(
        self,
        oracle: Oracle,
        x: FloatArray,
        metric: Metric,
        rng: np.random.Generator,
        stop: Callable[[], bool] = lambda: False,
    ) -> int:
        """Sample gradients around `x` until `stop` and reduce the radius; answers the number of evaluations."""
        self.rounds += 1
        count = min(2 * len(x), MAX_POINTS)
        for k in range(count):
            if stop():
                return k
            u = rng.standard_normal(len(x))
            point = x + metric.step(self.radius * u / linalg.norm(u))
            near = oracle(point)
            if near.inside:
                self.sampled += [Plane(p.value, p.gradient, point, p.hard) for p in near.largest(SAMPLED_PER_POINT)]
        self.sampled = self.sampled[-MAX_SAMPLED:]
        self.radius *= RADIUS_REDUCTION
        return count

    def linear_model(self, x: FloatArray, result: OracleResult, metric: Metric) -> tuple[FloatArray, FloatArray]:
        """Offsets (m,) and gradients (m, n) in the metric of the progress function's pieces at `x`."""
        f, c = result.objective, max(result.constraint, 0.0)
        level = max(abs(f), c) if np.isfinite(f) else 1.0
        offsets = [(p.value - HARD_TARGET - c) if p.hard else (p.value - f - c) for p in result.pieces]
        gradients = [p.gradient for p in result.pieces]
        for margin, slope in result.barriers:
            offsets.append(-USED_MARGIN * level)
            gradients.append(slope * (level / max(-margin, 1e-300)))
        for plane in (*self.planes, *self.sampled):
            shift = metric.coordinates(x - plane.point)
            here = plane.value + plane.gradient @ (x - plane.point) - ((HARD_TARGET + c) if plane.hard else (f + c))
            curved = PLANE_CURVATURE * (abs(f) if np.isfinite(f) else 1.0) * float(shift @ shift)
            offsets.append(min(float(here), 0.0) - curved)
            gradients.append(plane.gradient)
        return np.array(offsets), np.array(gradients) @ metric.T
