"""Lower bounds: members of an uncertain system with a large gain, and unstable members near the nominal one."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, optimize

from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.analysis.frequency_response import refined_response
from lftkit.analysis.lft_response import LftResponse
from lftkit.analysis.norms import hinf_norm
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.settings import SEARCH, SearchSettings
from lftkit.proofs.state_space.corners import CornerSearch, abscissas, earliest_unstable_corner
from lftkit.systems.system import System

sl_optimize: Any = optimize


@dataclass(frozen=True)
class Member:
    """A member of the uncertain system: gain (infinite if it is unstable), parameter values, frequency [rad/s]."""

    gain: float
    point: FloatArray
    frequency: float


def member_gain(system: System, point: FloatArray, band: tuple[float, float], gain: bool = True) -> Member:
    """Largest gain in the band at one point; zero without inputs or outputs, infinite if unstable or not well posed.

    For a band that is not the whole axis, poles count as unstable only in a test of the whole axis.
    """
    values = {p.name: float(v) for p, v in zip(system.parameters, point)}
    try:
        data = system.at(values, beyond_range=True)
    except ValueError:
        return Member(np.inf, point, np.inf)
    whole = band == (0.0, np.inf)
    poles = np.asarray(linalg.eigvals(data.A), complex) if data.order else np.zeros(0, complex)
    if whole and np.any(poles.real >= 0.0):
        return Member(np.inf, point, float(abs(poles[np.argmax(poles.real)].imag)))
    if not gain:
        return Member(0.0, point, 0.0)
    if whole:
        norm = hinf_norm(*data.matrices, rtol=1e-4)
        return Member(norm.value, point, norm.omega)
    low, high = band
    least, most = pole_range(poles)
    top = high if np.isfinite(high) else 100.0 * max(1.0, low, most)
    floor = max(low, min(1e-4 * top, 0.5 * least))
    omega = np.unique([low, *frequency_grid(poles, floor, top, points=60, offsets=(0.0,))])

    def at(w: float) -> float:
        return float(linalg.norm(refined_response(*data.matrices, w), 2)) if min(data.matrices[3].shape) else 0.0

    gains = np.array([at(float(w)) for w in omega])
    best = int(np.argmax(gains))
    bracket = (float(omega[max(best - 1, 0)]), float(omega[min(best + 1, len(omega) - 1)]))
    peak = optimize.minimize_scalar(lambda w: -at(float(w)), bounds=bracket, method="bounded")
    if -peak.fun > gains[best]:
        return Member(float(-peak.fun), point, float(peak.x))
    return Member(float(gains[best]), point, float(omega[best]))


def worst_member(
    system: System,
    box: Sequence[tuple[float, float]],
    band: tuple[float, float],
    *,
    seed: int = 0,
    settings: SearchSettings = SEARCH,
) -> Member:
    """The member with the largest gain among middle, corners and random ones, improved by a local search."""
    ends = np.array(box, dtype=float).reshape(-1, 2)
    rng, size = np.random.default_rng(seed), len(ends)
    corners = list(
        itertools.islice(itertools.product((0.0, 1.0), repeat=size), 2**size if size <= settings.all_corners else 0)
    )
    shares = [np.full(size, 0.5), *(np.array(c) for c in corners)]
    if size > settings.all_corners:
        if band == (0.0, np.inf):
            shares += _unstable_shares(system, ends, seed, settings)
        shares += list(rng.integers(0, 2, (settings.more_corners, size)).astype(float))
    shares += list(rng.random((settings.samples, size))) if size else []
    members = []
    for share in shares:
        members.append(member_gain(system, ends[:, 0] + share * (ends[:, 1] - ends[:, 0]), band))
        if np.isinf(members[-1].gain):
            return members[-1]
    members.sort(key=lambda member: -member.gain)
    starts = members[: 1 if size <= settings.all_corners else settings.climbs]
    return max((climbed(system, box, band, start, settings=settings) for start in starts), key=lambda top: top.gain)


def _unstable_shares(system: System, ends: FloatArray, seed: int, settings: SearchSettings) -> list[FloatArray]:
    """A corner of the box that is unstable, if one is found."""
    nominal = np.array([p.nominal for p in system.parameters])
    if not system.order or np.any(nominal < ends[:, 0]) or np.any(nominal > ends[:, 1]):
        return []
    bare = system.select(inputs=(), outputs=())
    search, samples = CornerSearch(bare, ends - nominal[:, None], settings), settings.random_corners
    corner = earliest_unstable_corner(search, 1.0, lambda corner: 0.0, samples=samples, seed=seed)[1]
    return [] if corner is None else [0.5 * (1.0 + corner)]


class _Unstable(Exception):
    """Ends a climb: an unstable member is as bad as can be."""


def climbed(
    system: System,
    box: Sequence[tuple[float, float]],
    band: tuple[float, float],
    start: Member,
    evaluations: int = 150,
    settings: SearchSettings = SEARCH,
) -> Member:
    """Local search for a larger gain from `start`, inside the box.

    Where there are many parameters it is an ascent of the logarithm of the peak, whose slopes are those of the gain at
    the frequency of the peak.
    """
    ends = np.array(box, dtype=float).reshape(-1, 2)
    width = ends[:, 1] - ends[:, 0]
    if not np.any(width > 0.0) or np.isinf(start.gain):
        return start
    best, bounds = start, [(0.0, 1.0)] * len(ends)

    def shares(member: Member) -> FloatArray:
        return np.asarray(np.clip((member.point - ends[:, 0]) / np.where(width > 0.0, width, 1.0), 0.0, 1.0))

    def member_at(share: FloatArray) -> Member:
        nonlocal best
        point = np.clip(ends[:, 0] + np.clip(share, 0.0, 1.0) * width, ends[:, 0], ends[:, 1])
        member = member_gain(system, point, band)
        best = member if member.gain > best.gain else best
        return member

    def logarithm(share: FloatArray) -> tuple[float, FloatArray]:
        member = member_at(share)
        if np.isinf(member.gain):
            raise _Unstable
        if not member.gain > 0.0:
            return 0.0, np.zeros(len(width))
        return -float(np.log(member.gain)), -gain_slopes(system, member) * width / member.gain

    if len(ends) <= settings.all_corners:
        sl_optimize.minimize(
            lambda share: -min(member_at(share).gain, 1e300),
            shares(start),
            method="Powell",
            bounds=bounds,
            options={"maxfev": evaluations, "xtol": 1e-3, "ftol": 1e-4},
        )
        return best
    with suppress(_Unstable, linalg.LinAlgError):
        for _ in range(settings.corner_steps):
            before = best.gain
            logarithm(np.where(gain_slopes(system, best) > 0.0, 1.0, 0.0))
            if best.gain <= before * (1.0 + 1e-9):
                break
        options = {"maxfun": settings.slopes, "ftol": 1e-7}
        sl_optimize.minimize(logarithm, shares(best), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return best


def gain_slopes(system: System, member: Member) -> FloatArray:
    """Derivatives of the gain of a member by its parameters, at its frequency.

    Raises
    ------
    LinAlgError
        The nominal member has a pole there.
    """
    n = system.order
    table = {p.name: v - p.nominal for p, v in zip(system.parameters, member.point)}
    delta = np.array([table[c] for c in system.channels])
    whole = np.asarray(system.D, complex)
    if n and np.isfinite(member.frequency):
        whole = whole + system.C @ linalg.solve(1j * member.frequency * np.eye(n) - system.A, system.B.astype(complex))
    each = response_slopes(whole, delta)[1]
    return np.array([sum(each[i] for i, c in enumerate(system.channels) if c == p.name) for p in system.parameters])


def response_slopes(whole: ComplexArray, delta: FloatArray) -> tuple[float, FloatArray]:
    """Gain of a response whose first channels are closed by ``w = delta z``, and its derivatives by each delta.

    Parameters
    ----------
    whole : ndarray, complex, shape (q + p, q + m)
    delta : ndarray, shape (q,)

    Raises
    ------
    LinAlgError
        The loop is singular.
    """
    slopes = LftResponse.of(whole[None], len(delta)).gain_slopes(delta[None].astype(complex))
    return float(slopes.values[0, 0]), slopes.slopes[0].real


def scaled_box(system: System, box: Sequence[tuple[float, float]], factor: float) -> list[tuple[float, float]]:
    """The box with all its intervals scaled about the nominal values."""
    return [
        (p.nominal + factor * (low - p.nominal), p.nominal + factor * (high - p.nominal))
        for p, (low, high) in zip(system.parameters, box)
    ]


def smallest_unstable_factor(
    system: System,
    box: Sequence[tuple[float, float]],
    largest: float,
    *,
    seed: int = 0,
    settings: SearchSettings = SEARCH,
) -> tuple[float, FloatArray, float]:
    """Smallest factor found at which the scaled box has an unstable member, the member, its frequency [rad/s].

    Infinite if none was found below `largest`.
    """
    nominal = np.array([p.nominal for p in system.parameters])
    ends = np.array(box, dtype=float).reshape(-1, 2) - nominal[:, None]
    size, rng = len(ends), np.random.default_rng(seed)

    def offset(direction: FloatArray) -> FloatArray:
        return np.where(direction < 0.0, -direction * ends[:, 0], direction * ends[:, 1])

    def factor_of(direction: FloatArray) -> float:
        length = float(np.abs(direction).max(initial=0.0))
        return ray_factor(system, offset(direction / length), largest, settings) if length > 0.0 else np.inf

    corners = [np.array(c) for c in itertools.product((-1.0, 1.0), repeat=size)] if size <= settings.all_corners else []
    if size > settings.all_corners and system.order:
        search = CornerSearch(system, ends, settings)
        corner = earliest_unstable_corner(search, largest, factor_of, samples=settings.random_corners, seed=seed)[1]
        corners += [corner] if corner is not None else []
    starts = corners + list(np.eye(size)) + list(-np.eye(size))
    starts += [d / np.abs(d).max() for d in rng.uniform(-1.0, 1.0, (2 * settings.samples, size))] if size else []
    if not starts:
        return np.inf, nominal, 0.0
    factors = [factor_of(d) for d in starts]
    order = np.argsort(factors)[:2]
    best, direction = factors[order[0]], starts[order[0]]
    if size > 1:
        for start in (starts[i] for i in order if np.isfinite(factors[i])):
            result: Any = sl_optimize.minimize(
                lambda d: min(factor_of(d), 1e6),
                start,
                method="Powell",
                bounds=[(-1.0, 1.0)] * size,
                options={"maxfev": 120, "xtol": 1e-5, "ftol": 1e-8},
            )
            if result.fun < best:
                best, direction = float(result.fun), result.x / np.abs(result.x).max()
    if not np.isfinite(best):
        return np.inf, nominal, 0.0
    point = nominal + best * offset(direction)
    return best, point, member_gain(system, point, (0.0, np.inf), gain=False).frequency


def ray_factor(system: System, offset: FloatArray, largest: float, settings: SearchSettings = SEARCH) -> float:
    """First factor on a ray from the nominal member with an unstable member; infinite if there is none."""
    table = {p.name: o for p, o in zip(system.parameters, offset)}
    per_channel = np.array([table[c] for c in system.channels])
    precision = settings.precision
    grid = largest * np.linspace(0.0, 1.0, settings.ray_points + 1)[1:] ** 1.5
    abscissae = abscissas(system, grid[:, None] * per_channel)
    if not np.any(abscissae >= 0.0):
        return np.inf
    first = int(np.argmax(abscissae >= 0.0))

    def abscissa(factor: float) -> float:
        return min(float(abscissas(system, factor * per_channel[None])[0]), 1e300)  # finite, for the search of the root

    low, high = float(grid[first - 1]) if first else 0.0, float(grid[first])
    if abscissa(low) >= 0.0:  # at the nominal member
        return first_true(lambda factor: abscissa(factor) >= 0.0, [high], precision)
    root = sl_optimize.brentq(abscissa, low, high, xtol=1e-300, rtol=0.1 * precision, maxiter=200, disp=False)
    beyond = (min(root * (1.0 + part * precision), high) for part in (0.2, 0.5, 1.0, 10.0, 1e3))
    return next((factor for factor in beyond if abscissa(factor) >= 0.0), high)


def first_true(condition: Callable[[float], bool], grid: Iterable[float], rtol: float) -> float:
    """The least number at which a condition holds, among those of an ascending grid and below the first; or infinity.

    Between two of the grid, of which it holds at the upper one, the number is bisected to `rtol`.
    """
    before = 0.0
    for at in grid:
        if condition(float(at)):
            high = float(at)
            while high - before > rtol * high:
                middle = 0.5 * (before + high)
                if condition(middle):
                    high = middle
                else:
                    before = middle
            return high
        before = float(at)
    return np.inf
