"""Nonsmooth constrained minimisation of a finite maximum of smooth pieces, not convex.

Each step solves a quadratic program on all nearly active pieces at once (Apkarian and Noll 2006, "multi-peak"),
with the curvature of the Lagrangian learned by damped BFGS as in sequential quadratic programming, a
proximity term instead of a line search, and cutting planes from rejected points (a bundle). Constraints enter through
the progress function ``F(y; x) = max(f(y) - f(x) - [c(x)]_+, c(y) - [c(x)]_+)``, so that infeasible points first become
feasible. Where progress stops without a certificate, gradients sampled nearby (Burke, Lewis and Overton
2005) enrich the pieces.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from robust_design.simplex_qp import simplex_minimum

FloatArray = NDArray[np.float64]
sl: Any = scipy.linalg


class PieceLike(Protocol):
    """A smooth piece: value, gradient, whether it is a constraint, and what it belongs to."""

    @property
    def value(self) -> float: ...
    @property
    def gradient(self) -> FloatArray: ...
    @property
    def hard(self) -> bool: ...
    @property
    def requirement(self) -> int: ...
    @property
    def model(self) -> int: ...
    @property
    def place(self) -> float: ...


@dataclass(frozen=True)
class Sample:
    """What the oracle says at a point.

    Parameters
    ----------
    objective : float
        Largest soft value; infinite outside the domain (an unstable loop).
    constraint : float
        Largest hard value minus 1; minus infinity without constraints.
    pieces : sequence of pieces
    barriers : sequence of (margin, gradient)
        Margins to the border of the domain (negative inside, 0 on it) with gradients (n,): they bound the step, so that
        a step towards instability is seen before it is tried.
    """

    objective: float
    constraint: float
    pieces: tuple[Any, ...]
    barriers: tuple[tuple[float, FloatArray], ...] = ()


@dataclass(frozen=True)
class DescentOptions:
    """Limits and tolerances of :func:`minimise`.

    Parameters
    ----------
    iterations : int
        Most quadratic programs.
    tolerance : float
        Stationary when the smallest convex combination of nearly active gradients, in scaled variables, is
        below this fraction of the value.
    radius : float
        Scaled radius within which pieces count as nearly active in that certificate.
    target : float
        Stop as soon as the objective is below (and the constraints hold).
    deadline : float
        Value of ``time.monotonic()`` at which to stop.
    """

    iterations: int = 300
    tolerance: float = 1e-4
    radius: float = 1e-3
    target: float = -np.inf
    deadline: float = np.inf


@dataclass
class Descent:
    """Outcome of :func:`minimise`: best point, its sample, why it stopped, certificate and counts."""

    x: FloatArray
    sample: Sample
    reason: str
    stationarity: float
    iterations: int
    evaluations: int
    history: list[float] = field(default_factory=list)


Oracle = Callable[[FloatArray], Sample]
Watcher = Callable[[int, Sample, float], None]

BELOW = {"accept": 0.05, "good": 0.6}
KEPT_MARGIN = 0.9  # a step may use this much of the linearised distance to the border of the domain
FLOOR_PROXIMITY, CEILING_PROXIMITY = 1e-8, 1e14


def minimise(
    oracle: Oracle,
    x0: FloatArray,
    options: DescentOptions,
    rng: np.random.Generator,
    watch: Watcher | None = None,
) -> Descent:
    """Minimise the largest soft piece subject to the hard pieces being at most 1, from `x0` (n,), inside the domain.

    Returns
    -------
    Descent
        ``reason`` is ``stationary``, ``nearly stationary`` (no progress, within ten times the tolerance),
        ``target``, ``stalled``, ``iterations``, ``deadline`` or ``interrupted``.
    """
    state = _State(oracle, np.array(x0, dtype=float), options, rng)
    reason = "iterations"
    try:
        for _ in range(options.iterations):
            reason = state.step()
            if watch is not None:
                watch(state.iterations, state.sample, state.stationarity)
            if reason:
                break
        else:
            reason = "iterations"
    except KeyboardInterrupt:
        reason = "interrupted"
    return Descent(
        state.x, state.sample, reason, state.stationarity, state.iterations, state.evaluations, state.history
    )


class _State:
    """The running minimisation, in variables scaled so that every parameter matters about equally."""

    def __init__(self, oracle: Oracle, x: FloatArray, options: DescentOptions, rng: np.random.Generator) -> None:
        self._oracle, self._options, self._rng = oracle, options, rng
        self.evaluations, self.iterations, self._rejected, self._sampling_rounds = 0, 0, 0, 0
        self.history: list[float] = []
        self.stationarity = np.inf
        self.x = x
        self.sample = self._ask(x)
        if not np.isfinite(self.sample.objective) and not np.isfinite(self.sample.constraint):
            raise ValueError("the starting point is outside the domain: stabilise it first")
        self._first = max(abs(self.sample.objective), 1e-12)
        self._scaled_at = self._first
        self._scale = _scales(self.sample, x)
        self._B: FloatArray = np.zeros((len(x), len(x)))
        self._proximity = self._first_proximity()
        self._planes: list[tuple[float, FloatArray, FloatArray, bool]] = []
        self._sampled: list[tuple[float, FloatArray]] = []
        self._sampling = 1e-3
        self._fresh = True

    def _ask(self, x: FloatArray) -> Sample:
        self.evaluations += 1
        return self._oracle(x)

    def _first_proximity(self) -> float:
        """Such that a step along the largest gradient has about the length 1 / 2."""
        return 2.0 * max(float(sl.norm(p.gradient * self._scale)) for p in self.sample.pieces) + 1e-9

    def step(self) -> str:
        """One quadratic program and one trial; the reason to stop or an empty string."""
        self.iterations += 1
        if time.monotonic() > self._options.deadline:
            return "deadline"
        if self.sample.objective < self._options.target and self.sample.constraint <= 0:
            return "target"
        offsets, G = self._model()
        self.stationarity = self._certificate(offsets, G)
        level = abs(self.sample.objective) + 1e-6 * self._first if self.sample.constraint <= 0 else 1.0
        if self.stationarity <= self._options.tolerance * level and not self._worth_more(offsets, G, level):
            return "stationary"
        lam, d = self._direction(offsets, G)
        predicted = float((offsets + G @ d).max())
        if predicted > -1e-12 * level or self._proximity > CEILING_PROXIMITY:
            return "stationary" if self.stationarity <= self._options.tolerance * level else self._enrich()
        trial = self.x + self._scale * d
        found = self._ask(trial)
        gained = _progress(found, self.sample)
        if gained <= BELOW["accept"] * predicted:
            self._accept(trial, found, lam, d, gained / predicted)
            return "" if not self._slow(level) else self._enrich()
        self._reject(found, trial, lam, d)
        return ""

    def _worth_more(self, offsets: FloatArray, G: FloatArray, level: float) -> bool:
        """Whether the quadratic model still promises a visible decrease (sharp minima are worth finishing)."""
        if self._rejected > 12:
            return False
        _, d = self._direction(offsets, G)
        return float((offsets + G @ d).max()) < -1e-3 * self._options.tolerance * level

    def _model(self) -> tuple[FloatArray, FloatArray]:
        """Offsets and scaled gradients of the pieces, planes and sampled gradients at the present point."""
        f, c = self.sample.objective, max(self.sample.constraint, 0.0)
        offsets = [(p.value - 1.0 - c) if p.hard else (p.value - f - c) for p in self.sample.pieces]
        gradients = [p.gradient * self._scale for p in self.sample.pieces]
        level = max(abs(f), c) if np.isfinite(f) else 1.0
        for margin, towards in self.sample.barriers:
            offsets.append(-KEPT_MARGIN * level)
            gradients.append(towards * self._scale * (level / max(-margin, 1e-300)))
        for value, slope, at, hard in self._planes:
            shift = (self.x - at) / self._scale
            here = value + slope @ shift - ((1.0 + c) if hard else (f + c))
            offsets.append(min(float(here), 0.0) - 1e-3 * abs(f if np.isfinite(f) else 1.0) * float(shift @ shift))
            gradients.append(slope)
        for value, slope in self._sampled:
            offsets.append(value)
            gradients.append(slope)
        return np.array(offsets), np.array(gradients)

    def _certificate(self, offsets: FloatArray, G: FloatArray) -> float:
        """Norm of the smallest convex combination of the gradients that are active within the radius."""
        r = self._options.radius
        reach = 3.0 * r * float(np.sqrt(np.sum(G**2, axis=1).max()))
        near = offsets >= offsets.max() - max(reach, 1e-14)
        G, offsets = G[near], offsets[near]
        _, value = simplex_minimum(r * r * (G @ G.T), offsets - offsets.max())
        return float(np.sqrt(max(2.0 * value, 0.0)) / r)

    def _direction(self, offsets: FloatArray, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        identity = np.eye(len(self.x))
        try:
            factor = sl.cho_factor(self._B + self._proximity * identity, lower=True)
        except sl.LinAlgError:
            # rounding has eaten the definiteness of the learned curvature: start learning again
            self._proximity = max(self._proximity, 1e-6 * float(np.abs(np.diag(self._B)).max()))
            self._B, self._fresh = np.zeros_like(self._B), True
            factor = sl.cho_factor(self._proximity * identity, lower=True)
        QG = sl.cho_solve(factor, G.T)
        lam, _ = simplex_minimum(G @ QG, offsets)
        return lam, -(QG @ lam)

    def _accept(self, trial: FloatArray, found: Sample, lam: FloatArray, d: FloatArray, ratio: float) -> None:
        self._learn(found, lam, d)
        self.x, self.sample = trial, found
        self.history.append(found.objective)
        self._planes, self._sampled, self._rejected = [], [], 0
        self._sampling = 1e-3
        self._rescale()
        if ratio > BELOW["good"]:
            least = max(FLOOR_PROXIMITY, 1e-12 * float(np.abs(np.diag(self._B)).max()))
            self._proximity = max(self._proximity * 0.3, least)
        elif ratio < 0.25:
            self._proximity *= 2.0

    def _rescale(self) -> None:
        """New scales of the parameters whenever the value has halved: the first point may have been near the border."""
        size = abs(self.sample.objective) if self.sample.constraint <= 0 else self._scaled_at
        if size > 0.5 * self._scaled_at or size < 1e-3 * self._first:
            return
        self._scaled_at = size
        scale = _scales(self.sample, self.x)
        change = scale / self._scale
        self._B = self._B * np.outer(change, change)
        self._proximity *= float(np.exp(2.0 * np.mean(np.log(change))))
        self._scale = scale

    def _reject(self, found: Sample, trial: FloatArray, lam: FloatArray, d: FloatArray) -> None:
        self._rejected += 1
        if not np.isfinite(found.objective):
            self._proximity = max(self._proximity, 1e-6) * 10.0
            return
        self._learn(found, lam, d)
        for hard in (False, True):
            own = sorted((p for p in found.pieces if p.hard is hard), key=lambda p: -p.value)
            self._planes += [(p.value, p.gradient * self._scale, trial, hard) for p in own[:3]]
        self._planes = self._planes[-60:]
        self._proximity = max(self._proximity, 1e-6) * 4.0

    def _learn(self, found: Sample, lam: FloatArray, d: FloatArray) -> None:
        """Damped BFGS update with the change of the Lagrangian's gradient, pieces matched between the points."""
        mass = 0.0
        y: FloatArray = np.zeros(len(d))
        for weight, piece in zip(lam, self.sample.pieces):
            if weight < 1e-8:
                continue
            mate = _matching_piece(piece, found.pieces)
            if mate is not None:
                y += weight * (mate.gradient - piece.gradient) * self._scale
                mass += weight
        if mass < 0.3:
            return
        y /= mass
        if self._fresh:
            curvature = float(y @ d) / float(d @ d)
            if curvature <= 0.0:
                return
            self._B = np.eye(len(d)) * min(curvature, float(y @ y) / max(float(y @ d), 1e-300))
            self._proximity = min(self._proximity, max(0.1 * curvature, FLOOR_PROXIMITY))
            self._fresh = False
        Bd = self._B @ d
        dBd, dy = float(d @ Bd), float(d @ y)
        if dBd <= 1e-300:
            return
        if dy < 0.2 * dBd:
            y = y + (0.2 * dBd - dy) / (dBd - dy) * (Bd - y)
            dy = float(d @ y)
        self._B = self._B + np.outer(y, y) / dy - np.outer(Bd, Bd) / dBd
        self._B = 0.5 * (self._B + self._B.T)

    def _slow(self, level: float) -> bool:
        """Fifteen accepted steps that together brought less than a part in 10^5."""
        recent = self.history[-15:]
        if len(recent) < 15 or self.sample.constraint > 0:
            return False
        return recent[0] - recent[-1] < 1e-5 * level

    def _enrich(self) -> str:
        """Sample gradients around the point; give up when that has been done at every radius."""
        self._sampling_rounds += 1
        nearly = self.stationarity <= 10.0 * self._options.tolerance * abs(self.sample.objective)
        if self._sampling_rounds > (2 if nearly else 6):
            return "nearly stationary" if nearly else "stalled"
        n = len(self.x)
        f, c = self.sample.objective, max(self.sample.constraint, 0.0)
        for _ in range(min(2 * n, 20)):
            u = self._rng.standard_normal(n)
            shift = self._sampling * u / sl.norm(u)
            near = self._ask(self.x + self._scale * shift)
            if not np.isfinite(near.objective):
                continue
            for hard in (False, True):
                own = sorted((p for p in near.pieces if p.hard is hard), key=lambda p: -p.value)
                for p in own[:2]:
                    slope = p.gradient * self._scale
                    here = p.value - slope @ shift - ((1.0 + c) if hard else (f + c))
                    self._sampled.append((min(float(here), 0.0), slope))
        self._sampled = self._sampled[-120:]
        self._sampling *= 0.2
        self._proximity = self._first_proximity()
        self._B = np.zeros_like(self._B)
        self._fresh = True
        self.history = []
        return ""


