r"""Transfer function of the motion during an exposure, exact.

The path x(t) of the line of sight is piecewise linear between its samples. Over an exposure of N periods

.. math:: M(f) = \frac{1}{T}\int_0^T e^{-2\pi i f\cdot x(t)}\,dt
          = \frac{1}{N}\sum_j e^{-2\pi i f\cdot m_j}\,\mathrm{sinc}(f\cdot d_j)

with the middle :math:`m_j` of segment j and the way :math:`d_j` along it. The mean of x shifts the image and does not
blur it: |M| is what counts. From :math:`\cos y \ge 1 - y^2/2` always :math:`|M| \ge 1 - 2\pi^2 f^T C f`, C the
covariance of x in the exposure (`covariance`).

An exposure of N periods has N + 1 samples: the last of one is the first of the next. One with a missing sample is
missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from pointing_analysis.indices.metrics import window_samples
from pointing_analysis.read.mapped_arrays import release

BLOCK = 1 << 17
"""Phases that are worked on at a time: they stay in the processor's cache."""
PART = 4096
"""Exposures that are worked on at a time."""
SERIES_BELOW = 0.5
"""Half phase [rad] below which sin(s) / s is a polynomial."""
_SINC = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(8))
DIRECTIONS = 24
"""Directions that a search for the worst one begins with, at least."""
MAX_DIRECTIONS = 240
REFINEMENTS = 4


def exposures(error: FloatArray, dt: float, exposure: float) -> FloatArray:
    """Cut a series into exposures, one after the other: (n, 2) -> (m, N + 1, 2), same unit.

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt : sampling period [s]
    exposure : [s], a whole number N of periods

    Raises
    ------
    ValueError
        The exposure is no whole number of samples, or longer than the run.
    """
    n = window_samples(exposure, dt)
    m = (len(error) - 1) // n
    if m < 1:
        raise InputError(
            f"the run must last for one exposure of {exposure:g} s and a sample, got {len(error)} samples of {dt:g} s"
        )
    index = n * np.arange(m)[:, None] + np.arange(n + 1)
    return np.asarray(error[index, :2])


def some_exposures(error: FloatArray, dt: float, exposure: float, most: int) -> tuple[FloatArray, IntArray]:
    """At most so many exposures, spread evenly over the series, without those that miss a sample.

    Returns
    -------
    paths : (m, N + 1, 2)
    index : (m,) number of each among all exposures

    Raises
    ------
    ValueError
        As `exposures`.
    """
    n = window_samples(exposure, dt)
    m = (len(error) - 1) // n
    if m < 1:
        exposures(error, dt, exposure)  # raises the error
    index = np.unique(np.linspace(0, m - 1, min(most, m)).round().astype(np.int64))
    paths = np.asarray(error[n * index[:, None] + np.arange(n + 1), :2])
    release()
    whole = ~missing(paths)
    return paths[whole], index[whole]


def exposure_parts(error: FloatArray, dt: float, exposure: float, count: int = PART) -> Iterator[FloatArray]:
    """`exposures` of a series of any length, at most `count` at a time."""
    n = window_samples(exposure, dt)
    m = (len(error) - 1) // n
    if m < 1:
        exposures(error, dt, exposure)  # raises the error
    for first in range(0, m, count):
        last = min(first + count, m)
        yield exposures(np.array(error[first * n : last * n + 1]), dt, exposure)
        release()


def missing(paths: FloatArray) -> BoolArray:
    """Which exposures have a missing sample: (m, N + 1, 2) -> (m,)."""
    return np.asarray(np.isnan(paths).any(axis=(1, 2)))


def means(paths: FloatArray) -> FloatArray:
    """Mean over the time of each exposure: (m, N + 1, 2) -> (m, 2)."""
    inner = paths[:, 1:-1].sum(axis=1)
    return np.asarray((inner + 0.5 * (paths[:, 0] + paths[:, -1])) / (paths.shape[1] - 1))


