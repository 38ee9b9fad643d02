"""Nonsmooth constrained minimisation of a finite maximum of smooth pieces, not convex.

Each step solves a quadratic program on all nearly active pieces at once (Apkarian and Noll 2006, "multi-peak"),
with the curvature of the Lagrangian learned by damped BFGS as in sequential quadratic programming, a
proximity term instead of a line search, and cutting planes from rejected points (a bundle). Constraints enter through
the progress function ``F(y; x) = max(f(y) - f(x) - [c(x)]_+, c(y) - [c(x)]_+)``, so that infeasible points first become
feasible. Where progress stops without a certificate, gradients sampled nearby (Burke, Lewis and Overton
2005) enrich the pieces. All of it happens in the coordinates of a metric (:mod:`lftkit.tuning.descent.metric`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrix
from lftkit.errors import InputError
from lftkit.tuning.descent.curvature import LagrangianCurvature
from lftkit.tuning.descent.linearisation_bundle import LinearisationBundle
from lftkit.tuning.descent.metric import MetricSource, diagonal_metric
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.minimax.simplex_qp import simplex_minimum
from lftkit.tuning.pieces import Oracle, OracleResult
from lftkit.tuning.status import TuningStatus

ACCEPTED, GOOD, POOR = 0.05, 0.6, 0.25  # of the predicted decrease
MIN_PROXIMITY, MAX_PROXIMITY = 1e-8, 1e14
MIN_PROXIMITY_AFTER_REJECTION = 1e-6
PROXIMITY_GOOD, PROXIMITY_POOR, PROXIMITY_REJECTED, PROXIMITY_OUTSIDE = 0.3, 2.0, 4.0, 10.0
METRIC_LEVEL = 0.5  # the metric is rebuilt when the value has fallen to this fraction
METRIC_MIN_LEVEL = 1e-3  # but not for values below this fraction of the first one
SLOW_STEPS, SLOW_DECREASE = 15, 1e-5
MAX_SAMPLINGS, MAX_SAMPLINGS_NEAR = 6, 2
NEAR_STATIONARY = 10.0  # times the tolerance
MAX_REJECTED = 12  # rejected steps in a row after which a stationary point is not improved any more
ACTIVE_REACH, ACTIVE_RADIUS = 3.0, 0.1
RADIUS = 1e-3  # in the metric, within which pieces count as nearly active in the certificate of a stationary point


@dataclass(frozen=True)
class BundleResult:
    """Outcome of :func:`minimise`: best point, its oracle result, why it ended, certificate and counts.

    ``converged`` is a point that is stationary for the pieces found there, ``stalled`` one that is not nearly so.
    """

    x: FloatArray
    result: OracleResult
    status: TuningStatus
    stationarity: float
    iterations: int
    evaluations: int


def minimise(
    oracle: Oracle,
    x0: FloatArray,
    options: DescentOptions,
    rng: np.random.Generator,
    metric: MetricSource = diagonal_metric,
) -> BundleResult:
    """Minimise the largest soft piece from `x0` (n,), inside the domain.

    The hard pieces are to be at most :data:`lftkit.tuning.pieces.HARD_TARGET`.

    Parameters
    ----------
    oracle : callable
        From a point (n,) to an :class:`OracleResult`.
    x0 : ndarray, shape (n,)
    options : DescentOptions
    rng : Generator
        For the sampled gradients.
    metric : callable
        Metric at a point; asked for at the start and whenever the value has halved.

    Raises
    ------
    ValueError
        The start is outside the domain.
    """
    descent = _Running(oracle, np.array(x0, dtype=float), options, rng, metric)
    status: TuningStatus | None = None
    try:
        while status is None and descent.iterations < options.iterations:
            status = descent.step()
    except KeyboardInterrupt:
        status = TuningStatus.INTERRUPTED
    return BundleResult(
        descent.x,
        descent.result,
        status or TuningStatus.ITERATIONS,
        descent.stationarity,
        descent.iterations,
        descent.evaluations,
    )


class _Running:
    """The running minimisation."""

    def __init__(
        self,
        oracle: Oracle,
        x: FloatArray,
        options: DescentOptions,
        rng: np.random.Generator,
        metric_source: MetricSource,
    ) -> None:
        self._oracle, self._options, self._rng, self._metric_source = oracle, options, rng, metric_source
        self.evaluations = self.iterations = self._rejected = 0
        self.stationarity = np.inf
        self.x, self.result = x, self._ask(x)
        if not self.result.inside and not np.isfinite(self.result.constraint):
            raise InputError("x0 must be inside the domain, got an unstable loop: stabilise it first")
        self._first_value = self._metric_value = max(abs(self.result.objective), 1e-12)
        self._metric = metric_source(x, self.result)
        self._curvature = LagrangianCurvature(len(x))
        self._bundle = LinearisationBundle()
        self._proximity = self._first_proximity()
        self._accepted_values: list[float] = []

    def _ask(self, x: FloatArray) -> OracleResult:
        self.evaluations += 1
        return self._oracle(x)

    def _first_proximity(self) -> float:
        """Such that a step along the largest gradient has about the length 1 / 2."""
        slopes = [float(linalg.norm(self._metric.gradient(p.gradient))) for p in self.result.pieces]
        return 2.0 * max(slopes, default=0.0) + 1e-9

    def step(self) -> TuningStatus | None:
        """One quadratic program and one trial; the reason to stop or None."""
        self.iterations += 1
        options = self._options
        if time.monotonic() > options.deadline:
            return TuningStatus.OUT_OF_TIME
        if self.evaluations >= options.evaluations:
            return TuningStatus.ITERATIONS
        if self.result.objective < options.target and self.result.constraint <= 0:
            return TuningStatus.TARGET
        if self.result.settled:
            self.stationarity = 0.0
            return TuningStatus.CONVERGED
        offsets, G = self._bundle.linear_model(self.x, self.result, self._metric)
        self.stationarity = self._stationarity(offsets, G)
        feasible = self.result.constraint <= 0
        level = abs(self.result.objective) + 1e-6 * self._first_value if feasible else 1.0
        stationary = self.stationarity <= options.tolerance * level
        weights, d = self._direction(offsets, G)
        predicted = float((offsets + G @ d).max())
        if stationary and (self._rejected > MAX_REJECTED or predicted >= -1e-3 * options.tolerance * level):
            return TuningStatus.CONVERGED
        if predicted > -1e-12 * level or self._proximity > MAX_PROXIMITY:
            return TuningStatus.CONVERGED if stationary else self._sample_gradients()
        trial = self.x + self._metric.step(d)
        answer = self._ask(trial)
        gained = _progress(answer, self.result)
        if gained <= ACCEPTED * predicted:
            self._accept(trial, answer, weights, d, gained / predicted)
            return self._sample_gradients() if self._slow(level) else None
        self._reject(answer, trial, weights, d)
        return None

    def _stationarity(self, offsets: FloatArray, G: FloatArray) -> float:
        """Norm of the smallest convex combination of the gradients that are active within the radius."""
        r = RADIUS
        reach = ACTIVE_REACH * r * float(np.sqrt(np.sum(G**2, axis=1).max()))
        near = offsets >= offsets.max() - max(reach, 1e-14)
        G, offsets = G[near], offsets[near] - offsets.max()
        # pieces that a step of a tenth of the radius makes active count as active
        offsets = np.minimum(offsets + ACTIVE_RADIUS * r * np.sqrt(np.sum(G**2, axis=1)), 0.0)
        _, value = simplex_minimum(r * r * (G @ G.T), offsets)
        return float(np.sqrt(max(2.0 * value, 0.0)) / r)

    def _direction(self, offsets: FloatArray, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        identity = np.eye(len(self.x))
        try:
            factor = linalg.cho_factor(cast("Matrix", self._curvature.B + self._proximity * identity), lower=True)
        except linalg.LinAlgError:
            # rounding has destroyed the definiteness of the learned curvature: start learning again
            self._proximity = max(self._proximity, 1e-6 * self._curvature.size)
            self._curvature.reset()
            factor = linalg.cho_factor(cast("Matrix", self._proximity * identity), lower=True)
        QG = linalg.cho_solve(factor, G.T)
        weights, _ = simplex_minimum(G @ QG, offsets)
        return weights, -(QG @ weights)

    def _learn(self, answer: OracleResult, weights: FloatArray, d: FloatArray) -> None:
        first = self._curvature.update(self.result, answer, weights, d, self._metric)
        if first is not None:
            self._proximity = min(self._proximity, max(0.1 * first, MIN_PROXIMITY))

    def _accept(
        self, trial: FloatArray, answer: OracleResult, weights: FloatArray, d: FloatArray, ratio: float
    ) -> None:
        self._learn(answer, weights, d)
        self.x, self.result = trial, answer
        self._accepted_values.append(answer.objective)
        self._bundle.clear()
        self._rejected = 0
        self._renew_metric()
        if ratio > GOOD:
            least = max(MIN_PROXIMITY, 1e-12 * self._curvature.size)
            self._proximity = max(self._proximity * PROXIMITY_GOOD, least)
        elif ratio < POOR:
            self._proximity *= PROXIMITY_POOR

    def _renew_metric(self) -> None:
        """Another metric whenever the value has halved: the first point may have been near the boundary."""
        value = abs(self.result.objective) if self.result.constraint <= 0 else self._metric_value
        if value > METRIC_LEVEL * self._metric_value or value < METRIC_MIN_LEVEL * self._first_value:
            return
        self._metric_value = value
        old, self._metric = self._metric, self._metric_source(self.x, self.result)
        self._curvature.change_metric(old, self._metric)
        change = float(np.sum((old.inverse @ self._metric.T) ** 2)) / len(self.x)
        self._proximity *= change

    def _reject(self, answer: OracleResult, trial: FloatArray, weights: FloatArray, d: FloatArray) -> None:
        self._rejected += 1
        proximity = max(self._proximity, MIN_PROXIMITY_AFTER_REJECTION)
        if not answer.inside:
            self._proximity = proximity * PROXIMITY_OUTSIDE
            return
        self._learn(answer, weights, d)
        self._bundle.add_rejected(answer, trial)
        self._proximity = max(self._proximity, MIN_PROXIMITY_AFTER_REJECTION) * PROXIMITY_REJECTED

    def _slow(self, level: float) -> bool:
        """The last accepted steps brought next to nothing together."""
        recent = self._accepted_values[-SLOW_STEPS:]
        return (
            len(recent) == SLOW_STEPS and self.result.constraint <= 0 and recent[0] - recent[-1] < SLOW_DECREASE * level
        )

    def _sample_gradients(self) -> TuningStatus | None:
        """Sample gradients around the point; give up when that has been done at every radius."""
        nearly = self.stationarity <= NEAR_STATIONARY * self._options.tolerance * abs(self.result.objective)
        if self._bundle.rounds >= (MAX_SAMPLINGS_NEAR if nearly else MAX_SAMPLINGS):
            return TuningStatus.CONVERGED if nearly else TuningStatus.STALLED
        deadline = self._options.deadline
        self.evaluations += self._bundle.sample(
            self._oracle, self.x, self._metric, self._rng, lambda: time.monotonic() > deadline
        )
        self._proximity = self._first_proximity()
        self._curvature.reset()
        self._accepted_values = []
        return None


def _progress(answer: OracleResult, present: OracleResult) -> float:
    if not answer.inside:
        return np.inf
    c = max(present.constraint, 0.0)
    return float(max(answer.objective - present.objective - c, answer.constraint - c))
