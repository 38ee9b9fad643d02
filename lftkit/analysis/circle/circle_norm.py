"""H-infinity and H2 norm in discrete time: gains on the unit circle, and a test that covers the circle by intervals.

Nothing is mapped to continuous time. On each interval the square of the response is a polynomial; its Bernstein
coefficients bound it (the basis functions are positive and add up to 1, and the largest eigenvalue is convex).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import comb

import numpy as np

from lftkit.analysis.batched_linalg import largest_eigenvalues, largest_gains
from lftkit.analysis.circle.circle_response import ANGLE, CircleModes, CircleResolvents, circle_modes
from lftkit.analysis.circle.exact_circle_norm import ExactCircleModel, Quotient
from lftkit.analysis.eigenvectors import EPS, balanced, modes
from lftkit.analysis.hinf.level_iteration import (
    SETTINGS,
    NormSettings,
    Peak,
    UndecidedError,
    above_level,
    bracketed_norm,
)
from lftkit.analysis.hinf.peak_search import highest_peak
from lftkit.analysis.riccati import stein
from lftkit.arrays import ComplexArray, FloatArray, Matrices


@dataclass(frozen=True)
class CirclePeak:
    """Gain reached less its rounding, level not exceeded, angle of the gain [rad], test behind the level."""

    value: float
    upper: float
    theta: float
    certificate: str = "interval"


def discrete_norm(system: Matrices, rtol: float, settings: NormSettings = SETTINGS) -> CirclePeak | None:
    """H-infinity norm of a system in discrete time with at least one state; None for an unstable one.

    Poles within four roundings per state of the circle count as unstable. The modal form is tried first, then
    resolvents, then exact arithmetic; where none of them closes the gap to `rtol`, the best bounds are returned, of the
    certificate ``none`` where there is no upper bound.
    """
    balanced_system, unit = in_units(system)
    peak = _norm_in_units(balanced_system, rtol, settings)
    return peak and replace(peak, value=peak.value * unit, upper=peak.upper * unit)


def in_units(system: Matrices) -> tuple[Matrices, float]:
    """Balanced system with entries of B, C and D of 1 at most, and by what its gain is to be multiplied; exact."""
    A, B, C = balanced(*system[:3])
    b, c = (int(np.frexp(np.abs(X).max(initial=0.0))[1]) for X in (B, C))
    d = int(np.frexp(np.abs(system[3]).max(initial=0.0))[1])
    if not (B.any() and C.any()):
        b = c = 0
    unit = max(b + c, d) if system[3].any() else b + c
    unit = int(np.clip(unit, -1000, 1000))
    return (A, np.ldexp(B, c - unit), np.ldexp(C, -c), np.ldexp(system[3], -unit)), float(np.ldexp(1.0, unit))


def stability_limit(system: Matrices) -> float:
    """Magnitude of a pole from which a system counts as unstable: four roundings per state below 1."""
    return 1.0 - 4.0 * EPS * len(system[0])


def _norm_in_units(system: Matrices, rtol: float, settings: NormSettings) -> CirclePeak | None:
    limit = stability_limit(system)
    form, stable = circle_modes(system, limit, settings)
    if stable is False:
        return None
    best = circle_norm(form, rtol) if form else None
    if best is None:
        resolvents = CircleResolvents.of(system, settings)
        if resolvents.gap.min() > 1.0 - limit:
            best = circle_norm(resolvents, rtol)
    if best is not None and best.upper <= best.value * (1.0 + rtol):
        return best
    if (quotient := Quotient.of(system, settings)) is not None:
        if stable is None and not quotient.stable(limit):
            return None
        try:
            model = ExactCircleModel(quotient, settings.circle_margin * rtol, settings)
            return CirclePeak(*bracketed_norm(model, settings.levels), "polynomial")
        except UndecidedError:
            pass
    if best is not None:
        return best
    direct = float(largest_gains(system[3][None].astype(complex))[0])  # the norm is that of D at least
    return CirclePeak(direct, float("inf"), 0.0, "none")


def circle_norm(response: CircleModes | CircleResolvents, rtol: float) -> CirclePeak | None:
    """H-infinity norm of a stable response; None where intervals do not show it.

    The two sides are `rtol` apart unless rounding forbids it; then they are as far apart as rounding makes them.
    """
    try:
        return CirclePeak(*bracketed_norm(CircleModel(response, rtol), response.settings.levels), "interval")
    except UndecidedError:
        return None


@dataclass(frozen=True)
class CircleModel:
    """Gain on the unit circle, covered by intervals: a :class:`~lftkit.analysis.hinf.level_iteration.GainModel`.

    Its frequencies are angles [rad].
    """

    response: CircleModes | CircleResolvents
    rtol: float

    def first_peak(self) -> Peak:
        """The highest peak near the ends of half the circle and the angles of the poles."""
        return self._highest(self._seeds())

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain less its rounding, and the level above the gain and what rounding does not exclude."""
        rounding = float(self.response.expansion(np.array([peak.omega]), np.zeros(1)).rounding[0])
        margin = 1.0 + self.response.settings.circle_margin * self.rtol
        level = max((peak.gain + rounding) * margin + 2.0 * rounding, peak.possible * margin)
        return max(peak.gain - rounding, 0.0), level

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """The peak near the angle at which rounding does not exclude the largest gain above the level."""
        cuts = _cuts(self.response, self._seeds(), peak.omega)
        most = self.response.settings.intervals
        above = above_level(self._bounds, level, np.column_stack([cuts[:-1], cuts[1:]]), most, most)
        if above is None:
            return None
        angles, gains = above
        worst = int(np.argmax(gains))
        return self._highest(angles[[worst]])._replace(possible=float(gains[worst]))

    def _seeds(self) -> FloatArray:
        return np.asarray(np.unique(np.concatenate([[0.0, np.pi], np.abs(self.response.angle)])))

    def _highest(self, angles: FloatArray) -> Peak:
        centres = self.response.expansion(angles, np.zeros(len(angles))).coefficients[:, 0]
        gains = np.sqrt(largest_eigenvalues(_square(centres[:, None])[:, 0]))

        settings = self.response.settings

        def distance(theta: float) -> float:
            return _distance(self.response, theta)

        return highest_peak(self.response.derivatives, distance, (angles, gains), self.rtol, (0.0, np.pi), settings)

    def _bounds(self, centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gain at the centres that rounding does not exclude, and a bound of it on the intervals, both (N,)."""
        expansion = self.response.expansion(centre, half * (1.0 + 1e-9) + 1e-15)
        square = _square(expansion.coefficients)
        bernstein = np.einsum("ab,kbij->kaij", _bernstein_matrix(2 * self.response.settings.order), square)
        k = square.shape[-1]
        highest = largest_eigenvalues(bernstein.reshape(-1, k, k)).reshape(len(centre), -1).max(axis=1)
        gains = np.sqrt(largest_eigenvalues(square[:, 0]))
        slack = expansion.rounding * 2.0 + expansion.rest
        return gains + 2.0 * expansion.rounding, np.sqrt(highest * (1.0 + 1e-14)) + slack


def _distance(response: CircleModes | CircleResolvents, theta: float) -> float:
    """Distance of the nearest pole, at least in order of magnitude."""
    apart = np.abs(np.remainder(theta - response.angle + np.pi, 2.0 * np.pi) - np.pi)
    return float(np.hypot(apart, response.gap).min(initial=1.0))


def _cuts(response: CircleModes | CircleResolvents, seeds: FloatArray, peak: float) -> FloatArray:
    """First cuts of half the circle: intervals that grow with the distance from the nearest pole and from the peak."""
    ratio = response.settings.circle_growth
    steps = _distance(response, peak) * 2.0 ** np.arange(-response.settings.peak_cuts, 1.0)
    near = (response.gap < 0.3) & (response.angle >= 0.0)
    angle, gap = np.abs(response.angle[near]), response.gap[near]
    growth = int(np.ceil(np.log(np.pi / max(float(gap.min(initial=1.0)), 1e-15)) / np.log(ratio)))
    reach = 0.5 * gap * ratio ** np.arange(growth + 2)[:, None]
    around = np.concatenate([angle - reach, angle + reach]).ravel()
    owner = np.tile(np.arange(len(angle)), 2 * len(reach))
    nearest = np.abs(around[:, None] - angle).argmin(axis=1) if len(angle) else owner
    around = around[np.abs(angle[nearest] - angle[owner]) <= 1e-12]
    every = np.concatenate([np.linspace(0.0, np.pi, 9), seeds, around, [peak], peak - steps, peak + steps])
    every = np.unique(every[(every >= 0.0) & (every <= np.pi)])
    return np.asarray(every)


def _square(coefficients: ComplexArray) -> ComplexArray:
    """Coefficients of ``G G^H`` or ``G^H G``, whichever is smaller: from (N, K + 1, p, m) to (N, 2 K + 1, k, k)."""
    G = coefficients if coefficients.shape[2] <= coefficients.shape[3] else coefficients.swapaxes(2, 3)
    H = G.conj().swapaxes(2, 3)
    order = G.shape[1] - 1
    out = np.zeros((len(G), 2 * order + 1, G.shape[2], G.shape[2]), dtype=complex)
    for a in range(order + 1):
        out[:, a : a + order + 1] += G[:, a, None] @ H
    return out


@lru_cache(maxsize=8)
def _bernstein_matrix(degree: int) -> FloatArray:
    """From coefficients of ``x^k``, x from -1 to 1, to Bernstein coefficients on that interval."""
    matrix = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        for i in range(k + 1):  # x = 2 u - 1: x^k has the coefficients comb(k, i) 2^i (-1)^(k - i)
            factor = comb(k, i) * 2**i * (-1) ** (k - i)
            for j in range(i, degree + 1):
                matrix[j, k] += factor * comb(j, i) / comb(degree, i)
    return matrix


def discrete_h2(system: Matrices, settings: NormSettings = SETTINGS) -> float | None:
    """H2 norm of a system in discrete time with at least one state; None for an unstable one.

    By the modal form, integer arithmetic, or sums by doubling, from the matrices that were given.

    Raises
    ------
    ArithmeticError
        More than 24 states, and rounding hides the norm.
    """
    balanced_system, unit = in_units(system)
    limit = stability_limit(balanced_system)
    form, stable = circle_modes(balanced_system, limit, settings)
    if stable is False:
        return None
    if form is not None:
        # Variance of the output for white noise, and what rounding may have done to it
        residues = form.residues
        gap, radius = form.gap[:, None] + form.gap - form.gap[:, None] * form.gap, 1.0 - form.gap
        phi = form.angle[:, None] - form.angle
        turn = 2.0 * np.sin(0.5 * phi) ** 2 - 1j * np.sin(phi)
        apart = gap + radius[:, None] * radius * turn  # 1 - pole_i conj(pole_j)
        products = residues @ residues.conj().T
        variance = max(float(np.sum(form.D**2) + np.sum(products / apart).real), 0.0)
        distance = np.abs(apart)
        sizes = form.sizes[:, None] * form.sizes
        turned = sizes / distance**2
        turned[np.diag_indices(len(turned))] = 0.0
        root = np.sqrt(form.gap)
        widest = np.sqrt(np.maximum(form.gap[:, None], form.gap))
        response = float(np.sum(form.inexact / root) + 2.0 * np.sum(form.couplings / (root[:, None] * root * widest)))
        rounding = 16.0 * EPS * float(np.sum(sizes / distance)) + 2.0 * ANGLE * float(turned.sum())
        error = rounding + response * (2.0 * variance**0.5 + response)
        if error <= settings.variance_error * variance:
            return unit * float(np.sqrt(variance))
    if (quotient := Quotient.of(balanced_system, settings)) is not None:
        return unit * float(np.sqrt(quotient.variance())) if quotient.stable(limit) else None
    # Variance by both Gramians, which must agree
    A, B, C, D = balanced_system
    hidden = f"rounding hides the H2 norm of a discrete-time system of order {len(A)}"
    if np.abs(modes(A).poles).max() >= limit:
        raise ArithmeticError(hidden)
    direct = float(np.sum(D**2))
    first = direct + float(np.sum((C @ stein(A, B @ B.T)) * C))
    second = direct + float(np.sum((B.T @ stein(A.T, C.T @ C)) * B.T))
    if not abs(first - second) <= settings.gramians * abs(first):
        raise ArithmeticError(hidden)
    return unit * float(np.sqrt(max(first, 0.0)))
