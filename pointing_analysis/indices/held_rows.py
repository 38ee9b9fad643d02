"""Samples of a record that has more rows than its sensor had samples: held, or interpolated at regular places."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.indices.row_signs import SETTINGS, LiveRowSettings, marks, of_quantisation, quantum_of
from pointing_analysis.read.mapped_arrays import PART

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
    changed = _without_holes(marks(e, _moves), e)
    begins = np.flatnonzero(changed[:PART])[1:]
    if not changed[1:].any():
        return None
    if of_quantisation(e[begins] - e[begins - 1], settings):
        return None
    if hold := _regular(changed, settings):
        return replace(hold, held=True)
    # A corner of a piecewise linear motion is where the step changes. Neighbours of missing rows count as corners.
    steps = np.diff(e[:PART], axis=0)
    if not np.isfinite(steps).any(axis=0).all() or not np.nansum(np.abs(steps)):
        return None
    quantum = quantum_of(steps, settings)
    straight = settings.straight * np.sqrt(np.nanmean(steps**2, axis=0))
    allowed = np.maximum(straight, BEND * quantum)
    corner = marks(e, lambda rows: ~(np.abs(rows[2:] - 2.0 * rows[1:-1] + rows[:-2]) <= allowed).all(axis=1))
    # A corner between two rows, and a step between two straight lines, mark both of them.
    second = np.append(False, corner[1:] & corner[:-1])
    further = second[1:] & second[:-1]
    jumps = np.flatnonzero(second[:PART])
    jumps = jumps[jumps > 1]
    jumped = e[jumps] - 2.0 * e[jumps - 1] + e[jumps - 2]
    saw = len(jumps) > settings.margin and of_quantisation(jumped, settings, quantum)  # always the same: a motion
    turns = np.flatnonzero((corner & ~second)[1 : PART - 1]) + 1
    turns = turns[(turns > 1) & (turns < len(e) - 2)]
    turned = e[turns + 2] - e[turns + 1] - e[turns - 1] + e[turns - 2]  # of the slope
    turned[np.abs(turned) <= settings.turned * straight] = 0.0
    saw |= bool(np.any(turned)) and of_quantisation(turned, settings, quantum)  # a triangle
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

    knot = marks(e, bends, 2)
    first = knot & ~np.append(False, knot[:-1])
    if not allowed.any() or knot.sum() > 4 * first.sum():  # a sample between two rows marks four
        return None
    return _regular(np.append(False, first[:-1]), settings)


def _moves(rows: FloatArray) -> BoolArray:
    """Whether a row differs from the one before; one that is missing differs from one that is not."""
    before, row = rows[:-2], rows[1:-1]
    both_missing = np.isnan(row).any(axis=1) & np.isnan(before).any(axis=1)
    return np.asarray(~(row == before).all(axis=1) & ~both_missing)


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
