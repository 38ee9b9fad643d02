"""Harmonics in the spectra of a wheel at several speeds: peaks whose frequency is in one ratio to the speed.

Peaks of all speeds are gathered by their order (frequency over speed), and an order that is in enough of the spectra is
a harmonic: Masterson, Miller and Grogan, Journal of Sound and Vibration 249(3), 2002.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from lftkit.arrays import BoolArray, FloatArray

ABOVE, ABOVE_FEW = 3.0, 5.0
"""A peak is so many times as high as the median around it; of fewer than `MANY` spectra, chance peaks may coincide."""
MANY = 4
AROUND = 15
"""Bins on each side of a peak that the median is of."""
SAME = 1.5
"""Bins of frequency by which peaks of one harmonic, or of one mode, differ from it at most."""
SHARE = 1.0 / 3.0
"""Part of the spectra that have a harmonic which is in their range."""
CHANCE = 0.01
"""Largest probability that one of the harmonics is made of peaks of noise."""
MOST = 3000
"""Highest peaks that are looked at."""


def bin_widths(frequency: FloatArray) -> FloatArray:
    """Widths of the bins [Hz]."""
    return np.asarray(np.gradient(frequency))


def peak_ratios(amplitude: FloatArray) -> FloatArray:
    """Ratio (f,) of each local maximum to the median around it, of the axis where it is the most; 0 elsewhere."""
    count = len(amplitude)
    ratios = np.zeros(count)
    for column in amplitude.T:
        inner = np.flatnonzero((column[1:-1] > column[:-2]) & (column[1:-1] >= column[2:])) + 1
        floor = np.array([np.median(column[max(i - AROUND, 0) : i + AROUND + 1]) for i in inner])
        with np.errstate(divide="ignore"):
            ratios[inner] = np.maximum(ratios[inner], np.where(floor > 0.0, column[inner] / floor, np.inf))
    return ratios


@dataclass(frozen=True)
class _Peaks:
    """Peaks of all spectra: row, frequency and speed of each, those that are not explained yet, and the tolerance."""

    rows: NDArray[np.int64]
    at: FloatArray
    speed: FloatArray
    within: float

    def without(self, taken: BoolArray) -> _Peaks:
        return _Peaks(self.rows[~taken], self.at[~taken], self.speed[~taken], self.within)

    def counts(self, values: FloatArray, scale: FloatArray) -> NDArray[np.int64]:
        """Number of spectra with a peak at each of the values times `scale`."""
        starts = np.unique(self.rows, return_index=True)[1]
        numbers = [
            np.logical_or.reduceat(np.abs(self.at - part[:, None] * scale) <= self.within, starts, axis=1).sum(axis=1)
            for part in np.array_split(values, max(1, values.size * self.at.size // 2_000_000))
        ]
        return np.asarray(np.concatenate(numbers))


def harmonic_orders(peaks: FloatArray, speeds: FloatArray, frequency: FloatArray) -> FloatArray:
    """Orders of the harmonics that explain the peaks (s, f) of the spectra.

    What explains the largest part of the spectra comes first and takes its peaks with it: an order, or a frequency that
    is the same at all speeds, which is no harmonic.
    """
    above = ABOVE if speeds.size >= MANY else ABOVE_FEW
    high = np.sort(peaks.ravel())[-min(MOST, peaks.size)]
    rows, places = np.nonzero((peaks > above) & (peaks >= high))
    left = _Peaks(rows, frequency[places], speeds[rows], SAME * float(bin_widths(frequency).max()))
    orders = list[float]()
    while left.at.size:
        best = [_best(left, speeds, frequency, constant) for constant in (False, True)]
        order, constant = best
        if order is None and constant is None:
            break
        if constant is None or (order is not None and order[:2] >= constant[:2]):
            assert order is not None
            orders.append(order[2])
            left = left.without(np.abs(left.at - order[2] * left.speed) <= left.within)
        else:
            left = left.without(np.abs(left.at - constant[2]) <= left.within)
    return np.sort(orders)


def _best(left: _Peaks, speeds: FloatArray, frequency: FloatArray, constant: bool) -> tuple[float, float, float] | None:
    """Part of the spectra, minus the mean miss, and value of the order or frequency that is in most; None without one.

    More spectra have it than would by chance, if the peaks were anywhere.
    """
    scale = np.ones_like(left.speed) if constant else left.speed
    values = np.unique(left.at / scale)
    ranges = np.ones(speeds.size) if constant else speeds
    seen = (np.outer(values, ranges) <= frequency[-1]).sum(axis=1)
    counts = left.counts(values, scale)
    need = np.maximum(2, np.ceil(SHARE * seen))
    if speeds.size >= MANY:
        chance = min(1.0, left.at.size * (2 * left.within) / (speeds.size * float(np.ptp(frequency))))
        need = np.where(stats.binom.sf(counts - 1, seen, chance) * values.size < CHANCE, need, np.inf)
    share = np.where(counts >= need, counts / seen, 0.0)
    if not share.any():
        return None
    best = None
    for value in values[share == share.max()]:
        members = np.abs(left.at - value * scale) <= left.within
        value = float((left.at[members] * scale[members]).sum() / np.square(scale[members]).sum())
        miss = float(np.abs(left.at[members] - value * scale[members]).mean())
        if best is None or -miss > best[1]:
            best = float(share.max()), -miss, value
    return best
