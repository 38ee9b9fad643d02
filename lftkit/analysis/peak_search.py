"""Peaks of the largest singular value over frequency, by Newton's method with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import lapack

from lftkit.arrays import ComplexArray

MAX_STEPS = 20
FALL = 0.01  # of a step that would raise the gain by less than this times the tolerance: it is not taken

Responses = Callable[[float], tuple[ComplexArray, ComplexArray, ComplexArray]]


def climb(responses: Responses, omega: float, gain: float, limit: float, rtol: float) -> tuple[float, float]:
    """Frequency and gain of the peak near `omega`.

    Parameters
    ----------
    responses : callable
        Response (p, m) at a frequency [rad/s] with its first and second derivative.
    omega : float
        Start [rad/s], positive and finite.
    gain : float
        Gain there.
    limit : float
        Longest step [rad/s]: the distance of the nearest pole.
    rtol : float
        Relative distance of the gain from the peak at which the search ends.
    """
    best, low, high = omega, 0.0, np.inf
    for _ in range(MAX_STEPS):
        square, slope, curvature = squared_gain(*responses(omega))
        if square > gain * gain:
            best, gain = omega, square**0.5
        if slope * slope <= -4.0 * FALL * rtol * square * curvature:  # what the step would add to the square
            break
        low, high = (omega, high) if slope > 0.0 else (low, omega)
        step = -slope / curvature if curvature < 0.0 else (limit if slope > 0.0 else -limit)
        omega += min(max(step, -limit), limit)
        if not low < omega < high:
            omega = 0.5 * (low + high)
    return best, gain


def squared_gain(G: ComplexArray, G1: ComplexArray, G2: ComplexArray) -> tuple[float, float, float]:
    """Square of the largest singular value of G (p, m), with its derivatives where G has the derivatives G1 and G2.

    It is the largest eigenvalue of ``G G^H``; second-order perturbation couples it with the others.

    Examples
    --------
    >>> one = np.ones((1, 1), dtype=complex)
    >>> squared_gain(3.0 * one, 2.0 * one, 0.0 * one)
    (9.0, 12.0, 8.0)
    """
    if G.shape[1] < G.shape[0]:
        G, G1, G2 = G.T, G1.T, G2.T
    if len(G) == 1:
        g, g1, g2 = G[0], G1[0], G2[0]
        own = 2.0 * float(np.vdot(g, g2).real + np.vdot(g1, g1).real)
        return float(np.vdot(g, g).real), 2.0 * float(np.vdot(g, g1).real), own
    H = G.conj().T
    values, vectors, _ = lapack.zheev(G @ H)
    u = vectors[:, -1]
    x, x1 = H @ u, G1.conj().T @ u
    slope = G1 @ x + G @ x1  # the derivative of G G^H, times u
    couplings = np.abs(vectors.conj().T @ slope)[:-1]
    others = couplings * couplings / np.maximum(values[-1] - values[:-1], 1e-300)
    own = 2.0 * float(np.vdot(u, G2 @ x).real + np.vdot(x1, x1).real)
    return float(values[-1]), float(np.vdot(u, slope).real), own + 2.0 * float(others.sum())
