"""Sampling grid of times with rounding and jitter: period, place of each sample, and what the times miss it by.

The period is that of a straight line through times over places (least squares), not the median interval: of times with
six decimals at 512 Hz the median is 1953 us, which is one sample off after 16 s. The line is found on the first times,
then on twice as many, so that each place is known to a part of a period before it is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pointing_analysis.arrays import FloatArray, IntArray

NANO = 1_000_000_000
OFF_GRID = 0.02
"""Part of the period by which a stamp may miss the sampling grid."""
ROUNDS, FIRST = 3, 256
DECIMALS = 9


@dataclass(frozen=True)
class TimeGrid:
    """Uniform times of samples.

    Attributes
    ----------
    period : [s]
    place : (n,) of each sample on the grid, the first one of the array at 0; negative before it
    jitter : rms of the times about the grid [s]
    largest : largest distance of a time from the grid [s]
    resolution : decimal step that all times are rounded to [s]; 0 where there is none above 1 ns
    """

    period: float
    place: IntArray
    jitter: float
    largest: float
    resolution: float

    @property
    def fits(self) -> bool:
        """Whether the times are those of the grid but for rounding and 2 % of the period."""
        rounding = 0.5 * self.resolution if self.resolution <= 0.5 * self.period else 0.0
        return self.largest <= OFF_GRID * self.period + rounding

    def __str__(self) -> str:
        rate = f"{1 / self.period:.9g} Hz from the times"
        if self.largest < 1e-9:
            return rate
        return f"{rate}, jitter {1e6 * self.jitter:.2g} us rms, at most {1e6 * self.largest:.2g} us"


def time_grid(times: FloatArray) -> TimeGrid | None:
    """Grid of times, or None where there is none.

    Parameters
    ----------
    times : (n,) [s], in any order, with gaps

    Examples
    --------
    >>> t = np.round(np.delete(np.arange(30720), np.arange(3000, 3103)) / 512, 6)
    >>> grid = time_grid(t)
    >>> print(grid)
    512 Hz from the times, jitter 0.29 us rms, at most 0.5 us
    >>> int(grid.place[-1]) + 1 - t.size
    103
    """
    if times.size < 2:
        return None
    order = np.argsort(times, kind="stable")
    grid = _grid_of_sorted(times[order] - times[order[0]])
    if grid is None:
        return None
    place = np.empty_like(grid.place)
    place[order] = grid.place
    return replace(grid, place=place - place[0])


def _grid_of_sorted(since: FloatArray) -> TimeGrid | None:
    """Grid of ascending times [s] from the first one: its line is followed from one end to the other."""
    steps = np.diff(since)
    middle = float(np.median(steps))
    usual = steps[(steps > 0.5 * middle) & (steps < 1.5 * middle)]
    if middle <= 0 or not usual.size:
        return None
    place, period = _line(since, float(usual.mean()))
    if not (period > 0 and np.ptp(place)):
        return None
    period = _round_rate(period, place, since)
    rest = since - place * period
    rest -= 0.5 * (rest.max() + rest.min())
    jitter, largest = float(np.sqrt(np.mean(np.square(rest)))), float(np.abs(rest).max())
    return TimeGrid(period, place.astype(np.int64), jitter, largest, _resolution(since))


def _line(since: FloatArray, period: float) -> tuple[FloatArray, float]:
    """Place of each time, and the period of the line through them, found on more and more of the times."""
    offset, m = 0.0, min(FIRST, since.size)
    while True:
        part = since[:m]
        for _ in range(ROUNDS):
            place = np.rint((part - offset) / period)
            if not np.ptp(place):
                break
            centred = place - place.mean()
            period = float(centred @ (part - part.mean()) / (centred @ centred))
            offset = float(np.mean(part - place * period))
        if m == since.size or not period > 0:
            return place - place[0], period
        m = min(2 * m, since.size)


def _round_rate(period: float, place: FloatArray, since: FloatArray) -> float:
    """The period, or that of the next whole rate [Hz] where the times cannot tell it from the one that was found."""
    rest = since - place * period
    spread = max(float(np.ptp(rest)), 1e-9)
    for whole in (1.0, 1e-3):
        rate = round(1 / period / whole) * whole
        if rate > 0 and abs(1 / rate - period) * float(np.ptp(place)) <= 0.5 * spread:
            return 1 / rate
    return period


def _resolution(since: FloatArray) -> float:
    for decimals in range(DECIMALS):
        scaled = since * 10.0**decimals
        if np.all(np.abs(scaled - np.rint(scaled)) <= 1e-3):
            return float(10.0**-decimals)
    return 0.0


def regular(stamps: IntArray) -> tuple[IntArray, TimeGrid | None]:
    """Stamps on the grid that they have but for rounding and jitter, and that grid; as they are where they have none.

    Parameters
    ----------
    stamps : (n,) [ns]
    """
    real = np.flatnonzero(stamps)  # the stamp 0 means "not stamped"
    first = int(stamps[real[0]]) if real.size else 0
    grid = time_grid((stamps[real] - first) / NANO) if real.size else None
    if grid is None or not grid.fits:
        return stamps, grid
    placed = np.zeros_like(stamps)
    placed[real] = first + on_whole_ns(grid.place, grid.period)
    return placed, grid


def on_whole_ns(place: IntArray, period: float) -> IntArray:
    """Times [ns] of places on a grid, each rounded by itself: a period of 39 062.5 ns does not add up its half.

    Examples
    --------
    >>> on_whole_ns(np.array([1, 2, 3, 25_600]), 1 / 25_600)
    array([     39062,      78125,     117188, 1000000000])
    """
    return np.asarray(np.rint(place * whole_period(period)).astype(np.int64))


def whole_period(period: float) -> float:
    """A period [s] in ns: the whole number that it is but for rounding, else with its fraction."""
    ns = NANO * period
    return float(round(ns)) if abs(ns - round(ns)) <= 1e-3 else ns
