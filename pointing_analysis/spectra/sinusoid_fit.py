"""Weighted least-squares fit of sinusoids to a record of two axes: frequencies shared by both, phasors of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from pointing_analysis.arrays import ComplexArray, FloatArray

ROWS = 20_000
"""Rows of a fit at a time."""

STEPS = 3
"""Improvements of the frequencies."""

REACH, STILL = 1.5, 0.003
"""Largest change of a phase at the ends of the record in one of them; change that ends them [rad]."""

MERGED = 0.7
"""Of 1 / T: of two sinusoids that come closer, the weaker one is left out."""


@dataclass(frozen=True)
class Sinusoids:
    """Sinusoids with a constant and a linear trend, fitted to a record.

    Attributes
    ----------
    omega : (k,) [rad/s]
    phasor : (k, 2) complex, at the middle of the record
    rest : (n, 2) what the fit leaves; zero where a sample is missing
    """

    omega: FloatArray
    phasor: ComplexArray
    rest: FloatArray


def fit_sinusoids(error: FloatArray, weight: FloatArray, dt: float, omega: FloatArray, moves: bool = True) -> Sinusoids:
    """Fit sinusoids near some frequencies, all together with a constant and a trend.

    The phasors are those of the transform with the weight as its taper: what the taper keeps out of a frequency of the
    transform (the far spectrum of a step or of a decay) is not in the fit either.

    Parameters
    ----------
    error : (n, 2)
    weight : (n,) of each row, not negative; zero where a sample is missing
    dt : [s]
    omega : (k,) [rad/s]
    moves : whether the frequencies are improved (Gauss-Newton); else they stay
    """
    n = len(error)
    present = weight > 0.0
    e = error if present.all() else np.where(present[:, None], error, 0.0)
    w, half = np.sort(np.array(omega, dtype=float)), 0.5 * n * dt
    for _ in range(STEPS if moves and w.size else 0):
        gram, right = _products(e, weight, dt, w)
        p, k = 2 + 2 * w.size, w.size
        coefficients = _solve(gram[:p, :p], right[:p])
        step = np.clip(_step(gram, right, coefficients, k), -REACH, REACH)
        power = (coefficients[2 : 2 + k] ** 2 + coefficients[2 + k :] ** 2).sum(axis=1)
        w = _apart(w + step / half, power, n * dt)
        if np.abs(step).max() < STILL:
            break
    gram, right = _products(e, weight, dt, w, slopes=False)
    coefficients, k = _solve(gram, right), w.size
    phasor = coefficients[2 : 2 + k] - 1j * coefficients[2 + k :]
    rest, n = np.empty_like(e), len(e)
    for begin in range(0, n, ROWS):
        rows = slice(begin, min(begin + ROWS, n))
        rest[rows] = e[rows] - _basis(rows, n, dt, w, slopes=False) @ coefficients
    rest[weight == 0.0] = 0.0
    return Sinusoids(w, phasor, rest)


def _basis(rows: slice, n: int, dt: float, omega: FloatArray, slopes: bool = True) -> FloatArray:
    """Constant, time, cosines, sines, and both times time: (rows, 2 + 4 k); time from the middle, in half lengths."""
    index = np.arange(rows.start, rows.stop) - 0.5 * (n - 1)
    time = index / (0.5 * n)
    turning = np.exp(1j * np.outer(index * dt, omega))
    columns = [np.ones((index.size, 1)), time[:, None], turning.real, turning.imag]
    if slopes:
        columns += [time[:, None] * turning.real, time[:, None] * turning.imag]
    return np.hstack(columns)


def _products(
    e: FloatArray, weight: FloatArray, dt: float, omega: FloatArray, slopes: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Weighted products of the basis with itself and with the record."""
    n, size = len(e), 2 + (4 if slopes else 2) * omega.size
    gram, right = np.zeros((size, size)), np.zeros((size, 2))
    for begin in range(0, n, ROWS):
        rows = slice(begin, min(begin + ROWS, n))
        basis = _basis(rows, n, dt, omega, slopes)
        weighted = basis.T * weight[rows]
        gram += weighted @ basis
        right += weighted @ e[rows]
    return gram, right


def _solve(gram: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(linalg.lstsq(gram, right, cond=1e-12)[0])


def _step(gram: FloatArray, right: FloatArray, coefficients: FloatArray, k: int) -> FloatArray:
    """Change of the frequencies, for a time in half lengths (Gauss-Newton, the linear coefficients projected out).

    The derivative of a cos + b sin is time times (b cos - a sin), with the a and b of each axis.
    """
    p = 2 + 2 * k
    between = gram[p:, :p]
    across = gram[p:, p:] - between @ _solve(gram[:p, :p], between.T)
    left = right[p:] - between @ coefficients
    normal, slope = np.zeros((k, k)), np.zeros(k)
    for axis in range(2):
        a, b = coefficients[2 : 2 + k, axis], coefficients[2 + k :, axis]
        turn = np.vstack([np.diag(b), -np.diag(a)])
        normal += turn.T @ across @ turn
        slope += turn.T @ left[:, axis]
    return _solve(normal, slope)


def _apart(omega: FloatArray, power: FloatArray, duration: float) -> FloatArray:
    """The frequencies without those that have come close to that of a stronger sinusoid."""
    kept: list[float] = []
    for i in np.argsort(-power, kind="stable"):
        if all(abs(omega[i] - other) * duration >= MERGED * 2.0 * np.pi for other in kept):
            kept.append(float(omega[i]))
    return np.array(sorted(kept))
