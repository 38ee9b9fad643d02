"""Lower bound of the largest of several root mean squares that one controller of a sampled plant makes.

Each noise alone makes a root mean square of the output. Of the powers (their squares) any controller has a largest one
that is at least their weighted mean, and the least weighted mean over all controllers is that of an LQG problem, whose
process and measurement noises are scaled by the roots of the weights. The bound is the largest such mean: it is concave
in the weights, its gradient are the powers that the optimal controller makes, and at the optimum those with a weight
are equal (Boyd and Barratt, Linear Controller Design, 1991, section 14.5).

The bound holds for linear controllers of any order that use a measurement at once. It is computed numerically, with a
weight of the commands that contributes a small part of the power of the output.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.riccati import discrete_riccati, stein
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.regular_solve import regular_solve
from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class SharedBoundSettings(AlgorithmSettings):
    """Numbers of the search for the largest bound.

    Attributes
    ----------
    effort : weight of the power of a command, relative to the power of the output that a white command makes
    least_weight : weights are hardly lower: one that is needed again grows
    steps : changes of the weights, at most
    gap : relative distance of the bound from the largest power at which the weights are good enough
    """

    effort: float = 1e-8
    least_weight: float = 1e-8
    steps: int = 40
    gap: float = 0.02


SETTINGS = SharedBoundSettings()


@dataclass(frozen=True)
class Noise:
    """Independent white noises of variance 1 per sample.

    Parameters
    ----------
    process : ndarray, shape (states, k)
        By which they enter the next state.
    measurement : ndarray, shape (measurements,)
        Standard deviation of the noise of each measurement.
    """

    process: FloatArray
    measurement: FloatArray


@dataclass(frozen=True)
class SampledPlant:
    """Plant ``x+ = A x + B u``, ``z = C x``, ``y = M x``, with the noises that act on it."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    M: FloatArray
    noises: tuple[Noise, ...]

    def __post_init__(self) -> None:
        total = np.sum([np.square(noise.measurement) for noise in self.noises], axis=0)
        if not self.noises or not np.all(total > 0.0):
            raise InputError(f"every measurement must have noise, got variances {np.asarray(total).tolist()}")

    @property
    def scaled(self) -> SampledPlant:
        """With states of similar size, and with commands that make as large an output as one noise does."""
        G = np.hstack([noise.process for noise in self.noises])
        seen = stein(self.A.T, self.C.T @ self.C)
        by_command = np.sqrt(np.maximum(np.einsum("ij,ij->j", self.B, seen @ self.B), np.finfo(float).tiny))
        power = float(np.einsum("ij,ij->", G, seen @ G)) or 1.0
        B = self.B * (np.sqrt(power) / by_command)
        drive = np.hstack([G, B])
        size = np.sqrt(np.diag(stein(self.A, drive @ drive.T)))
        size[~(size > 0.0)] = 1.0
        noises = tuple(Noise(noise.process / size[:, None], noise.measurement) for noise in self.noises)
        return SampledPlant(self.A * size / size[:, None], B / size[:, None], self.C * size, self.M * size, noises)


@dataclass(frozen=True)
class SharedBound:
    """Lower bound of the largest root mean square of all linear controllers.

    Attributes
    ----------
    value : float
        For each controller at least one root mean square is this large or larger.
    reached : ndarray, shape (noises,)
        Root mean squares of a controller that is optimal for the weights.
    weights : ndarray, shape (noises,)
        Which noises conflict; their sum is 1.
    """

    value: float
    reached: FloatArray
    weights: FloatArray


