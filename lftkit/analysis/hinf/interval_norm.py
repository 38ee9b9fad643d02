"""H-infinity norm from a modal form: a level test that covers the whole frequency axis by intervals.

On each interval the response is a quadratic Taylor polynomial plus a rigorous remainder, both from the modal form. The
work grows with the number of resonances near the level, not with n^3. No grid is involved: a peak between two points
cannot escape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings, Peak, UndecidedError, above_level
from lftkit.analysis.hinf.peak_search import cancellation, direct_gain, highest_peak_of, peak_frequencies
from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.errors import InputError


class InexactModesError(UndecidedError):
    """The modal form differs from a direct solution."""


@dataclass(frozen=True)
class IntervalModel:
    """Gain in modal form, covered by intervals: a :class:`~lftkit.analysis.hinf.level_iteration.GainModel`.

    Parameters
    ----------
    system : tuple of ndarray
        Balanced matrices, shapes (n, n), (n, m), (p, n), (p, m): of direct solutions.
    response : FrequencyResponse
        The same in modal form, all poles left of the imaginary axis.
    rtol : float
        Relative distance of the two sides.
    settings : NormSettings
    """

    system: Matrices
    response: FrequencyResponse
    rtol: float
    settings: NormSettings = SETTINGS

    def first_peak(self) -> Peak:
        """The highest peak near the resonances."""
        return highest_peak_of(self.response, np.append(self._seeds, np.inf), self.rtol, self.settings)

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain by a direct solution, which the modal form must reproduce, and the level above it."""
        value, noise = direct_gain(self.system, peak.omega), cancellation(self.response)
        if abs(value - peak.gain) > max(self.settings.agreement * self.rtol * value, noise):
            raise InexactModesError(f"the modal form has the gain {peak.gain}, a direct solution {value}")
        return value, value * (1.0 + self.rtol) if value > noise else value + noise

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """The highest peak near the first intervals that exceed the level."""
        above = interval_test(self.response, level, self._seeds, peak.omega, self.settings)
        return None if above is None else highest_peak_of(self.response, above, self.rtol, self.settings)

    @cached_property
    def _seeds(self) -> FloatArray:
        return peak_frequencies(self.response.poles.tolist())


def interval_test(
    response: FrequencyResponse,
    level: float,
    seeds: FloatArray,
    peak: float | None = None,
    settings: NormSettings = SETTINGS,
) -> FloatArray | None:
    """Frequencies at which the largest singular value exceeds `level` [rad/s]; None: it stays below at all.

    Parameters
    ----------
    response : FrequencyResponse
        In modal form, all poles off the imaginary axis.
    level : float
    seeds : ndarray, shape (k,)
        Frequencies [rad/s] at which the axis is first cut: resonances.
    peak : float, optional
        Frequency of the largest gain known [rad/s], where the cuts are closest.
    settings : NormSettings
        Of these `intervals`, `chunk`, `inside`, `growth` and `peak_cuts`.

    Raises
    ------
    ValueError
        A Schur form.
    UndecidedError
        Too many intervals.

    Notes
    -----
    Around c, ``1/(jw - lambda) = sum_m (-j)^m (w - c)^m / (jc - lambda)^(m+1)``. On |w - c| <= h the norm of the linear
    part is largest at an end (the norm is convex); the quadratic part adds h^2 ||G_2||; the rest is at most
    h^3 sum_k r_k / (d_k^3 (d_k - h)), with d_k the distance of pole k and r_k the norm of its residue. Above twice the
    largest pole the same is done in 1/w, down to 0, so that infinity is covered too.
    """
    if not response.modal:
        raise InputError("response must be in modal form, got a Schur form")
    poles = response.poles
    residue = response.residue_norms
    top = 2.0 * float(np.abs(poles).max(initial=1.0))
    cuts = _cuts(poles, seeds, top, peak, settings)
    most, step = settings.intervals, max(1, settings.chunk // max(len(poles), 1))
    ends, tail = np.column_stack([cuts[:-1], cuts[1:]]), np.array([[0.0, 1.0 / top]])
    direct = largest_gains(response.D[None].astype(complex))[0]

    def up_to_top(centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
        # Elsewhere the norms of D and of all modal terms add up to less than the level: no phase is needed
        distance = np.sqrt((centre[:, None] - poles.imag) ** 2 + poles.real**2) - half[:, None]
        with np.errstate(divide="ignore"):
            total = np.where(distance.min(axis=1) > 0.0, (1.0 / np.maximum(distance, 1e-300)) @ residue, np.inf)
        hard = ~(total + direct <= level)
        gain, bound = np.zeros(len(centre)), np.full(len(centre), level)
        gain[hard], bound[hard] = _taylor_bound(response, residue, centre[hard], half[hard], False, settings)
        return gain, bound

    above = above_level(up_to_top, level, ends, most, step)
    if above is not None:
        return above[0]
    above = above_level(
        lambda centre, half: _taylor_bound(response, residue, centre, half, True, settings), level, tail, most, step
    )
    if above is None:
        return None
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / above[0])


def _cuts(poles: ComplexArray, seeds: FloatArray, top: float, peak: float | None, settings: NormSettings) -> FloatArray:
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
        reach = reach * settings.growth
    if peak is not None and np.isfinite(peak):  # where its parabola has fallen by x^2, intervals of the length x pass
        steps = np.abs(1j * peak - poles).min() * 2.0 ** np.arange(-settings.peak_cuts, 1.0)
        cuts += [np.array([peak]), peak - steps, peak + steps]
    every = np.unique(np.concatenate(cuts))
    return np.asarray(every[(every >= 0.0) & (every <= top)])


def _taylor_bound(
    response: FrequencyResponse,
    residue: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    inverse: bool,
    settings: NormSettings = SETTINGS,
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
    inside = half * size.max(axis=1) < settings.inside
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
