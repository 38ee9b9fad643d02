"""Rows of a record in which the sensor was saturated: at an extreme value that holds more of them than chance."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.indices.exceedances import period
from pointing_analysis.indices.row_signs import SETTINGS, LiveRowSettings, typical_step
from pointing_analysis.read.mapped_arrays import PART, by_parts, parts


def saturated_rows(e: FloatArray, settings: LiveRowSettings = SETTINGS) -> BoolArray:
    """Which rows (n,) of a record (n, 2) are at an extreme value that holds more of them than chance explains.

    The extremes are those of each axis, the largest norm, and those along the normals of the edges of all values in the
    plane: of a sensor whose axes are not those of the line of sight.

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
    largest = max(float(np.nanmax(norm[part], initial=-math.inf)) for part in parts(len(norm)))
    exact = settings.rounding * largest
    of_norm, of_edge = 2.0 * quantum, settings.tilted * quantum  # by which rounding changes them
    saturated |= _at_top(norm, settings, max(exact, of_norm if of_norm <= settings.format * largest else 0.0))
    for axis in e.T:
        saturated |= _at_top(axis, settings) | _at_top(by_parts(np.negative, axis), settings)
    for normal in _normals(e, max(exact, 0.5 * of_edge), settings) if of_edge <= settings.edge * largest else ():
        along, missed = by_parts(lambda rows, normal=normal: rows @ normal, e), max(exact, of_edge)
        at_edge, least = _at_top(along, settings, missed), settings.clear * missed
        # A motion without noise glides to an edge, or rests at a corner of it
        places = e[at_edge] @ np.array([-normal[1], normal[0]])
        if (
            len(places)
            and np.std(places) > least
            and _jump(along, at_edge) > max(least, settings.rest * typical_step(along))
        ):
            saturated |= at_edge
    return saturated


def _jump(values: FloatArray, at_top: BoolArray) -> float:
    """Typical step by which values (n,) come to the top; 0 where they never do."""
    into = np.abs(np.diff(values))[at_top[1:] & ~at_top[:-1]]
    return float(np.nanmedian(into)) if np.isfinite(into).any() else 0.0


def _normals(e: FloatArray, rounding: float, settings: LiveRowSettings) -> FloatArray:
    """Outer normals (k, 2) of the long edges with many rows of the convex hull of a record (n, 2).

    Those along its axes are left out, edges that differ by the rounding of the values are one. There are none of values
    in a line.
    """
    hull: FloatArray = np.empty((0, 2))
    for part in parts(len(e)):
        hull = np.vstack([hull, e[part][np.isfinite(e[part]).all(axis=1)]])
        try:
            hull = hull[ConvexHull(hull).vertices] if len(hull) > 2 else hull  # counter-clockwise
        except QhullError:  # in a line
            hull = np.unique(hull, axis=0)[[0, -1]]
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    normals = []
    for whole in edges[lengths > settings.band * lengths.sum()] if len(hull) > 2 else ():
        for _ in range(settings.straightened):  # rounding breaks an edge into several: from one of them to all
            along = whole / np.hypot(*whole)
            outwards = hull @ np.array([along[1], -along[0]])
            on_edge = hull[outwards >= outwards.max() - rounding]
            whole = on_edge[np.argmax(on_edge @ along)] - on_edge[np.argmin(on_edge @ along)]
        normals.append(np.array([whole[1], -whole[0]]) / np.hypot(*whole))
    known: FloatArray = np.unique(np.round(np.reshape(normals, (-1, 2)), 12), axis=0)
    known = known[np.abs(known).min(axis=1) > settings.rounding]
    # Most edges have their two corners alone, as some of the rows show
    stride = max(len(e) // (settings.stretches * settings.sampled), 1)
    tops = np.max(hull @ known.T, axis=0, initial=-math.inf)
    on_edges = np.count_nonzero(e[::stride] @ known.T >= tops - 2.0 * rounding, axis=0)
    return np.asarray(known[on_edges * stride > settings.margin])


def _at_top(values: FloatArray, settings: LiveRowSettings, missed: float = 0.0) -> BoolArray:
    """Which of the values (n,) are the largest one, where these are more than chance explains; else none.

    Values that are computed of others may have missed it by their rounding.
    """
    none = np.zeros(len(values), bool)
    top = max(float(np.nanmax(values[part], initial=-math.inf)) for part in parts(len(values)))
    at_top = by_parts(lambda rows: rows >= top - missed, values, dtype=bool)
    count = int(at_top.sum())
    if top == 0.0 or count <= settings.margin:
        return none
    below = values[~at_top & np.isfinite(values)]
    next_level = float(below.max(initial=-math.inf))
    if below.min(initial=math.inf) >= np.max(below, where=below < next_level, initial=-math.inf):
        return none  # of fewer than four values no distribution is seen
    extent = top - float(below.min())
    if extent < settings.clear * missed:
        return none  # all values are in a line
    # A smooth motion that touches an extreme has 1.2 times as many values within the next four times the distance
    band = max(top - next_level, settings.band * extent, settings.touching * missed)
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