@dataclass(frozen=True)
class LqgProblem:
    """The LQG problems of a plant: one regulator, and an estimator for each set of weights."""

    plant: SampledPlant
    regulator: FloatArray
    estimate: FloatArray

    @staticmethod
    def of(plant: SampledPlant, weight: float = SETTINGS.effort) -> LqgProblem:
        """The problem of a plant whose states are scaled; `weight` is that of the commands.

        Raises
        ------
        ArithmeticError, LinAlgError
            An equation that has no solution.
        """
        A, B, C = plant.A, plant.B, plant.C
        seen = stein(A.T, C.T @ C)
        effort = weight * np.maximum(np.einsum("ij,ij->j", B, seen @ B), np.finfo(float).tiny)
        X = discrete_riccati(A, B / effort @ B.T, C.T @ C)
        inner = B.T @ X @ B + np.diag(effort)
        F = regular_solve(inner, B.T @ X @ A)
        return LqgProblem(plant, X, np.asarray(F.T @ inner @ F))

    def powers(self, weights: FloatArray) -> FloatArray:
        """Power of the output that each noise makes with the controller that is optimal for these weights."""
        plant = self.plant
        total = np.hstack([np.sqrt(w) * noise.process for w, noise in zip(weights, plant.noises, strict=True)])
        heard = sum(w * np.square(noise.measurement) for w, noise in zip(weights, plant.noises, strict=True))
        M = plant.M / np.sqrt(heard)[:, None]
        Y = discrete_riccati(plant.A.T, M.T @ M, total @ total.T)
        gain = regular_solve(M @ Y @ M.T + np.eye(len(M)), M @ Y).T / np.sqrt(heard)
        unknown = np.eye(len(Y)) - gain @ plant.M
        S = stein((unknown @ plant.A).T, self.estimate)
        of_process = self.regulator + unknown.T @ S @ unknown
        of_measurement = np.einsum("ij,ij->j", gain, S @ gain)
        return np.array(
            [
                np.einsum("ij,ij->", noise.process, of_process @ noise.process)
                + np.square(noise.measurement) @ of_measurement
                for noise in plant.noises
            ]
        )


def shared_bound(
    plant: SampledPlant,
    enough: Callable[[SharedBound], bool] = lambda bound: False,
    weights: Sequence[float] | FloatArray | None = None,
    settings: SharedBoundSettings = SETTINGS,
) -> SharedBound:
    """Largest lower bound that is found of the largest root mean square over the noises of a stable plant.

    Parameters
    ----------
    plant : SampledPlant
        Stable without control.
    enough : callable
        Ends the search where a bound says what one wants to know.
    weights : array_like, optional
        Where the search begins.
    settings : SharedBoundSettings
        Numbers of the search.

    Raises
    ------
    ValueError
        A plant that is not stable.
    ArithmeticError, LinAlgError
        A Riccati equation without a solution.

    Examples
    --------
    A state that is disturbed and measured with noise; to follow each measurement costs as much as not to:

    >>> noises = Noise(np.array([[1.0]]), np.zeros(1)), Noise(np.zeros((1, 0)), np.array([2.0]))
    >>> plant = SampledPlant(*(np.array([[v]]) for v in (0.99, 1.0, 1.0, 1.0)), noises)
    >>> round(shared_bound(plant).value, 2)
    1.15
    """
    radius = float(np.abs(linalg.eigvals(plant.A)).max(initial=0.0))
    if not radius < 1.0:
        raise InputError(f"plant must be stable without control, got a spectral radius of {radius:.6g}")
    problem = LqgProblem.of(plant.scaled, settings.effort)
    q = np.full(len(plant.noises), 1.0) if weights is None else np.array(weights, dtype=float)
    q = _shares(q, settings.least_weight)
    best = SharedBound(0.0, np.full(len(q), np.inf), q)
    for _ in range(settings.steps):
        powers = problem.powers(q)
        mean, largest = float(q @ powers), float(powers.max())
        if np.sqrt(mean) >= best.value:
            best = SharedBound(float(np.sqrt(mean)), np.sqrt(powers), q)
        if enough(best) or largest <= (1.0 + settings.gap) * mean:
            break
        q = _shares(q * np.sqrt(powers), settings.least_weight)
    return best


def _shares(weights: FloatArray, least: float) -> FloatArray:
    """Weights of sum 1, of which none is below the least."""
    kept = np.maximum(weights / weights.sum(), least)
    return np.asarray(kept / kept.sum())