def centred(paths: FloatArray) -> FloatArray:
    """Paths about their own means: the blur without the shift."""
    return np.asarray(paths - means(paths)[:, None, :])


def covariance(paths: FloatArray) -> FloatArray:
    """Covariance over the time of each exposure, exact for the piecewise linear path: (m, N + 1, 2) -> (m, 2, 2)."""
    x = centred(paths)
    a, b = x[:, :-1], x[:, 1:]
    same = np.einsum("mni,mnj->mij", a, a) + np.einsum("mni,mnj->mij", b, b)
    other = np.einsum("mni,mnj->mij", a, b)
    return np.asarray((same / 3 + (other + other.transpose(0, 2, 1)) / 6) / (paths.shape[1] - 1))


def sizes(paths: FloatArray) -> FloatArray:
    """Largest distance from the mean in each exposure: (m, N + 1, 2) -> (m,)."""
    x = centred(paths)
    return np.asarray(np.hypot(x[..., 0], x[..., 1]).max(axis=1))


def _sinc(half: FloatArray) -> FloatArray:
    """sin(s) / s, by its series where all s are small."""
    if not half.size or float(np.abs(half).max()) < SERIES_BELOW:
        square = half * half
        found = np.full_like(half, _SINC[-1])
        for coefficient in _SINC[-2::-1]:
            found *= square
            found += coefficient
        return found
    return np.asarray(np.sinc(half / math.pi))


def _transfer(paths: FloatArray, frequencies: FloatArray) -> ComplexArray:
    """Of a block: (m, N + 1, 2) and (f, 2), or (m, f, 2) -> (m, f)."""
    phase = 2 * math.pi * (paths @ np.swapaxes(frequencies, -1, -2))
    before, after = phase[:, :-1], phase[:, 1:]
    middle = before + after
    middle *= 0.5
    way = after - before
    way *= 0.5
    size = _sinc(way)
    found = np.empty((len(paths), phase.shape[2]), dtype=complex)
    found.real = np.mean(np.cos(middle) * size, axis=1)
    found.imag = -np.mean(np.sin(middle) * size, axis=1)
    return found


