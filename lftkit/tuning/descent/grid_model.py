"""What a step of the descent sees: values on a grid, linearised at a point, and poles near the limit of stability."""

from __future__ import annotations

from typing import Any, Protocol, cast

import numpy as np
from scipy import linalg

from lftkit.arrays import BoolArray, FloatArray, Matrix
from lftkit.tuning.descent.decay_limit import LimitWatch

USED_MARGIN = 0.9  # fraction of the linearised distance to the limit of stability that a step may use


class GridValues(Protocol):
    """Logarithms of all values on a grid; a hard one is relative to the level that it shall keep."""

    limit_watch: LimitWatch

    def largest(self, x: FloatArray) -> tuple[float, float]:
        """Of the soft and of the hard values at `x` (size,); infinite where a loop is unstable."""
        ...

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Those near the largest ones (m,), gradients (m, size), which of them are hard."""
        ...

    def gauss_newton(self, x: FloatArray) -> FloatArray:
        """Metric of the steps (size, size)."""
        ...


class GridModel:
    """Logarithms of the values near the largest ones, linearised at a point: pieces of the progress function.

    Hard ones are relative to the level that they shall keep, soft ones to the largest soft one. A pole near the limit
    of stability is a piece that reaches the largest value where a step has used most of the distance.
    """

    def __init__(self, grid: GridValues, x: FloatArray) -> None:
        self._grid, self._x = grid, x
        soft, hard = grid.largest(x)
        self.merit = max(hard, 0.0), soft
        logs, self.gradients, self.hard = grid.linearised(x)
        self.values: FloatArray = np.where(self.hard, logs, logs - soft) - self.merit[0]
        self.reached = x, self.merit
        margins, slopes = grid.limit_watch.distances(x)
        self._margin = float(margins.min(initial=np.inf))
        if len(margins):
            level = float(self.values.max()) - USED_MARGIN
            self.values = np.concatenate([self.values, np.full(len(margins), level)])
            self.gradients = np.concatenate([self.gradients, slopes / margins[:, None]])

    def factor(self) -> Any:
        """Of the Gauss-Newton matrix."""
        factor = linalg.cho_factor(cast("Matrix", self._grid.gauss_newton(self._x)))
        self._grid.limit_watch.solve = lambda G: np.asarray(linalg.cho_solve(factor, G))
        return factor

    def decrease(self, step: FloatArray, predicted: float) -> float:
        """Of the progress function at the trial point, or where it was brought back to; minus infinity if unstable."""
        x = self._x + step
        soft, hard = self._grid.largest(x)
        if soft == np.inf and (back := self._grid.limit_watch.brought_back(self._x, x, self._margin)) is not None:
            x = back
            soft, hard = self._grid.largest(x)
        violation, before = self.merit
        self.reached = x, (max(hard, 0.0), soft)
        return -max(soft - before - violation, hard - violation)
