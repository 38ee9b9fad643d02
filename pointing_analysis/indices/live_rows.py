"""Rows of a record that tell nothing of the motion where they are: stuck, filled, or interpolated at irregular places.

- **stuck**: a row that repeats the one before it. In a signal that is not quantised this does not happen by chance; in
  a quantised one it does, for a geometrically distributed number of rows, or between values one quantum apart. A motion
  without noise comes to rest: where it began, else without a jump, at zero or of the velocity, before or after it.
- **filled**: a row with a value that comes again and again, alone, where no other one does: what a program writes for
  a sample that it does not have.
- **interpolated** at irregular places: rows on a line, or on a polynomial of third order, through their neighbours, to
  the digits of the file, between rows that are not. A motion with noise has none; one without has them everywhere, at
  the same phase of each period, or between corners of one size.

An axis that is constant in the whole record is a motion that does not change. Rounding to a quantum that is larger than
the motion leaves nothing of it, see :func:`coarse_quantum`. Others: :mod:`pointing_analysis.indices.held_rows`,
:mod:`pointing_analysis.indices.saturation`.
"""

from __future__ import annotations

import math

import numpy as np

from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.indices.exceedances import period
from pointing_analysis.indices.row_signs import (
    SETTINGS,
    LiveRowSettings,
    marks,
    of_quantisation,
    quantum_of,
    typical_step,
)
from pointing_analysis.read.mapped_arrays import PART


