"""Peaks of the largest singular value over frequency: where to look, and Newton's method with exact derivatives.

Gains are those of a direct solution at one frequency: the modal form never has the last word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from scipy.linalg import LinAlgError, lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import FrequencyResponse, refined_response
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings, Peak
from lftkit.arrays import ComplexArray, FloatArray, Matrices

Responses = Callable[[float], tuple[ComplexArray, ComplexArray, ComplexArray]]
CANCELLATION = 100.0 * EPS  # rounding of a gain over the sum of the magnitudes of the modal terms


def direct_gain(system: Matrices, omega: float, *, refined: bool = True) -> float:
    """Largest singular value of ``C (j omega - A)^-1 B + D`` at `omega` [rad/s], also at infinity.

    Parameters
    ----------
    system : tuple of ndarray
        Balanced matrices, shapes (n, n), (n, m), (p, n), (p, m).
    omega : float
    refined : bool
        Correct the solution by residuals in twice the working precision; without, for poles far from `omega`.
    """
    if refined:
        return float(largest_gains(refined_response(*system, omega)[None])[0])
    return largest_gain(response_at(system, 1j * omega) if omega < np.inf else system[3])


def response_at(system: Matrices, point: complex) -> ComplexArray:
    """``C (point - A)^-1 B + D``, shape (p, m), by one factorisation.

    Raises
    ------
    LinAlgError
        A pole at the point.
    """
    A, B, C, D = system
    shifted = np.multiply(A, -1.0 + 0.0j, order="F")
    shifted.flat[:: len(A) + 1] += point
    *_, states, singular = lapack.zgesv(shifted, B, overwrite_a=1)
    if singular:
        raise LinAlgError(f"the response at {point} must not be that at a pole")
    return np.asarray(C @ states + D)


def largest_gain(response: FloatArray | ComplexArray) -> float:
    """Largest singular value of one matrix (p, m), in fewer calls than that of a stack."""
    if 1 in response.shape:
        return float(np.sqrt(np.vdot(response, response).real))
    return float(lapack.zgesdd(response, compute_uv=0)[1][0])


def cancellation(response: FrequencyResponse) -> float:
    """Rounding of a gain where the modal terms cancel, at any frequency; 0 in Schur form, where it is not known.

    The largest sum of the magnitudes of the terms is estimated by the terms at the distance of each pole from the axis.
    """
    if not response.modal:
        return 0.0
    poles = response.poles
    distance = np.maximum(np.abs(np.abs(poles) - poles.imag), np.abs(poles.real))
    return CANCELLATION * float(np.sum(response.residue_norms / np.maximum(distance, 1e-300)))


def peak_frequencies(poles: Iterable[complex]) -> FloatArray:
    """Finite frequencies of possible peaks [rad/s], ascending: zero, resonances, magnitudes of the poles."""
    omega = {0.0}
    for pole in poles:
        decay, height, size = -pole.real, pole.imag, abs(pole)
        if height >= -4.0 * EPS * size:
            omega.add(size)
            if height > abs(decay):
                omega.add(((height - decay) * (height + decay)) ** 0.5)
    return np.array(sorted(omega))


def highest_peak_of(
    response: FrequencyResponse,
    frequencies: FloatArray,
    rtol: float,
    settings: NormSettings,
    band: tuple[float, float] = (0.0, np.inf),
) -> Peak:
    """Highest peak of a response near the best of some frequencies, see :func:`highest_peak`."""

    def distance(omega: float) -> float:
        return float(np.abs(1j * omega - response.poles).min())

    gains = largest_gains(response.at(frequencies))
    return highest_peak(response.with_derivatives, distance, (frequencies, gains), rtol, band, settings)


def highest_peak(
    responses: Responses,
    distance: Callable[[float], float],
    tried: tuple[FloatArray, FloatArray],
    rtol: float,
    band: tuple[float, float],
    settings: NormSettings,
) -> Peak:
    """Highest peak near the best of the frequencies tried.

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
    settings : NormSettings
        Of these `starts` and `rival`, and as in :func:`climb`.
    """
    frequencies, gains = tried
    chosen = np.argsort(gains)[::-1][: settings.starts]
    best, place = float(gains[chosen[0]]), float(frequencies[chosen[0]])
    for k in chosen[gains[chosen] >= settings.rival * best]:
        start = float(frequencies[k])
        if band[0] < start < band[1]:
            omega, gain = climb(responses, start, float(gains[k]), distance(start), rtol, settings)
            if gain > best and band[0] <= omega <= band[1]:
                best, place = gain, omega
    return Peak(place, best)


def climb(
    responses: Responses, omega: float, gain: float, limit: float, rtol: float, settings: NormSettings = SETTINGS
) -> tuple[float, float]:
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
    settings : NormSettings
        Of these `climb_steps` and `fall`.
    """
    best, low, high = omega, 0.0, np.inf
    for _ in range(settings.climb_steps):
        square, slope, curvature = squared_gain(*responses(omega))
        if square > gain * gain:
            best, gain = omega, square**0.5
        if slope * slope <= -4.0 * settings.fall * rtol * square * curvature:  # what the step would add to the square
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
        curvature = 2.0 * float(np.vdot(g, g2).real + np.vdot(g1, g1).real)
        return float(np.vdot(g, g).real), 2.0 * float(np.vdot(g, g1).real), curvature
    H = G.conj().T
    values, vectors, _ = lapack.zheev(G @ H)
    u = vectors[:, -1]
    x, x1 = H @ u, G1.conj().T @ u
    slope = G1 @ x + G @ x1  # the derivative of G G^H, times u
    couplings = np.abs(vectors.conj().T @ slope)[:-1]
    others = couplings * couplings / np.maximum(values[-1] - values[:-1], 1e-300)
    curvature = 2.0 * float(np.vdot(u, G2 @ x).real + np.vdot(x1, x1).real)
    return float(values[-1]), float(np.vdot(u, slope).real), curvature + 2.0 * float(others.sum())
