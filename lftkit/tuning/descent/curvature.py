"""Curvature of the Lagrangian, learned by damped BFGS updates as in sequential quadratic programming."""

from __future__ import annotations

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.descent.metric import Metric
from lftkit.tuning.pieces import OracleResult, matching_piece

MIN_MULTIPLIER = 1e-8  # pieces with a smaller multiplier say nothing about the Lagrangian
MIN_MATCHED = 0.3  # sum of the multipliers of matched pieces below which nothing is learned
POWELL = 0.2  # Powell's damping


class LagrangianCurvature:
    """Positive semidefinite matrix `B` (n, n) in the coordinates of the metric; zero until something is learned."""

    def __init__(self, n: int) -> None:
        self.B: FloatArray = np.zeros((n, n))
        self.learned = False

    def reset(self) -> None:
        """Forget everything."""
        self.B, self.learned = np.zeros_like(self.B), False

    def change_metric(self, old: Metric, new: Metric) -> None:
        """Express the matrix in the coordinates of another metric."""
        change = old.inverse @ new.T
        self.B = change.T @ self.B @ change

    @property
    def size(self) -> float:
        """Largest diagonal entry."""
        return float(np.abs(np.diag(self.B)).max(initial=0.0))

    def update(
        self, before: OracleResult, after: OracleResult, weights: FloatArray, step: FloatArray, metric: Metric
    ) -> float | None:
        """Learn from a step (n,) in the metric with the multipliers `weights` of the pieces before it.

        Answers the curvature along the step if it is the first one that was learned, otherwise None.
        """
        matched = 0.0
        dx_gradient: FloatArray = np.zeros(len(step))
        for weight, piece in zip(weights, before.pieces):
            if weight < MIN_MULTIPLIER:
                continue
            other = matching_piece(piece, after.pieces)
            if other is not None:
                dx_gradient += weight * (other.gradient - piece.gradient)
                matched += float(weight)
        if matched < MIN_MATCHED:
            return None
        y = metric.gradient(dx_gradient) / matched
        first = None
        if not self.learned:
            first = float(y @ step) / float(step @ step)
            if first <= 0.0:
                return None
            self.B = np.eye(len(step)) * min(first, float(y @ y) / max(float(y @ step), 1e-300))
            self.learned = True
        self._bfgs(step, y)
        return first

    def _bfgs(self, d: FloatArray, y: FloatArray) -> None:
        Bd = self.B @ d
        dBd, dy = float(d @ Bd), float(d @ y)
        if dBd <= 1e-300:
            return
        if dy < POWELL * dBd:
            y = y + (POWELL * dBd - dy) / (dBd - dy) * (Bd - y)
            dy = float(d @ y)
        if not dy > 1e-300:
            return
        B = self.B + np.outer(y, y) / dy - np.outer(Bd, Bd) / dBd
        if np.all(np.isfinite(B)):
            self.B = 0.5 * (B + B.T)
