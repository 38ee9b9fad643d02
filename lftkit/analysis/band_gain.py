"""Largest gain of a continuous system over a band of frequencies, bracketed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import balanced
from lftkit.analysis.frequency_response import FrequencyResponse, refined_response
from lftkit.analysis.norms import HInfNorm
from lftkit.arrays import FloatArray, Matrices

MAX_ROUNDS, PER_BAND = 60, 20
IMAGINARY = 1e-7  # real part of an eigenvalue that counts as imaginary, relative: one too many costs a gain


def band_gain(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    band: tuple[float, float],
    *,
    rtol: float = 1e-6,
    stable: bool = True,
) -> HInfNorm:
    """Largest singular value of ``C (jw I - A)^-1 B + D`` for w in a band [rad/s].

    The frequencies at which a singular value equals a level are imaginary eigenvalues of a Hamiltonian matrix (Boyd,
    Balakrishnan and Kabamba 1989): between two of them the gain is on one side of the level, and a point in the middle
    says on which. Without `stable` it is taken of unstable systems, too, and infinite for poles on the axis only.

    Examples
    --------
    A resonance at 1 rad/s, of which the band sees the flank:

    >>> found = band_gain([[0, 1], [-1, -0.1]], [[0], [1]], [[1, 0]], [[0]], (2.0, 10.0))
    >>> round(found.value, 6), found.omega
    (0.332595, 2.0)
    """
    a, b, c, D = (np.atleast_2d(np.asarray(M, dtype=float)) for M in (A, B, C, D))
    if a.size == 0:
        value = float(largest_gains(D[None].astype(complex))[0])
        return HInfNorm(value, value, band[0], "static")
    a, b, c = balanced(a, b, c)
    poles = FrequencyResponse.of(a, b, c, D, check=False).poles
    worst = int(np.argmax(poles.real))
    on_axis = float(np.abs(poles.real).min()) <= 1e-14 * float(np.abs(poles).max())
    if (stable and poles[worst].real >= 0.0) or (not stable and on_axis):
        return HInfNorm(np.inf, np.inf, float(abs(poles[worst].imag)), "unstable")
    system, (low, high) = (a, b, c, D), band
    size = np.abs(poles)
    last = high if np.isfinite(high) else 10.0 * max(float(size.max()), low, 1e-300)
    seeds = np.concatenate([[low, high], size, np.abs(poles.imag), np.geomspace(max(low, 1e-3 * last), last, PER_BAND)])
    value, omega = _largest(system, np.unique(seeds[(seeds >= low) & (seeds <= high)]))
    least = 1e-14 * float(linalg.norm(b) * linalg.norm(c) / np.abs(poles.real).min() + linalg.norm(D)) + 1e-300
    for _ in range(MAX_ROUNDS):
        level = max(value * (1.0 + rtol), least)
        inside = _crossings(system, level)
        edges = np.unique(np.concatenate([[low], inside[(inside > low) & (inside < high)], [high]]))
        if np.isinf(edges[-1]):
            edges[-1] = 10.0 * max(float(edges[-2]), last)
        better, at = _largest(system, 0.5 * (edges[:-1] + edges[1:]))
        if better <= level:
            return HInfNorm(value, level, omega, "hamiltonian")
        value, omega = better, at
    raise ArithmeticError(f"the gain in a band did not settle in {MAX_ROUNDS} rounds (order {len(a)})")


def _largest(system: Matrices, omega: FloatArray) -> tuple[float, float]:
    gains = [float(largest_gains(refined_response(*system, float(w))[None])[0]) for w in omega]
    k = int(np.argmax(gains))
    return gains[k], float(omega[k])


def _crossings(system: Matrices, level: float) -> FloatArray:
    """Frequencies at which a singular value equals the level, which is none of D."""
    A, B, C, D = system
    d, root = D / level, np.sqrt(1.0 / level)
    b, c = B * root, C * root
    R, S = np.eye(B.shape[1]) - d.T @ d, np.eye(len(C)) - d @ d.T
    F = A + b @ linalg.solve(R, d.T @ c)
    H = np.block([[F, b @ linalg.solve(R, b.T)], [-c.T @ linalg.solve(S, c), -F.T]])
    values = linalg.eigvals(H, overwrite_a=True, check_finite=False)
    near = np.abs(values.real) <= IMAGINARY * np.abs(values) + 1e-13 * float(np.abs(values).max())
    return np.asarray(np.abs(values[near].imag), dtype=float)
