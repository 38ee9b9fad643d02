"""Poles near the limit of stability, as constraints of a descent.

Where the best controller integrates, one of its poles ends at the limit, and so does the descent: a step along the
slopes of the gains alone crosses it, however short. Here such poles have slopes too, so that a step stays inside to
first order, and a step that crosses the limit by its curvature is brought back (a second-order correction, which
keeps the steps from becoming as short as the root of the margin: Maratos 1978).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrix
from lftkit.synthesis.extended_plant import ClosedLoopMatrices
from lftkit.tuning.gains.loop import eigenvectors
from lftkit.tuning.problem import Evaluation, Problem

REACH = 0.05  # relative change of the parameters: poles that it brings to the limit are followed
LOOKED_AT, MOST = 12, 3  # poles of one model: the slowest that are looked at, and those that are followed at most
REFINEMENTS = 4  # inverse iterations from the value at the point before
ALIKE = 0.8  # product of the eigenvectors before and after: below it is another pole
CORRECTIONS = 5
NEAR = 100.0  # times the least decay: poles that are followed from the first point on
LEAST_MARGIN, MARGIN = 1e-3, 0.5  # after a correction, in parts of the least decay
SAME_SLOPES = 1e-8  # relative eigenvalue of the Gram matrix below which slopes count as dependent

Solve = Callable[[FloatArray], FloatArray]
"""From gradients (size, m) to steps (size, m): the inverse of a metric."""


@dataclass(frozen=True)
class FollowedPole:
    """A closed-loop pole of a model [rad/s], its real part's gradient (size,) and its right eigenvector (n,)."""

    model: int
    value: complex
    gradient: FloatArray
    vector: ComplexArray


class DecayLimit:
    """The poles that a small change of the parameters brings to the limit ``-min_decay``.

    Parameters
    ----------
    problem : Problem
    x : ndarray, shape (size,)
        Stable point.
    """

    def __init__(self, problem: Problem, x: FloatArray) -> None:
        self._problem = problem
        self.poles: tuple[FollowedPole, ...] = self._near(x)

    def move_to(self, x: FloatArray) -> None:
        """The poles at `x` (size,), followed from the point before if they can be."""
        self.poles = self._followed(x, self.poles) or self._near(x)

    def restored(self, x: FloatArray, margin: float, solve: Solve) -> FloatArray | None:
        """The point nearest to `x` (size,) in a metric, to first order, with the followed poles inside the limit.

        Parameters
        ----------
        x : ndarray, shape (size,)
        margin : float
            That of the point before the step [rad/s].
        solve : callable
            Inverse of the metric.

        Returns
        -------
        ndarray, shape (size,), or None
            None where a few corrections do not bring them inside, or where the step is too long to follow them.
        """
        decay = self._problem.min_decay
        asked = decay + max(min(margin, MARGIN * decay), LEAST_MARGIN * decay)
        poles = self.poles
        for _ in range(CORRECTIONS):
            poles = self._followed(x, poles)
            slow = [pole for pole in poles if pole.value.real > -0.5 * (asked + decay)]
            if not slow:
                return x if poles else None
            G = np.array([pole.gradient for pole in slow])
            steps = np.asarray(solve(G.T))
            excess = np.array([pole.value.real + asked for pole in slow])
            weights: Any = linalg.lstsq(G @ steps, excess, cond=SAME_SLOPES)[0]
            x = x - steps @ weights
            if not self._problem.inside(x) or not np.all(np.isfinite(x)):
                return None
        return None

    def _near(self, x: FloatArray) -> tuple[FollowedPole, ...]:
        K = self._problem.structure.gain_matrix(x)
        return tuple(
            p for k in range(len(self._problem.models)) for p in self._near_of(x, k, self._problem.closed(k, K))
        )

    def _near_of(self, x: FloatArray, k: int, loop: ClosedLoopMatrices) -> list[FollowedPole]:
        values, left, right = eigenvectors(loop.A)
        size = np.abs(x) + 0.1 * float(np.sqrt(np.mean(x**2)))
        near: list[tuple[float, FollowedPole]] = []
        margins = -self._problem.min_decay - values.real
        for i in np.argsort(margins)[:LOOKED_AT]:
            if values[i].imag < 0.0:
                continue
            pole = self._pole(x, k, loop, complex(values[i]), left[:, i], right[:, i])
            reach = float(linalg.norm(size * pole.gradient))
            if margins[i] < REACH * reach:
                near.append((float(margins[i]) / reach, pole))
        return [pole for _, pole in sorted(near, key=lambda item: item[0])[:MOST]]

    def _followed(self, x: FloatArray, poles: Sequence[FollowedPole]) -> tuple[FollowedPole, ...]:
        """The poles at `x` (size,), by inverse iteration; none where one of them is lost."""
        K = self._problem.structure.gain_matrix(x)
        if self._problem.too_large(K):
            return ()
        loops = {pole.model: self._problem.closed(pole.model, K) for pole in poles}
        followed = []
        for pole in poles:
            new = self._followed_to(x, pole, loops[pole.model])
            if not abs(np.vdot(new.vector, pole.vector)) > ALIKE:
                return ()
            followed.append(new)
        return tuple(followed)

    def _followed_to(self, x: FloatArray, pole: FollowedPole, loop: ClosedLoopMatrices) -> FollowedPole:
        shift: Any = pole.value if pole.value.imag else pole.value.real
        shift = shift + 1e-9 * max(abs(shift), self._problem.min_decay)  # not the eigenvalue itself
        matrix = cast("Matrix", loop.A - shift * np.eye(len(loop.A)))
        factorise: Any = linalg.get_lapack_funcs("getrf", (matrix,))
        lu, pivots, info = factorise(matrix)
        if info:  # singular: the pole has not moved
            return pole
        factor = lu, pivots
        right: Any = pole.vector if pole.value.imag else pole.vector.real
        left: Any = right
        for _ in range(REFINEMENTS):
            right = linalg.lu_solve(factor, right, check_finite=False)
            left = linalg.lu_solve(factor, left, trans=2, check_finite=False)
            right, left = right / linalg.norm(right), left / linalg.norm(left)
        value = complex(np.vdot(left, loop.A @ right) / _scale(left, right))
        return self._pole(x, pole.model, loop, value, left, right)

    def _pole(
        self, x: FloatArray, k: int, loop: ClosedLoopMatrices, value: complex, left: ComplexArray, right: ComplexArray
    ) -> FollowedPole:
        slope = np.real(np.outer(loop.left.T @ left.conj() / _scale(left, right), loop.right @ right))
        gradient = np.asarray(self._problem.structure.pullback(x, slope), dtype=float)
        return FollowedPole(k, value, gradient, np.asarray(right, dtype=complex))


