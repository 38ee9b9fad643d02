"""Two exact tests that a gain stays below a level at every frequency.

* :func:`interval_test` covers the whole frequency axis by intervals; on each the response is a quadratic Taylor
  polynomial plus a rigorous remainder, both from the modal form. Its work grows with the number of resonances near
  the level, not with n^3.
* :func:`hamiltonian_test` finds the frequencies where the gain equals the level as imaginary eigenvalues of a
  Hamiltonian matrix (Boyd, Balakrishnan and Kabamba 1989; Bruinsma and Steinbuch 1990). Slower, needs no modal form.

Neither looks at a grid only: a peak between two points cannot escape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.arrays import BoolArray, ComplexArray, FloatArray

EPS = float(np.finfo(float).eps)
MAX_INTERVALS = 40_000
CHUNK = 40_000  # entries of the arrays of one step, so that they stay in the cache
PEAK_CUTS = 13  # halvings of the distance of the nearest pole
GROWTH = 4.0  # of the intervals away from a pole
INSIDE = 0.75  # an interval's half width over the distance of the nearest pole, at most


@dataclass(frozen=True)
class LevelTest:
    """Outcome of a level test.

    Parameters
    ----------
    below : bool
        The gain is below the level at every frequency.
    decided : bool
        False where the test gave up (too many intervals); then `below` is False too.
    frequencies : ndarray, shape (k,)
        Frequencies [rad/s] at which to look for a larger gain where it is not below.
    """

    below: bool
    decided: bool
    frequencies: FloatArray


def interval_test(response: FrequencyResponse, level: float, seeds: FloatArray, peak: float | None = None) -> LevelTest:
    """Whether the largest singular value stays below `level` for all real frequencies.

    Parameters
    ----------
    response : FrequencyResponse
        In modal form, all poles off the imaginary axis.
    level : float
    seeds : ndarray, shape (k,)
        Frequencies [rad/s] at which the axis is first cut: resonances.
    peak : float, optional
        Frequency of the largest gain known [rad/s], where the cuts are closest.

    Notes
    -----
    Around c, ``1/(jw - lambda) = sum_m (-j)^m (w - c)^m / (jc - lambda)^(m+1)``. On |w - c| <= h the norm of the linear
    part is largest at an end (the norm is convex); the quadratic part adds h^2 ||G_2||; the rest is at most
    h^3 sum_k r_k / (d_k^3 (d_k - h)), with d_k the distance of pole k and r_k the norm of its residue. Above twice the
    largest pole the same is done in 1/w, down to 0, so that infinity is covered too.
    """
    if not response.modal:
        raise ValueError("response must be in modal form, got a Schur form")
    poles = response.poles
    residue = response.residue_norms
    top = 2.0 * float(np.abs(poles).max(initial=1.0))
    cuts = _cuts(poles, seeds if peak is None else np.concatenate([seeds, _around(peak, poles)]), top)
    ends = np.column_stack([cuts[:-1], cuts[1:]])
    tail = np.array([[0.0, 1.0 / top]])
    for inverse, intervals in ((False, ends), (True, tail)):
        outcome = _cover(response, residue, level, intervals, inverse)
        if not outcome.below:
            return outcome
    return LevelTest(True, True, np.zeros(0))


def _cuts(poles: ComplexArray, seeds: FloatArray, top: float) -> FloatArray:
    """First cuts of the axis: intervals that grow with the distance from the nearest lightly damped pole."""
    light = poles[(poles.imag > 0) & (np.abs(poles.real) < 0.3 * np.abs(poles))]
    order = np.argsort(light.imag)
    w, decay = light.imag[order], np.abs(light.real[order])
    ends = np.concatenate([[0.0], w, [top]])
    below, above = np.maximum(w - ends[:-2], 0.0), np.maximum(ends[2:] - w, 0.0)
    cuts = [np.array([0.0, top]), np.geomspace(1e-3 * top, top, 40), seeds, w]
    reach = decay.copy()
    while np.any(reach < np.maximum(below, above)):
        cuts += [(w - reach)[reach < 0.7 * below], (w + reach)[reach < 0.7 * above]]
        reach = reach * GROWTH
    every = np.unique(np.concatenate(cuts))
    return np.asarray(every[(every >= 0.0) & (every <= top)])


def _around(peak: float, poles: ComplexArray) -> FloatArray:
    """Cuts around a peak: where its parabola has fallen by x^2, intervals of the length x pass."""
    if not np.isfinite(peak):
        return np.zeros(0)
    steps = np.abs(1j * peak - poles).min() * 2.0 ** np.arange(-PEAK_CUTS, 1.0)
    return np.concatenate([[peak], peak - steps, peak + steps])


def _cover(
    response: FrequencyResponse,
    residue: FloatArray,
    level: float,
    intervals: FloatArray,
    inverse: bool,
) -> LevelTest:
    done = 0
    while len(intervals):
        done += len(intervals)
        if done > MAX_INTERVALS:
            return LevelTest(False, False, np.zeros(0))
        kept = []
        step = max(1, CHUNK // len(response.poles))
        for start in range(0, len(intervals), step):
            part = intervals[start : start + step]
            centre, half = 0.5 * (part[:, 0] + part[:, 1]), 0.5 * (part[:, 1] - part[:, 0])
            if not inverse:
                hard = ~_clearly_below(response, residue, level, centre, half)
                part, centre, half = part[hard], centre[hard], half[hard]
            value, bound = _taylor_bound(response, residue, centre, half, inverse)
            above = value > level
            if above.any():
                found = centre[above]
                with np.errstate(divide="ignore"):
                    return LevelTest(False, True, 1.0 / found if inverse else found)
            kept.append(part[~(bound <= level)])
        intervals = np.concatenate(kept)
        middle = 0.5 * (intervals[:, 0] + intervals[:, 1])
        if np.any((middle <= intervals[:, 0]) | (middle >= intervals[:, 1])):
            return LevelTest(False, False, np.zeros(0))
        intervals = np.concatenate(
            [np.column_stack([intervals[:, 0], middle]), np.column_stack([middle, intervals[:, 1]])]
        )
    return LevelTest(True, True, np.zeros(0))


def _clearly_below(
    response: FrequencyResponse, residue: FloatArray, level: float, centre: FloatArray, half: FloatArray
) -> BoolArray:
    """Intervals on which the norms of D and of all modal terms add up to less than the level: no phase needed."""
    poles = response.poles
    distance = np.sqrt((centre[:, None] - poles.imag) ** 2 + poles.real**2) - half[:, None]
    with np.errstate(divide="ignore"):
        total = np.where(distance.min(axis=1) > 0.0, (1.0 / np.maximum(distance, 1e-300)) @ residue, np.inf)
    return np.asarray(total + largest_gains(response.D[None].astype(complex))[0] <= level)


def _taylor_bound(
    response: FrequencyResponse,
    residue: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    inverse: bool,
) -> tuple[FloatArray, FloatArray]:
    """Gain at the centres and a bound of it on the whole intervals, both (N,)."""
    p, m = response.D.shape
    poles = response.poles
    if inverse:
        base = 1j - centre[:, None] * poles
        zeroth, ratio = centre[:, None] / base, poles / base
        first = 1j / base**2
        residue = residue / np.maximum(np.abs(poles) ** 2, 1e-300)
    else:
        zeroth = 1.0 / (1j * centre[:, None] - poles)
        ratio = -1j * zeroth
        first = ratio * zeroth
    size = np.sqrt(ratio.real**2 + ratio.imag**2)
    inside = half * size.max(axis=1) < INSIDE
    gain, bound = np.zeros(len(centre)), np.full(len(centre), np.inf)
    if inside.any():
        zeroth, first, ratio, size = zeroth[inside], first[inside], ratio[inside], size[inside]
        h = half[inside]
        step = h[:, None] * size
        rest = ((size**3 * step) / (1.0 - step)) @ residue
        G0, G1, G2 = ((c @ response.residues).reshape(-1, p, m) for c in (zeroth, first, first * ratio))
        G0 += response.D
        G1 *= h[:, None, None]
        centres, lower, higher, curvature = largest_gains(np.concatenate([G0, G0 - G1, G0 + G1, G2])).reshape(4, -1)
        gain[inside] = centres
        bound[inside] = np.maximum(lower, higher) + h**2 * (curvature + rest)
    return gain, bound


def hamiltonian_test(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, level: float) -> LevelTest:
    """Whether ``C (jw I - A)^-1 B + D`` stays below `level` for all w, by the eigenvalues of a Hamiltonian matrix.

    Shapes (n, n), (n, m), (p, n), (p, m); `level` must exceed the norm of D. The frequencies answered are the
    crossings and the middles between them; eigenvalues count as imaginary generously, because each is
    tried by evaluating the gain, and one too many costs only that.
    """
    m, p = B.shape[1], len(C)
    scale = 1.0 / level
    d = D * scale
    R = np.eye(m) - d.T @ d
    S = np.eye(p) - d @ d.T
    gap = float(linalg.eigvalsh(R)[0])
    if gap <= 0.0:  # then so is the smallest eigenvalue of S
        return LevelTest(False, True, np.array([np.inf]))
    balance = np.sqrt(scale)
    b, c = B * balance, C * balance
    F = A + b @ linalg.solve(R, d.T @ c, assume_a="pos")
    H = np.block([[F, b @ linalg.solve(R, b.T, assume_a="pos")], [-c.T @ linalg.solve(S, c, assume_a="pos"), -F.T]])
    values = linalg.eigvals(H, overwrite_a=True, check_finite=False)
    size = float(np.abs(values).max(initial=0.0))
    solved = EPS * size * (1.0 / gap - 1.0)  # rounding of the solutions with R and S where the level is near norm(D)
    sizes = np.abs(values)
    imaginary = np.abs(values.real) <= 1e-7 * sizes + 1e-13 * size + 2.0 * np.sqrt(solved * sizes)
    crossings = np.unique(np.abs(values[imaginary].imag))
    if len(crossings) == 0:
        return LevelTest(True, True, np.zeros(0))
    middles = 0.5 * (crossings[:-1] + crossings[1:])
    return LevelTest(False, True, np.unique(np.concatenate([crossings, middles])))
