"""Peaks of the largest singular value over frequency: where to look, and Newton's method with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.level_iteration import Peak
from lftkit.arrays import ComplexArray, FloatArray

MAX_STEPS = 20
FALL = 0.01  # of a step that would raise the gain by less than this times the tolerance: it is not taken
STARTS = 3  # frequencies from which a peak is searched
RIVAL = 0.7  # of the largest gain: frequencies below are no starts

Responses = Callable[[float], tuple[ComplexArray, ComplexArray, ComplexArray]]


def peak_frequencies(poles: Iterable[complex]) -> FloatArray:
    """Finite frequencies of possible peaks [rad/s], ascending: zero, resonances, magnitudes of the poles."""
    found = {0.0}
    for pole in poles:
        decay, height, size = -pole.real, pole.imag, abs(pole)
        if height >= -4.0 * EPS * size:
            found.add(size)
            if height > abs(decay):
                found.add(((height - decay) * (height + decay)) ** 0.5)
    return np.array(sorted(found))


def highest_peak_of(
    response: FrequencyResponse, frequencies: FloatArray, rtol: float, band: tuple[float, float] = (0.0, np.inf)
) -> Peak:
    """Highest peak of a response near the best of some frequencies, see :func:`highest_peak`."""

    def distance(omega: float) -> float:
        return float(np.abs(1j * omega - response.poles).min())

    gains = largest_gains(response.at(frequencies))
    return highest_peak(response.with_derivatives, distance, (frequencies, gains), rtol, band)


def highest_peak(
    responses: Responses,
    distance: Callable[[float], float],
    tried: tuple[FloatArray, FloatArray],
    rtol: float,
    band: tuple[float, float],
) -> Peak:
    """Highest peak near the best `STARTS` of the frequencies tried.

    Parameters
    ----------
    responses : callable
        As in :func:`climb`.
    distance : callable
        Distance of the nearest pole from a frequency.
    tried : tuple of ndarray
        Frequencies and the gains there, both (k,).
    rtol : float
        As in :func:`climb`.
    band : tuple of float
        Lowest and highest frequency; the search starts inside and does not leave it.
    """
    frequencies, gains = tried
    chosen = np.argsort(gains)[::-1][:STARTS]
    best, place = float(gains[chosen[0]]), float(frequencies[chosen[0]])
    for k in chosen[gains[chosen] >= RIVAL * best]:
        start = float(frequencies[k])
        if band[0] < start < band[1]:
            omega, gain = climb(responses, start, float(gains[k]), distance(start), rtol)
            if gain > best and band[0] <= omega <= band[1]:
                best, place = gain, omega
    return Peak(place, best)


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