def _scale(left: ComplexArray, right: ComplexArray) -> complex:
    """Product of the eigenvectors; a defective pole has no derivative, a large finite one still points downhill."""
    scale = complex(np.vdot(left, right))
    return scale if abs(scale) > 1e-14 else 1e-14


class LimitWatch:
    """Follows poles as soon as one is near the limit or a trial was unstable: until then it costs nothing.

    Parameters
    ----------
    problem : Problem
    evaluation : Evaluation
        Values at the first point.
    near : bool
        Follow poles from the first point on.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation, near: bool) -> None:
        self.near = near or -evaluation.abscissa < NEAR * problem.min_decay
        self.solve: Solve = np.asarray
        self._problem = problem
        self._limit: DecayLimit | None = None

    def distances(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the followed poles from the limit (m,) [rad/s], positive, and gradients of their real parts (m, size)."""
        if not self.near:
            return np.zeros(0), np.zeros((0, len(x)))
        limit = self._limit
        if limit is None:
            limit = self._limit = DecayLimit(self._problem, x)
        else:
            limit.move_to(x)
        poles = limit.poles
        decay = self._problem.min_decay
        margins = [max(-decay - pole.value.real, LEAST_MARGIN * decay) for pole in poles]
        return np.array(margins), np.array([pole.gradient for pole in poles]).reshape(len(poles), len(x))

    def brought_back(self, x: FloatArray, trial: FloatArray, margin: float) -> FloatArray | None:
        """A point near the unstable `trial` (size,) inside the limit, for a step from the stable `x`, or None."""
        self.near = True
        if self._limit is None:
            self._limit = DecayLimit(self._problem, x)
        return self._limit.restored(trial, margin, self.solve) if self._limit.poles else None
