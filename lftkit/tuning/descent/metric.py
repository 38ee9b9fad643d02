"""Metric of the descent: coordinates in which a step of length one changes the values by about their own size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.tuning.pieces import OracleResult, Piece

EIGENVALUE_FLOOR = 1e-9  # of the scaled Gauss-Newton matrix: directions that change nothing keep a finite length
SMALLEST_DIAGONAL = 1e-30  # squared relative change of the values by one parameter below which there is none
SMALLEST_SCALE, LARGEST_SCALE = 1e-2, 1e3  # of a diagonal metric, about the geometric mean of the slopes


@dataclass(frozen=True)
class Metric:
    """Linear map ``x = x0 + T z`` from the descent's coordinates z to the parameters x.

    Parameters
    ----------
    T, inverse : ndarray, shape (n, n)
    """

    T: FloatArray
    inverse: FloatArray

    def gradient(self, g: FloatArray) -> FloatArray:
        """Gradient with respect to z of a function with gradient `g` (n,) with respect to x."""
        return np.asarray(self.T.T @ g)

    def step(self, z: FloatArray) -> FloatArray:
        """Change of the parameters for a step `z` (n,)."""
        return np.asarray(self.T @ z)

    def coordinates(self, dx: FloatArray) -> FloatArray:
        """Step z that changes the parameters by `dx` (n,)."""
        return np.asarray(self.inverse @ dx)


MetricSource = Callable[[FloatArray, OracleResult], Metric]


def diagonal_metric(x: FloatArray, result: OracleResult) -> Metric:
    """One scale for each parameter, from the slopes of the pieces."""
    scale = _scales(result.pieces, len(x))
    return Metric(np.diag(scale), np.diag(1.0 / scale))


def metric_of(matrix: FloatArray, floor: float = EIGENVALUE_FLOOR) -> Metric:
    """Metric in which the positive semidefinite `matrix` (n, n) becomes the identity.

    The matrix is first scaled to a unit diagonal; eigenvalues below `floor` times the largest are raised to it. The
    identity for a matrix of zeros.
    """
    diagonal = np.diag(matrix)
    if not diagonal.max(initial=0.0) > SMALLEST_DIAGONAL:
        return Metric(np.eye(len(matrix)), np.eye(len(matrix)))
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max(initial=0.0)), 1e-300)))
    values, vectors = linalg.eigh(matrix * np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, floor * max(float(values[-1]), 1e-300)))
    return Metric(scale[:, None] * vectors / root, (root[:, None] * vectors.T) / scale)


def _scales(pieces: Sequence[Piece], n: int) -> FloatArray:
    """Step of each parameter that changes the values by about their own size, within limits."""
    largest = {kind: max((abs(p.value) for p in pieces if p.hard is kind), default=0.0) for kind in (False, True)}
    G = np.array([p.gradient / max(abs(p.value), 1e-2 * largest[p.hard], 1e-9) for p in pieces])
    size = np.sqrt(np.mean(G**2, axis=0))
    positive = size[size > 0]
    if len(positive) == 0:
        return np.ones(n)
    middle = float(np.exp(np.mean(np.log(positive))))
    return np.asarray(1.0 / np.clip(size, SMALLEST_SCALE * middle, LARGEST_SCALE * middle) / np.sqrt(n))
