"""Rows of a record that tell something of the motion: not held, not interpolated, not stuck, not saturated.

A record may have more rows than its sensor had samples, and rows in which the sensor saw nothing. Four signs are in
the values themselves:

- **held or interpolated**: each value is repeated, or the rows between two samples lie on a line or on a polynomial of
  third order, for a regular number of rows. The samples behind them have a longer period; the rows between say nothing
  of the motion between.
- **stuck**: a row that repeats the one before it. In a signal that is not quantised this does not happen by chance; in
  a quantised one it does, for a geometrically distributed number of rows, or between values one quantum apart. A motion
  without noise comes to rest: where it began, at zero without a jump, elsewhere without a jump of the velocity.
- **interpolated** at irregular places: rows on a line, or on a polynomial of third order, through their neighbours, to
  the digits of the file, between rows that are not. A motion with noise has none; one without has them everywhere, at
  the same phase of each period, or between corners of one size.
- **saturated**: more rows at one extreme value than a smooth distribution has there.

An axis that is constant in the whole record is a motion that does not change.

Rounding to a quantum that is larger than the motion leaves nothing of it, see :func:`coarse_quantum`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.indices.exceedances import period
from pointing_analysis.read.mapped_arrays import PART, by_parts, parts


@dataclass(frozen=True)
class LiveRowSettings(AlgorithmSettings):
    """Limits of what is a chance.

    Attributes
    ----------
    fewest : rows of a record, and runs of a regular length, below which nothing is said
    regular : share of the rows in runs of a regular length from which the record is a held or interpolated one
    spread : part of the regular length by which a run may miss a multiple of it
    single : share of steps of one quantum from which runs of equal values come from quantisation
    fine : part of the typical step below which the quantum is that of the number format
    chance : probability of a run of repeated rows, in the whole record, below which it is not one of chance
    beside : times the rows just below the extreme value that may be at it
    margin : rows more that may be there
    apart : distance of rows that are equal by chance, as the digits of a number make them
    band : part of the range that is just below the extreme value
    rounding : part of the largest norm by which norms miss it in rounding
    smooth : change of the typical step, a part of it, up to which a motion is one without noise
    straight : part of the rms of the steps by which a row may miss the line between its neighbours
    corners : share of the rows that are not straight, in runs of more than two, beyond which a motion is a curve
    cubic : part of the rms of the third differences by which a fourth one may miss zero within a polynomial
    left : times the rounding of the fourth differences that the third ones of a polynomial have at least
    turned : times the allowed bend of a line, or the typical step of a motion, from which a change is one
    format : largest part of the largest norm that is the rounding of a number format
    around : times the length of a run, to either side, in which a signal is as slow as in it
    turning : share of steps in the direction against the one before, from which a quantised signal is no slow motion
    multiple : part of a quantum by which the steps of a rounded record miss a multiple of it
    growing : times that a quantum is fitted to more of the steps
    same : part by which the rows for a sample may differ in the two axes
    decimated : rows that are taken together where rounding hides a polynomial between single ones
    coarse : part of a limit up to which the values may be rounded
    at_rows : share of interpolated samples that are a whole number of rows apart, if they are at rows
    long : rows of a sample from which a corner may be seen a row late
    certain : standard errors beyond which more values at the largest level are no chance
    short, even, stretches : most rows of a run, and variance of their number in equal stretches over its mean, in a
        record that was brought to another rate by lines or cubic splines (1 at random), and fewest stretches
    digits : largest rounding of a value to the digits of a file, a part of it: seven digits, or single precision
    clear : times the rounding beyond which a difference is one of the motion
    """

    fewest: int = 32
    regular: float = 0.9
    spread: float = 0.25
    single: float = 0.95
    fine: float = 1e-3
    chance: float = 1e-3
    beside: float = 3.0
    margin: int = 8
    apart: int = 7
    band: float = 0.01
    rounding: float = 1e-12
    smooth: float = 0.7
    straight: float = 1e-3
    corners: float = 0.1
    cubic: float = 0.05
    left: float = 4.0
    turned: float = 3.0
    format: float = 1e-3
    around: int = 4
    turning: float = 0.5
    multiple: float = 1e-3
    growing: int = 16
    same: float = 0.02
    decimated: int = 4
    coarse: float = 0.5
    at_rows: float = 0.95
    long: int = 8
    certain: float = 4.0
    short: int = 3
    even: float = 0.1
    stretches: int = 16
    digits: float = 5e-7
    clear: float = 10.0


SETTINGS = LiveRowSettings()
BEND, TURN = 2.001, 8.001
"""Largest rounding of second and fourth differences, in quanta of the values."""


@dataclass(frozen=True)
class Hold:
    """Regular repetition of samples in a record.

    Attributes
    ----------
    rows : of the record for each sample
    starts : (m,) row at which each run begins
    repeats : (m,) samples that a run stands for: two samples with equal values make one run
    held : whether the rows of a run have the value of its sample; otherwise they are interpolated
    """

    rows: float
    starts: IntArray
    repeats: IntArray
    held: bool = False

    @property
    def between_rows(self) -> bool:
        """Whether the samples are at no rows, so that the record does not have their values."""
        length = round(self.rows)
        places = np.bincount(self.starts[1:] % length, minlength=length)
        beside = 1 if length >= SETTINGS.long else 0  # a corner of a spline may be seen a row late
        near = sum(np.roll(places, k) for k in range(-beside, beside + 1))
        return not self.held and bool(np.max(near) < SETTINGS.at_rows * places.sum())


def hold_of(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> Hold | tuple[float, float] | None:
    """Regular repetition of samples in a record (n, 2); None where each row is a sample.

    Where the axes have different numbers of samples, the rows for each sample of either: no rows are those of both.

    Examples
    --------
    >>> white = np.random.default_rng(1).standard_normal((50, 2))
    >>> held = np.repeat(white, 20, axis=0)
    >>> hold_of(held).rows, hold_of(white)
    (20.0, None)
    >>> time, rows = np.arange(50.0), np.linspace(0.0, 49.0, 981)
    >>> hold_of(np.column_stack([np.interp(rows, time, axis) for axis in white.T])).rows
    20.0
    >>> hold_of(np.column_stack([held[:, 0], np.random.default_rng(2).standard_normal(1000)]))
    (20.0, 1.0)
    """
    # Both axes together as well: where one of them changes too little, the other one shows when a sample came.
    both, x, y = (_hold_of(part, settings) for part in (e, e[:, :1], e[:, 1:2]))
    slowest = max((hold for hold in (both, x, y) if hold is not None), key=lambda hold: hold.rows, default=None)
    if slowest is None or (e == e[:1]).all(axis=0).any():  # an axis that is constant has no rate
        return slowest
    same = (1.0 - settings.same) * slowest.rows
    if (both is not None and both.rows >= same) or (x is not None and y is not None and min(x.rows, y.rows) >= same):
        return slowest
    return x.rows if x is not None else 1.0, y.rows if y is not None else 1.0


def _hold_of(e: FloatArray, settings: LiveRowSettings) -> Hold | None:
    if len(e) < settings.fewest:
        return None
    if e.shape[1] == 1 and np.isnan(e[:PART, 0]).any() and (hold := _regular(~np.isnan(e[:, 0]), settings)):
        return replace(hold, held=True)  # rows between the samples are empty
    changed = _without_holes(_marks(e, _moves), e)
    begins = np.flatnonzero(changed[:PART])[1:]
    if not changed[1:].any():
        return None
    if _of_quantisation(e[begins] - e[begins - 1], settings):
        return None
    if hold := _regular(changed, settings):
        return replace(hold, held=True)
    # A corner of a piecewise linear motion is where the step changes. Neighbours of missing rows count as corners.
    steps = np.diff(e[:PART], axis=0)
    if not np.isfinite(steps).any(axis=0).all() or not np.nansum(np.abs(steps)):
        return None
    quantum = _quantum(steps, settings)
    straight = settings.straight * np.sqrt(np.nanmean(steps**2, axis=0))
    allowed = np.maximum(straight, BEND * quantum)
    corner = _marks(e, lambda rows: ~(np.abs(rows[2:] - 2.0 * rows[1:-1] + rows[:-2]) <= allowed).all(axis=1))
    # A corner between two rows, and a step between two straight lines, mark both of them.
    second = np.append(False, corner[1:] & corner[:-1])
    further = second[1:] & second[:-1]
    jumps = np.flatnonzero(second[:PART])
    jumps = jumps[jumps > 1]
    jumped = e[jumps] - 2.0 * e[jumps - 1] + e[jumps - 2]
    saw = len(jumps) > settings.margin and _of_quantisation(jumped, settings, quantum)  # always the same: a motion
    turns = np.flatnonzero((corner & ~second)[1 : PART - 1]) + 1
    turns = turns[(turns > 1) & (turns < len(e) - 2)]
    turned = e[turns + 2] - e[turns + 1] - e[turns - 1] + e[turns - 2]  # of the slope
    turned[np.abs(turned) <= settings.turned * straight] = 0.0
    saw |= bool(np.any(turned)) and _of_quantisation(turned, settings, quantum)  # a triangle
    if not saw and further.sum() <= settings.corners * corner.sum():
        return _regular(corner & ~second, settings)
    for stride in (1, settings.decimated) if quantum.any() else (1,):
        if hold := _cubic_pieces(e[::stride], quantum, settings):
            return Hold(hold.rows * stride, hold.starts * stride, hold.repeats)
    return None


def _without_holes(changed: BoolArray, e: FloatArray) -> BoolArray:
    """Rows (n,) that begin a run, where rows that are missing within a run of equal values begin none.

    Those between two runs of several rows end the first one.
    """
    missing: BoolArray = np.any(np.isnan(e), axis=1)
    if not missing.any():
        return changed
    starts, ends = np.flatnonzero(missing[1:] & ~missing[:-1]) + 1, np.flatnonzero(missing[:-1] & ~missing[1:]) + 1
    ends = ends[int(missing[0]) :]  # a gap at the start or at the end has no other side
    starts = starts[: len(ends)]
    inner = (starts > 1) & (ends < len(e) - 1)
    starts, ends = starts[inner], ends[inner]
    same = np.all(e[starts - 1] == e[ends], axis=1)
    held = same | np.all(e[starts - 2] == e[starts - 1], axis=1) | np.all(e[ends] == e[ends + 1], axis=1)
    changed[starts[held]] = False
    changed[ends[same]] = False
    return changed


def _quantum(steps: FloatArray, settings: LiveRowSettings) -> FloatArray:
    """Quantum (2,) of which all steps (n, 2) between rows are multiples; zero in an axis that is not rounded."""
    quanta = np.zeros(steps.shape[1])
    for k, column in enumerate(np.abs(steps).T):
        sizes = np.sort(column[column > 0.0])
        if not sizes.size:
            continue
        # Greatest common divisor of the smallest ones by Euclid's algorithm: of many decimals no step needs to have
        # the last one alone. Then its value by larger and larger multiples.
        quantum, least, few = float(sizes[0]), settings.rounding * float(sizes[-1]), sizes[: settings.fewest]
        others = few
        while others.size and quantum > least:
            left = np.abs(few - quantum * np.rint(few / quantum))
            others = left[left > settings.multiple * quantum]
            quantum = float(others.min(initial=quantum))
        if quantum <= least:
            continue
        for most in np.geomspace(few[-1], sizes[-1], settings.growing):
            some = sizes[: np.searchsorted(sizes, (1.0 + settings.multiple) * most)]
            counts = np.rint(some / quantum)
            quantum = float(counts @ some / (counts @ counts))
        places = sizes / quantum
        if (np.abs(places - np.rint(places)) <= settings.multiple).all():
            quanta[k] = quantum
    return quanta


def _cubic_pieces(e: FloatArray, quantum: FloatArray, settings: LiveRowSettings) -> Hold | None:
    """Samples between which a record (n, 2) follows a polynomial of third order, as splines do.

    Its fourth differences vanish but for the three or four about each sample, its third ones do not: a body under a
    force that is held moves along parabolas. What is left of the fourth ones is rounding, which the fifth ones have
    more of: those of a smooth motion between the frames of a camera become smaller with each order.
    """
    third, fourth, fifth = (np.diff(e[:PART], n=order, axis=0) for order in (3, 4, 5))
    if len(fifth) < settings.fewest or not np.isfinite(fifth).any(axis=0).all():
        return None
    typical = np.sqrt(np.nanmean(third**2, axis=0))
    allowed = np.maximum(settings.cubic * typical, TURN * quantum)
    usual = [np.nanmedian(np.abs(one), axis=0) for one in (third, fourth, fifth)]
    least = np.maximum(settings.straight * typical, settings.left * usual[1])
    if not (usual[0] > least).any() or (usual[2] < usual[1]).any():
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        jumps = np.nanmax(np.abs(fourth) / allowed, axis=1, initial=0.0)
    if not (jumps > 1.0).any() or np.median(jumps[jumps > 1.0]) < settings.turned:
        return None  # a smooth motion whose differences rounding hides

    def bends(rows: FloatArray) -> BoolArray:
        change = rows[4:] - 4.0 * rows[3:-1] + 6.0 * rows[2:-2] - 4.0 * rows[1:-3] + rows[:-4]
        return np.asarray(~(np.abs(change) <= allowed).all(axis=1))

    knot = _marks(e, bends, 2)
    first = knot & ~np.append(False, knot[:-1])
    if not allowed.any() or knot.sum() > 4 * first.sum():  # a sample between two rows marks four
        return None
    return _regular(np.append(False, first[:-1]), settings)


def _marks(e: FloatArray, function: Callable[[FloatArray], BoolArray], beside: int = 1) -> BoolArray:
    """Rows (n,) that a function of them with so many rows before and behind marks; the first ones are marked."""
    marks = np.ones(len(e), bool)
    for part in parts(len(e) - beside):
        rows = e[part.start : part.stop + 2 * beside]
        short = part.stop + 2 * beside - len(e)
        rows = np.concatenate([rows, *[rows[-1:]] * short]) if short > 0 else rows
        marks[part.start + beside : part.stop + beside] = function(rows)
    return marks


def _moves(rows: FloatArray) -> BoolArray:
    """Whether a row differs from the one before; one that is missing differs from one that is not."""
    before, row = rows[:-2], rows[1:-1]
    both_missing = np.isnan(row).any(axis=1) & np.isnan(before).any(axis=1)
    return np.asarray(~(row == before).all(axis=1) & ~both_missing)


def _of_quantisation(steps: FloatArray, settings: LiveRowSettings, rounded: FloatArray | float = 0.0) -> bool:
    """Whether the steps (m, 2) between runs of equal rows are of one quantum, which also a smooth motion has.

    Those of values that are `rounded` differ by four times that quantum at most.
    """
    for column, quantum in zip(np.abs(steps).T, np.broadcast_to(rounded, steps.shape[1])):
        moving = column[column > 0.0]
        if moving.size and np.mean(moving <= 1.001 * moving.min() + 4.001 * quantum) < settings.single:
            return False
    return True


def _regular(begins: BoolArray, settings: LiveRowSettings) -> Hold | None:
    """Runs between rows that begin one, where nearly all of them have a multiple of one length of two rows or more."""
    if 3 * int(begins.sum()) > 2 * len(begins) + 2 * settings.fewest:
        return None  # more than half of the runs have one row
    starts = np.flatnonzero(begins)
    lengths = np.diff(np.append(starts, len(begins)))
    inner = lengths[1:-1]
    if len(inner) < settings.fewest // 2:
        return None
    length = float(np.median(inner))
    repeats = np.maximum(np.ceil(inner / length - 0.5), 1.0)
    fits = np.abs(inner - repeats * length) <= settings.spread * length
    fits |= inner == np.floor(length) + 1.0  # of a length that is no whole number
    if length < 2.0 or inner[fits].sum() < settings.regular * inner.sum():
        return None
    rows = float(inner[fits].sum() / repeats[fits].sum())
    return Hold(rows, starts, np.maximum(np.ceil(lengths / rows - 0.5), 1.0).astype(np.int64))


def samples_behind(e: FloatArray, hold: Hold) -> FloatArray:
    """Samples (m, 2) of which a record is made, those of a run at its regular places."""
    first = np.cumsum(hold.repeats) - hold.repeats
    place = np.arange(int(hold.repeats.sum())) - np.repeat(first, hold.repeats)
    rows = np.repeat(hold.starts, hold.repeats) + np.rint(place * hold.rows).astype(np.int64)
    return np.asarray(e[np.minimum(rows, len(e) - 1)])


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
        repeated = _marks(x[:, None], lambda rows: rows[1:-1, 0] == rows[:-2, 0])
        repeated[0] = False
        if repeated.any():
            stuck |= repeated & ~_explained_repeats(x, repeated, settings)
    return stuck


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
    quantised = quantum >= settings.fine * typical and bool(_quantum(np.diff(x[:PART])[:, None], settings)[0])
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
    allowed = settings.turned * np.where(x[starts] == 0.0, typical, change)
    begun = (x[starts] == x[0]) & (lengths[0] > settings.margin)  # a motion that begins at rest comes back to it
    rests = (change <= settings.smooth * typical) & (begun | ~(into > allowed))
    return np.asarray(np.repeat((lengths - 1 <= longest) | (edges <= still) | rests, lengths))


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
    quantum = float(_quantum(np.diff(x[:PART])[:, None], settings)[0])
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

    on, clear = ~_marks(x[:, None], leaves, beside), _marks(x[:, None], bends, beside)
    on[-beside:] = False
    starts, ends = np.flatnonzero(on[1:] & ~on[:-1]) + 1, np.flatnonzero(on[:-1] & ~on[1:]) + 1
    between = clear[starts - 1] & clear[ends]
    by_chance = np.count_nonzero(~on & ~clear) / (settings.clear - 1.0)
    if (ends - starts)[between].sum() <= settings.margin + settings.beside * by_chance:
        return np.zeros(len(x), bool)
    corners = np.diff(x[:PART], n=order + 1)[clear[beside : len(x[:PART]) - beside]]
    if _of_quantisation(corners[:, None], settings) or period(x, float(np.nanstd(x))) < len(x):
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
    for axis, quantum in zip(e.T, _quantum(np.diff(e[:PART], axis=0), settings)):
        scatter = float(np.nanstd(axis)) if quantum > coarse else math.inf
        if scatter < quantum and period(axis, scatter) >= len(axis):
            halves = 2.0 * axis[:PART][~np.isnan(axis[:PART])] / quantum  # rounded to a multiple, or to the middle
            coarse = float(quantum) if (np.abs(halves - np.rint(halves)) <= settings.multiple).all() else coarse
    return coarse


def saturated_rows(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> BoolArray:
    """Which rows (n,) of a record (n, 2) are at an extreme value that holds more of them than chance explains.

    The extremes are those of each axis, and the largest norm.

    Examples
    --------
    >>> e = np.random.default_rng(1).standard_normal((10_000, 2))
    >>> [int(saturated_rows(x).sum()) for x in (e, np.round(e, 1), np.clip(e, -2.0, 2.0))]
    [0, 0, 865]
    """
    saturated = np.zeros(len(e), bool)
    if len(e) < settings.fewest:
        return saturated
    norm = by_parts(lambda rows: np.hypot(rows[:, 0], rows[:, 1]), e)
    steps = np.abs(np.diff(e[:PART], axis=0))
    quantum = float(np.min(steps, where=steps > 0.0, initial=math.inf))  # of the number format, where it is small
    saturated |= _at_top(norm, settings, quantum)
    for axis in e.T:
        saturated |= _at_top(axis, settings) | _at_top(by_parts(np.negative, axis), settings)
    return saturated


def _at_top(values: FloatArray, settings: LiveRowSettings, quantum: float = 0.0) -> BoolArray:
    """Which of the values (n,) are the largest one, where these are more than chance explains; else none.

    Values that are computed of numbers with a quantum miss it by rounding.
    """
    none = np.zeros(len(values), bool)
    top = max(float(np.nanmax(values[part], initial=-math.inf)) for part in parts(len(values)))
    of_format = 2.0 * quantum if 2.0 * quantum <= settings.format * top else 0.0
    missed = max(settings.rounding * top, of_format) if quantum else 0.0
    at_top = by_parts(lambda rows: rows >= top - missed, values, dtype=bool)
    count = int(at_top.sum())
    if top == 0.0 or count <= settings.margin:
        return none
    below = values[~at_top & np.isfinite(values)]
    next_level = float(below.max(initial=-math.inf))
    if below.min(initial=math.inf) >= np.max(below, where=below < next_level, initial=-math.inf):
        return none  # of fewer than four values no distribution is seen
    band = max(top - next_level, settings.band * (top - float(below.min())))
    near = below[below >= top - 1.0001 * band]
    # Where no value just below it comes twice, and it comes again and again, the signal is not quantised, nor settled
    comes = int(np.count_nonzero(np.diff(np.flatnonzero(at_top)) > 1)) + 1
    alone = comes > settings.margin and len(np.unique(near)) == len(near)
    beside = 1.0 if alone else settings.beside
    if count <= beside * len(near) + settings.margin and not _piled_up(values, top, next_level, settings):
        return none
    once = period(values, float(np.nanstd(values)))
    repeats_itself = once < len(values) and int(at_top[:once].sum()) <= settings.margin
    return none if repeats_itself else np.asarray(at_top)


def _piled_up(values: FloatArray, top: float, next_level: float, settings: LiveRowSettings) -> bool:
    """Whether the largest level of a quantised signal (n,) has more of its values than the levels below lead to.

    Towards the end of a distribution the numbers fall from level to level by a factor that does not grow: that from the
    next level to the largest one is compared with that before it. Where the numbers rise towards the end, as those of a
    sinusoid do, nothing is said. What the blocks of the record differ by is the uncertainty of both.
    """
    quantum = top - next_level
    levels = top - quantum * np.arange(3.0)
    counts = np.array(
        [
            [np.count_nonzero(np.abs(block - level) <= settings.multiple * quantum) for level in levels]
            for block in np.array_split(values, settings.stretches)
        ]
    )
    total = counts.sum(axis=0)
    if total[1:].min() <= settings.margin or total.sum() < np.count_nonzero(values >= levels[-1] - 0.5 * quantum):
        return False  # levels that are not equally spaced
    without = np.log(np.maximum(total - counts, 1))  # of each block, and of none
    rise = np.vstack([np.log(total), without]) @ np.array([[0.0, 1.0], [-1.0, -2.0], [1.0, 1.0]])
    blocks = len(counts)
    error = np.sqrt((blocks - 1) / blocks * np.sum((rise[1:] - rise[1:].mean(axis=0)) ** 2, axis=0))
    return bool((rise[0] > settings.certain * error).all())