def stuck_rows(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> BoolArray:
    """Which rows (n,) of a record (n, 2) repeat the one before in either axis, more often than by chance.

    Examples
    --------
    >>> e = np.random.default_rng(1).standard_normal((1000, 2))
    >>> e[300:500, 0] = e[300, 0]
    >>> coarse = np.round(e)
    >>> [int(stuck_rows(record).sum()) for record in (e, coarse, coarse[:300])]
    [199, 199, 0]
    """
    stuck = np.zeros(len(e), bool)
    if len(e) < settings.fewest:
        return stuck
    for x in e.T:
        repeated = marks(x[:, None], lambda rows: rows[1:-1, 0] == rows[:-2, 0])
        repeated[0] = False
        if repeated.any():
            stuck |= repeated & ~_explained_repeats(x, repeated, settings)
    return stuck


def filled_rows(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> BoolArray:
    """Which rows (n,) of a record (n, 2) have a value that an axis jumps to again and again, where no other one comes.

    It is looked for in rows all over the record, and is no extreme one. In a signal that is coarsely rounded, or
    repeats itself, other values come again as well.

    Examples
    --------
    >>> e = np.random.default_rng(1).standard_normal((10_000, 2))
    >>> filled = np.where(np.abs(e) < 2.0, e, 0.0)
    >>> int(filled_rows(filled).sum()), int(np.any(np.abs(e) >= 2.0, axis=1).sum()), int(filled_rows(e).sum())
    (865, 865, 0)
    """
    return np.asarray(np.any([_filled(x, settings) for x in e.T], axis=0)) if len(e) else np.zeros(0, bool)


def _filled(x: FloatArray, settings: LiveRowSettings) -> BoolArray:
    """Rows (n,) of an axis that are filled."""
    some = np.asarray(x[:: max(len(x) // settings.sampled, 1)])
    values, counts = np.unique(some[np.isfinite(some)], return_counts=True)
    if len(values) < settings.fewest:
        return np.zeros(len(x), bool)
    by_count = np.argsort(counts)
    if counts[by_count[-1]] == counts[by_count[-2]]:
        return np.zeros(len(x), bool)  # as in all rows of a signal that is not rounded
    other, value = values[by_count[-2:]]
    filled, steps, typical = np.asarray(x == value), np.abs(np.diff(x)), typical_step(x)
    into = steps[filled[1:] & ~filled[:-1]]
    again = np.asarray(x == other)
    if len(into) <= settings.margin + settings.beside * np.count_nonzero(again[1:] & ~again[:-1]):
        return np.zeros(len(x), bool)
    rounded = typical <= settings.clear * np.min(steps, where=steps > 0.0, initial=math.inf)  # to few values
    if rounded or value in (np.nanmin(x), np.nanmax(x)):
        return np.zeros(len(x), bool)
    jumps = np.count_nonzero(into > settings.rest * typical)
    return filled if jumps > max(settings.margin, len(into) // 2) else np.zeros(len(x), bool)


def _explained_repeats(x: FloatArray, repeated: BoolArray, settings: LiveRowSettings) -> BoolArray:
    """Which rows are in a run of equal values of quantisation or rest; all of them in an axis that does not move."""
    steps = np.abs(np.diff(x))
    moving = steps[steps > 0.0]
    if not moving.size:
        return np.ones(len(x), bool)
    starts = np.flatnonzero(~repeated)
    lengths = np.diff(np.append(starts, len(x)))
    into = np.append(0.0, steps)[starts]
    edges = np.fmax(into, np.append(into[1:], 0.0))
    quantum, typical = float(moving.min()), float(np.median(moving))
    quantised = quantum >= settings.fine * typical and bool(quantum_of(np.diff(x[:PART])[:, None], settings)[0])
    # Probability of one row that repeats, in a quantised axis at most, by the rows beside the longest run
    others, seen = len(x) - int(lengths.max()), int(repeated.sum()) - int(lengths.max()) + 1
    one = (seen + settings.beside) / (others + settings.beside) if quantised else quantum / typical
    chance = math.log(settings.chance / len(x))
    longest: FloatArray | float = chance / math.log(min(max(one, 1e-300), 1.0 - 1e-15))
    # Many single rows that repeat are no chance either, where rows further apart are not equal as often
    equal = int(np.count_nonzero(x[settings.apart :] == x[: -settings.apart]))
    if not quantised and int(repeated.sum()) > settings.margin + settings.beside * max(one * len(x), equal):
        longest = 0.0
    still = settings.fine * typical  # step of a motion that hardly moves
    if quantised and moving.size >= settings.fewest:
        if _is_rough(x[starts], quantum, settings):  # it repeats more where it is slow: by the rows beside each run
            ends, total = starts + lengths, np.append(0, np.cumsum(repeated))
            first, last = (
                np.maximum(starts - settings.around * lengths, 0),
                np.minimum(ends + settings.around * lengths, len(x)),
            )
            near = total[last] - total[ends] + total[starts] - total[first]
            share = (near + settings.beside) / (last - first - lengths + settings.beside)
            longest = np.maximum(longest, chance / np.log(np.minimum(share, 1.0 - 1e-15)))
        else:
            still = 2.001 * quantum
    # The steps of a motion without noise change less from row to row than those of noise, by 1.4 or 1.7 of themselves
    changes = np.abs(np.diff(x[starts], n=2)[:PART])
    change = float(np.nanmedian(changes)) if np.isfinite(changes).any() else 0.0
    begun = (x[starts] == x[0]) & (lengths[0] > settings.margin)  # a motion that begins at rest comes back to it
    jumps = _jumps(x, starts, lengths, change, settings) & ~((x[starts] == 0.0) & ~(edges > settings.turned * typical))
    rests = (change <= settings.smooth * typical) & (begun | ~jumps)
    return np.asarray(np.repeat((lengths - 1 <= longest) | (edges <= still) | rests, lengths))


def _jumps(x: FloatArray, starts: IntArray, lengths: IntArray, usual: float, settings: LiveRowSettings) -> BoolArray:
    """Before or after which runs of equal values the velocity is not small beside its changes nearby.

    Where these are not known, beside the `usual` ones of the record.
    """
    steps = np.append(np.diff(x), np.nan)  # from each row to the next one
    changes = np.append(np.diff(steps), np.nan)
    near, ends = np.arange(settings.near), starts + lengths - 1
    jumps = np.zeros(len(starts), bool)
    for into, rows in ((starts - 1, starts[:, None] - 3 - near), (ends, ends[:, None] + 1 + near)):
        inside = (rows >= 0) & (rows < len(x))
        nearby = np.fmax.reduce(np.where(inside, np.abs(changes[np.where(inside, rows, -1)]), np.nan), axis=1)
        turns = lengths == 2  # two rows beside an extreme value
        nearby = np.where(np.isnan(nearby) | turns, settings.turned * np.fmax(nearby, usual), nearby)
        jumps |= (into >= 0) & (np.abs(steps[into]) > nearby)
    return jumps


def _is_rough(values: FloatArray, quantum: float, settings: LiveRowSettings) -> bool:
    """Whether the values (m,) of a quantised signal, repeated ones left out, jump to and fro by several quanta.

    A smooth motion changes by single quanta where it is slow, and turns back seldom where it is fast.
    """
    steps = np.diff(values[:PART])
    steps = steps[np.isfinite(steps)]
    jumps = np.mean(np.abs(steps) > 1.5 * quantum) if steps.size else 0.0
    turns = np.mean(steps[1:] * steps[:-1] < 0.0) if steps.size > 1 else 0.0
    return bool(jumps > 1.0 - settings.single and turns > settings.turning)


def interpolated_rows(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> BoolArray:
    """Which rows (n,) of a record (n, 2) are interpolated between others, in either axis, more often than by chance.

    Of a record that was brought to another rate only some rows are on a line: where they come evenly, a few at a time,
    no row is taken for a sample.

    Examples
    --------
    >>> e = np.random.default_rng(1).standard_normal((1000, 2))
    >>> e[301:500, 0] = np.interp(np.arange(301, 500), [300, 500], e[[300, 500], 0])
    >>> int(interpolated_rows(e).sum()), int(interpolated_rows(e[500:]).sum())
    (199, 0)
    """
    interpolated = np.zeros(len(e), bool)
    if len(e) >= settings.fewest:
        for x in e.T:
            for order in (1, 3):
                interpolated |= _on_polynomial(x, order, settings)
    return interpolated


def _on_polynomial(x: FloatArray, order: int, settings: LiveRowSettings) -> BoolArray:
    """Rows (n,) on a polynomial through their neighbours, of this order and of no lower one."""
    quantum = float(quantum_of(np.diff(x[:PART])[:, None], settings)[0])
    beside = (order + 1) // 2

    def rounding(rows: FloatArray) -> FloatArray:
        """Largest difference of so many rows that is one of their rounding."""
        sizes = np.abs(rows)
        largest = np.maximum(np.maximum(sizes[: -2 * beside], sizes[beside:-beside]), sizes[2 * beside :])
        return np.asarray(2.0**order * (settings.digits * largest + 1.001 * quantum))

    def leaves(rows: FloatArray) -> BoolArray:
        allowed, rows = rounding(rows[:, 0]), rows[:, 0]
        lower = np.abs(np.diff(rows, n=order)[:-1])
        return np.asarray(~((np.abs(np.diff(rows, n=order + 1)) <= allowed) & (lower > allowed)))

    def bends(rows: FloatArray) -> BoolArray:
        allowed = settings.clear * rounding(rows[:, 0])
        return np.asarray(~(np.abs(np.diff(rows[:, 0], n=order + 1)) <= allowed))

    on, clear = ~marks(x[:, None], leaves, beside), marks(x[:, None], bends, beside)
    on[-beside:] = False
    starts, ends = np.flatnonzero(on[1:] & ~on[:-1]) + 1, np.flatnonzero(on[:-1] & ~on[1:]) + 1
    between = clear[starts - 1] & clear[ends]
    by_chance = np.count_nonzero(~on & ~clear) / (settings.clear - 1.0)
    if (ends - starts)[between].sum() <= settings.margin + settings.beside * by_chance:
        return np.zeros(len(x), bool)
    corners = np.diff(x[:PART], n=order + 1)[clear[beside : len(x[:PART]) - beside]]
    if of_quantisation(corners[:, None], settings) or period(x, float(np.nanstd(x))) < len(x):
        return np.zeros(len(x), bool)
    starts, ends = starts[between], ends[between]
    counts, _ = np.histogram(starts, max(len(starts) // settings.fewest, 1), (0, len(x)))
    even = len(counts) >= settings.stretches and counts.var() <= settings.even * counts.mean()
    if even and np.median(ends - starts) <= settings.short:
        return np.ones(len(x), bool)
    edges = np.zeros(len(x) + 1, np.int8)
    edges[starts] = 1
    edges[ends] = -1
    return np.asarray(np.cumsum(edges, dtype=np.int8)[:-1] > 0)


def coarse_quantum(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> float:
    """Largest quantum of the axes of a record (n, 2) that is larger than the rms of the motion; 0: none is.

    A motion that is larger than the quantum is told by many of its steps. What repeats itself is no rounded noise.

    Examples
    --------
    >>> noise = 4.0 * np.random.default_rng(1).standard_normal((1000, 2))
    >>> float(coarse_quantum(10.0 * np.round(noise / 10.0))), float(coarse_quantum(np.round(noise)))
    (10.0, 0.0)
    """
    coarse = 0.0
    if len(e) < settings.fewest:
        return coarse
    for axis, quantum in zip(e.T, quantum_of(np.diff(e[:PART], axis=0), settings)):
        scatter = float(np.nanstd(axis)) if quantum > coarse else math.inf
        if scatter < quantum and period(axis, scatter) >= len(axis):
            halves = 2.0 * axis[:PART][~np.isnan(axis[:PART])] / quantum  # rounded to a multiple, or to the middle
            coarse = float(quantum) if (np.abs(halves - np.rint(halves)) <= settings.multiple).all() else coarse
    return coarse