def _progress(found: Sample, present: Sample) -> float:
    if not np.isfinite(found.objective):
        return np.inf
    c = max(present.constraint, 0.0)
    return float(max(found.objective - present.objective - c, found.constraint - c))


def _matching_piece(piece: Any, others: tuple[Any, ...]) -> Any | None:
    best, distance = None, 0.1
    for other in others:
        if (other.requirement, other.model, other.hard) != (piece.requirement, piece.model, piece.hard):
            continue
        d = abs(other.place - piece.place) / max(piece.place, 1e-12) if piece.place != other.place else 0.0
        d += 1e-3 * abs(other.value - piece.value) / max(abs(piece.value), 1e-12)
        if d < distance:
            best, distance = other, d
    return best


def _scales(sample: Sample, x: FloatArray) -> FloatArray:
    """Step of each parameter that changes the values by about their own size, within limits."""
    largest = max(abs(p.value) for p in sample.pieces)
    G = np.array([p.gradient / max(abs(p.value), 1e-2 * largest, 1e-9) for p in sample.pieces])
    size = np.sqrt(np.mean(G**2, axis=0))
    positive = size[size > 0]
    if len(positive) == 0:
        return np.ones(len(x))
    middle = float(np.exp(np.mean(np.log(positive))))
    return np.asarray(1.0 / np.clip(size, 1e-2 * middle, 1e3 * middle) / np.sqrt(len(x)))
