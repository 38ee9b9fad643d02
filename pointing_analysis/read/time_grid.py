"""Sampling grid of times with rounding and jitter: period, place of each sample, and what the times miss it by.

The period is that of a straight line through times over places (least squares), not the median interval: of times with
six decimals at 512 Hz the median is 1953 us, which is one sample off after 16 s. Where each interval is nearly a whole
number of the periods about it, these numbers add up to the places, also of a clock that drifts. Else the line is found
on the first times, then on twice as many, so that each place is known to a part of a period before it is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import FloatArray, IntArray

NANO = 1_000_000_000
OFF_GRID = 0.02
"""Part of the period by which a stamp may miss the sampling grid."""
ROUNDS, FIRST = 3, 256
DECIMALS = 9


@dataclass(frozen=True)
class TimeGridSettings(AlgorithmSettings):
    """How a clock that is not quite regular is followed.

    Attributes
    ----------
    local : intervals whose mean is the period about a sample
    told : part of the period by which an interval may miss a whole number of periods, if it tells how many they are
    lost : part of the period by which times miss the line where it is none: the period is the mean interval
    drift : largest change of the rate, a part of it, that is one of a clock
    """

    local: int = 257
    told: float = 0.25
    lost: float = 0.45
    drift: float = 1e-3


SETTINGS = TimeGridSettings()


@dataclass(frozen=True)
class TimeGrid:
    """Uniform times of samples.

    Attributes
    ----------
    period : [s]
    place : (n,) of each sample on the grid, the first one of the array at 0; negative before it
    jitter : rms of the times about the grid, which follows a clock whose rate changes slowly [s]
    largest : largest distance of a time from the grid [s]
    resolution : decimal step that all times are rounded to [s]; 0 where there is none above 1 ns
    drift : change of the rate over the record, a part of it
    """

    period: float
    place: IntArray
    jitter: float
    largest: float
    resolution: float
    drift: float = 0.0

    @property
    def changes(self) -> bool:
        """Whether the rate changes by more than that of a clock."""
        return self.drift > SETTINGS.drift

    @property
    def fits(self) -> bool:
        """Whether the times are those of the grid but for rounding, 2 % of the period and the drift of a clock."""
        rounding = 0.5 * self.resolution if self.resolution <= 0.5 * self.period else 0.0
        return self.largest <= OFF_GRID * self.period + rounding and not self.changes

    def __str__(self) -> str:
        rate = f"{1 / self.period:.9g} Hz from the times"
        if self.drift:
            rate += f", which changes by {1e6 * self.drift:.2g} ppm"
        if self.largest <= max(0.51 * self.resolution, 2.0 / NANO):
            return f"{rate}, rounded to {1e6 * self.resolution:g} us" if self.largest > 2.0 / NANO else rate
        return f"{rate}, jitter {1e6 * self.jitter:.2g} us rms, at most {1e6 * self.largest:.2g} us"


def time_grid(times: FloatArray, settings: TimeGridSettings = SETTINGS) -> TimeGrid | None:
    """Grid of times, or None where there is none.

    Parameters
    ----------
    times : (n,) [s], in any order, with gaps

    Examples
    --------
    >>> t = np.round(np.delete(np.arange(30720), np.arange(3000, 3103)) / 512, 6)
    >>> grid = time_grid(t)
    >>> print(grid)
    512 Hz from the times, rounded to 1 us
    >>> int(grid.place[-1]) + 1 - t.size
    103
    """
    from scipy.ndimage import uniform_filter1d  # slow to import, and no part of a run

    if times.size < 2:
        return None
    order = np.argsort(times, kind="stable")
    since = times[order] - times[order[0]]
    steps = np.diff(since)
    middle = float(np.median(steps))
    usual = (steps > 0.49 * middle) & (steps < 1.51 * middle)  # also of times rounded to half of the period
    if middle <= 0 or not usual.any():
        return None
    width, mean = min(settings.local, steps.size), float(steps[usual].mean())
    counts = uniform_filter1d(usual.astype(float), width, mode="nearest")
    sums = uniform_filter1d(np.where(usual, steps, 0.0), width, mode="nearest")
    local = np.where(counts > 0.5 / width, sums / np.maximum(counts, 0.5 / width), mean)
    places = np.rint(steps / local)
    told = (np.abs(steps / local - places)[usual] <= settings.told).all() and bool((places >= 1.0).all())
    # By intervals where each tells its places, else along a line
    place = np.append(0.0, np.cumsum(places)) if told else _line(since, mean)
    if not np.ptp(place):
        return None
    centred = place - place.mean()
    period = float(centred @ (since - since.mean()) / (centred @ centred))
    if not period > 0:
        return None
    rest = since - place * period
    rest -= rest.mean()
    inner, drift = slice(width // 2, -(width // 2)), 0.0
    if told and len(since) > 4 * width:
        rest = (rest - uniform_filter1d(rest, width, mode="nearest"))[inner]
        rest -= rest.mean()  # a mean of times whose rate changes is not in their middle
        drift = float(np.ptp(local[inner])) / period
    jitter, largest = float(np.sqrt(np.mean(np.square(rest)))), float(np.abs(rest).max())
    resolution = _resolution(since)
    # Largest difference of the means of so many intervals due to jitter, and to rounding
    noise = max(16.0 * jitter, 2.0 * max(resolution, 1.0 / NANO)) / (width * period)
    drift = float(np.sqrt(drift**2 - noise**2)) if drift > 1.01 * noise else 0.0
    if not told and largest > settings.lost * period:
        period = mean
    elif drift == 0.0:
        period = _round_rate(period, float(np.ptp(place)), max(2.0 * largest, 1e-9))
    whole = place.astype(np.int64)
    unsorted = np.empty_like(whole)
    unsorted[order] = whole
    return TimeGrid(period, unsorted - unsorted[0], jitter, largest, resolution, drift)


def _line(since: FloatArray, period: float) -> FloatArray:
    """Place of each time on the line through them, which is found on more and more of the times."""
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
            return np.asarray(place - place[0])
        m = min(2 * m, since.size)


def _round_rate(period: float, length: float, spread: float) -> float:
    """The period, or that of the next whole rate [Hz] where times with a spread cannot tell it from the one found."""
    for whole in (1.0, 1e-3):
        rate = round(1 / period / whole) * whole
        if rate > 0 and abs(1 / rate - period) * length <= 0.5 * spread:
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