def motion_transfer(paths: FloatArray, frequencies: FloatArray) -> ComplexArray:
    """Transfer function of the motion in each exposure.

    Parameters
    ----------
    paths : (m, N + 1, 2) [rad]
    frequencies : (f, 2) [cycles/rad], or (m, f, 2) where each exposure has its own

    Returns
    -------
    (m, f)

    Examples
    --------
    A steady motion over one cycle of the pattern leaves nothing of it:

    >>> path = np.column_stack([np.linspace(0.0, 1e-6, 21), np.zeros(21)])[None]
    >>> abs(motion_transfer(path, np.array([[0.5e6, 0.0], [1e6, 0.0]]))).round(6)
    array([[0.63662, 0.     ]])
    """
    frequencies = np.asarray(frequencies, dtype=float)
    count = max(BLOCK // max(paths.shape[1] * frequencies.shape[-2], 1), 1)
    found = np.empty((len(paths), frequencies.shape[-2]), dtype=complex)
    for first in range(0, len(paths), count):
        rows = slice(first, first + count)
        found[rows] = _transfer(paths[rows], frequencies if frequencies.ndim == 2 else frequencies[rows])
    return found


def clipped_transfer(path: FloatArray, frequencies: FloatArray, reach: float) -> ComplexArray:
    """Transfer of the part of an exposure in which the star is in a square: what it does elsewhere is not in the image.

    Parameters
    ----------
    path : (N + 1, 2) [rad]
    frequencies : (f, 2) [cycles/rad]
    reach : [rad] half the side of the square about zero

    Returns
    -------
    (f,), at zero frequency the part of the time within the square; all of `motion_transfer` for a path within it

    Examples
    --------
    A star that moves steadily from the middle to twice the reach is seen half of the time:

    >>> clipped_transfer(np.array([[0.0, 0.0], [2e-6, 0.0]]), np.zeros((1, 2)), 1e-6).real
    array([0.5])
    """
    if float(np.abs(path).max()) <= reach:
        return np.asarray(motion_transfer(path[None], frequencies)[0])
    start, way = path[:-1], np.diff(path, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.array([-reach, reach])[:, None, None] - start) / way  # where a segment meets a side, in parts of it
    along, inside = way != 0.0, np.abs(start) <= reach
    first = np.where(along, ends.min(axis=0), np.where(inside, 0.0, np.inf)).max(axis=1).clip(0.0, None)
    last = np.where(along, ends.max(axis=0), np.inf).min(axis=1).clip(None, 1.0)
    found = np.zeros(len(frequencies), dtype=complex)
    for j in np.flatnonzero(last > first):
        piece = start[j] + np.array([[first[j]], [last[j]]]) * way[j]
        found += (last[j] - first[j]) * motion_transfer(piece[None], frequencies)[0]
    return np.asarray(found / len(way))


def _direction(angle: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def worst_transfer(paths: FloatArray, frequency: float) -> tuple[FloatArray, FloatArray]:
    r"""Smallest transfer of each exposure over all directions of the pattern.

    Parameters
    ----------
    paths : (m, N + 1, 2) [rad]
    frequency : [cycles/rad]

    Returns
    -------
    transfer : (m,) the smallest of \|M\|
    angle : (m,) [rad] direction across the lines of the pattern, from +x to +y
    """
    x = centred(paths)
    phase = 2 * math.pi * frequency * sizes(paths)
    transfer, angle = np.empty(len(x)), np.empty(len(x))
    for rows, top in levels(phase, (3.0, 12.0, 48.0, math.inf)):
        count = min(max(DIRECTIONS, 8 * math.ceil(min(top, 90.0))), MAX_DIRECTIONS)
        transfer[rows], angle[rows] = _worst_of(x[rows], frequency, count)
    return transfer, angle


def levels(phase: FloatArray, tops: tuple[float, ...]) -> list[tuple[IntArray, float]]:
    """Rows by the size of their phases, with the upper end of each class; empty classes are left out."""
    found: list[tuple[IntArray, float]] = []
    below = -math.inf
    for top in tops:
        rows = np.asarray(np.flatnonzero((phase > below) & (phase <= top)), dtype=np.int64)
        if rows.size:
            found.append((rows, top))
        below = top
    return found


def _worst_of(x: FloatArray, frequency: float, count: int) -> tuple[FloatArray, FloatArray]:
    step = math.pi / count
    grid = np.asarray(step * np.arange(count), dtype=float)
    size = np.abs(motion_transfer(x, frequency * _direction(grid)))
    at = size.argmin(axis=1)
    each = np.arange(len(x))
    angle, best = grid[at], size[each, at]
    sides = (size[each, at - 1], size[each, (at + 1) % count])
    for _ in range(REFINEMENTS):  # a parabola through three directions, each time a fifth as far apart
        bend = sides[0] - 2 * best + sides[1]
        move = np.where(bend > 0, 0.5 * (sides[0] - sides[1]) / np.where(bend > 0, bend, 1.0), 0.0)
        middle = angle + step * np.clip(move, -1.0, 1.0)
        step /= 5
        beside = step * np.array([-1.0, 0.0, 1.0])
        found = np.abs(motion_transfer(x, frequency * _direction(middle[:, None] + beside)))
        better = found[:, 1] <= best
        if not better.all():  # the parabola led away: about the best direction so far instead
            again = angle[~better, None] + beside
            found[~better] = np.abs(motion_transfer(x[~better], frequency * _direction(again)))
            middle = np.where(better, middle, angle)
        angle, best, sides = middle, found[:, 1], (found[:, 0], found[:, 2])
    return best, np.mod(angle, math.pi)
