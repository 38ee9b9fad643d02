"""Wheel model from a waterfall: harmonics, structural modes and broadband noise of amplitude over speed and frequency.

The method is that of Masterson, Miller and Grogan, *Development and validation of reaction wheel disturbance models:
empirical model*, Journal of Sound and Vibration 249(3), 2002, pp. 575-598: peaks of all speeds are gathered by their
order (frequency over speed), an order that is in enough of the spectra is a harmonic, and its amplitude coefficient is
that of least squares,

    f(t) = sum_i C_i W^2 sin(2 pi h_i W t + phi_i),    C_i = sum_j F_ij W_j^2 / sum_j W_j^4

over the speeds W_j. What is at one frequency at all speeds (modes of the wheel and of the test stand, mains) is no
harmonic; speeds at which a harmonic crosses it do not count for its coefficient. What remains is broadband noise.

Neglected: the amplification of a harmonic at a mode of the wheel; `WheelModel.deviations` has its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import BoolArray, FloatArray
from lftkit.errors import InputError
from titop_plant.disturbances.wheel_harmonics import AROUND, SHARE, bin_widths, harmonic_orders, peak_ratios

REACH = 4
"""Bins on each side of a harmonic that have its power."""
MODE, WIDE = 2.0, 60
"""A mode is a peak of the mean noise that is so many times as high as the median of so many bins on each side."""
BESIDE = 0.1
"""Part of the frequency of a mode by which a harmonic that counts must be beside it."""
SIGNIFICANT = 1.5
"""Power of a harmonic in an axis over that of the noise around it."""
LARGE = 1.5
"""A measured amplitude over that of the fit from which on it is reported."""
LEAST = 1e-12
"""Least density of the noise over its largest one."""
SMOOTH = 3
"""Bins on each side over which the power of the noise is averaged."""


@dataclass(frozen=True)
class WheelModel:
    """Harmonics and noise of a wheel.

    Attributes
    ----------
    orders : ndarray, shape (q,)
        Frequency over speed.
    coefficients : ndarray, shape (q, 6)
        Amplitude over the speed squared [N s^2, Nm s^2; speed in Hz].
    deviations : ndarray, shape (q,)
        Largest measured amplitude over that of the coefficient, of the axis where it is the most.
    modes : ndarray, shape (m,)
        Frequencies [Hz] of peaks that do not depend on the speed.
    speeds, frequency : ndarray, shapes (s,), (f,)
        Hz.
    power : ndarray, shape (s, f, 6)
        Mean square of the noise in each bin [N^2, Nm^2].
    """

    orders: FloatArray
    coefficients: FloatArray
    deviations: FloatArray
    modes: FloatArray
    speeds: FloatArray
    frequency: FloatArray
    power: FloatArray

    def lines_at(self, speed: float) -> tuple[FloatArray, FloatArray]:
        """Frequencies (q,) [Hz] and amplitudes (q, 6) [N, Nm] of the harmonics at a speed [Hz].

        Raises
        ------
        ValueError
            A speed outside of the table.
        """
        self._check(speed)
        return speed * self.orders, speed**2 * self.coefficients

    def density_at(self, speed: float) -> FloatArray:
        """One-sided power spectral density (f, 6) of the noise at a speed [Hz], with all of its power [N^2/Hz].

        Raises
        ------
        ValueError
            A speed outside of the table.
        """
        self._check(speed)
        right = min(max(int(np.searchsorted(self.speeds, speed)), 1), self.speeds.size - 1)
        share = (speed - self.speeds[right - 1]) / (self.speeds[right] - self.speeds[right - 1])
        power = (1.0 - share) * self.power[right - 1] + share * self.power[right]
        kernel = np.ones(2 * SMOOTH + 1)
        count = np.convolve(np.ones(self.frequency.size), kernel, "same")
        smooth = np.array([np.convolve(column, kernel, "same") for column in power.T]).T / count[:, None]
        density = smooth / bin_widths(self.frequency)[:, None]
        density = np.maximum(density, LEAST * density.max(axis=0))  # it is interpolated on logarithmic axes
        area = np.array([_area(self.frequency, column) for column in density.T])
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = np.where(area > 0.0, power.sum(axis=0) / area, 0.0)
        return np.asarray(density * factor)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was found, one sentence each."""
        orders = ", ".join(f"{order:.4g}" for order in self.orders) or "none"
        rows = [f"waterfall: harmonics of the orders {orders}; the rest is noise"]
        if self.modes.size:
            rows.append(f"waterfall: modes at {', '.join(f'{f:.4g}' for f in self.modes)} Hz are part of the noise")
        large = [f"{d:.2g} times of order {h:.4g}" for h, d in zip(self.orders, self.deviations) if d > LARGE]
        if large:
            rows.append(f"waterfall: amplitudes of some speeds are above the fit: {', '.join(large)}")
        return tuple(rows)

    def _check(self, speed: float) -> None:
        low, high = self.speeds[0], self.speeds[-1]
        if not low <= speed <= high:
            raise InputError(f"speed must be between {low:g} and {high:g} Hz of the waterfall, got {speed:g} Hz")


def identify(speeds: FloatArray, frequency: FloatArray, amplitude: FloatArray, bandwidth: float = 1.0) -> WheelModel:
    """Harmonics, modes and noise of a waterfall.

    Parameters
    ----------
    speeds : ndarray, shape (s,)
        Hz, ascending, two or more.
    frequency : ndarray, shape (f,)
        Hz, ascending.
    amplitude : ndarray, shape (s, f, 6)
        N, Nm: **the amplitude of a tone at the frequency of its bin**, sqrt(2) times the rms value in the bin.
    bandwidth : float
        Equivalent noise bandwidth of the window of the spectra in bins: 1 without a window, 1.5 of a Hann window. The
        powers of noise, and of a tone over its bins, are so many times as high in the table.

    Examples
    --------
    Harmonics of the orders 1 and 2.8 whose amplitudes grow with the speed squared, and a mode at 90 Hz:

    >>> speeds, frequency = np.linspace(20, 40, 9), np.arange(0.0, 200.0)
    >>> table = np.full((9, 200, 6), 1e-4)
    >>> for row, speed in zip(table, speeds):
    ...     row[90] = 0.02
    ...     for order, size in ((1.0, 1e-5), (2.8, 2e-5)):
    ...         row[round(order * speed)] = size * speed**2
    >>> model = identify(speeds, frequency, table)
    >>> model.orders.round(2), model.coefficients[:, 0].round(6), model.modes
    (array([1. , 2.8]), array([1.e-05, 2.e-05]), array([90.]))
    """
    bins = bin_widths(frequency)
    harmonics = harmonic_orders(np.array([peak_ratios(one) for one in amplitude]), speeds, frequency)
    power = 0.5 * np.square(amplitude) / bandwidth
    near, owner = _owners(harmonics, speeds, frequency)
    noise = _between(power, near)
    constant = _modes(noise, frequency)
    orders, coefficients, deviations = [], [], []
    for i, order in enumerate(harmonics):
        mine = near & (owner == i)
        seen = mine.any(axis=1)
        usable = seen & ~_crosses(order * speeds, constant, float(bins.max()))
        usable = usable if usable.sum() >= SHARE * seen.sum() else seen
        level = np.array([[power[j, mine[j]].sum(axis=0), noise[j, mine[j]].sum(axis=0)] for j in range(speeds.size)])
        coefficient, deviation = _coefficients(level, speeds, usable)
        if coefficient.any():
            orders.append(order)
            coefficients.append(coefficient)
            deviations.append(deviation)
    kept = np.array(orders)
    near, _ = _owners(kept, speeds, frequency)
    arrays = np.reshape(coefficients, (kept.size, 6)), np.array(deviations)
    return WheelModel(kept, *arrays, constant, speeds, frequency, _between(power, near))


def grid_of(speed: FloatArray, frequency: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Speeds (s,), frequencies (f,) and values (s, f, 6) of rows (n,), (n,), (n, 6) in any order.

    Raises
    ------
    ValueError
        Not one row for each frequency at each of two or more speeds.
    """
    speeds, bins = np.unique(speed), np.unique(frequency)
    if speeds.size < 2 or speeds.size * bins.size != speed.size or not np.isfinite([speed, frequency]).all():
        raise InputError(
            f"waterfall must have a row for each of its frequencies at each of two or more speeds, "
            f"got {speed.size} rows with {bins.size} frequencies and {speeds.size} speeds"
        )
    order = np.lexsort((frequency, speed))
    rows, places = (one[order].reshape(speeds.size, bins.size) for one in (speed, frequency))
    if ((rows != speeds[:, None]) | (places != bins)).any():
        same = np.flatnonzero((np.diff(speed[order]) == 0) & (np.diff(frequency[order]) == 0))[0]
        twice = f"{60 * speed[order[same]]:g} rpm, {frequency[order[same]]:g} Hz"
        raise InputError(f"waterfall must have one row for each frequency at each speed, got two of {twice}")
    return speeds, bins, values[order].reshape(speeds.size, bins.size, 6)


def _area(frequency: FloatArray, density: FloatArray) -> float:
    """Power of a density that is interpolated on logarithmic axes, as `noise_of_density` does, from the first on."""
    low, high = np.maximum(density[:-1], 1e-300), np.maximum(density[1:], 1e-300)
    left, right = frequency[:-1], frequency[1:]
    first = np.where(left > 0.0, left, 1.0)
    slope = np.log(high / low) / np.log(np.where(left > 0.0, right / first, 2.0))
    ratio = np.log(np.where(left > 0.0, right / first, 2.0))
    near = np.abs(slope + 1.0) < 1e-6
    whole = np.where(near, low * first * ratio, (high * right - low * first) / np.where(near, 1.0, slope + 1.0))
    return float(np.where(left > 0.0, whole, 0.5 * (low + high) * (right - left)).sum())


def _modes(noise: FloatArray, frequency: FloatArray) -> FloatArray:
    """Frequencies of the peaks of the noise (s, f, 6), averaged over the speeds."""
    mean = np.sqrt(noise.mean(axis=0))
    bins = set[int]()
    for column in mean.T:
        smooth = np.convolve(column, np.ones(2 * SMOOTH + 1) / (2 * SMOOTH + 1), "same")
        for i in np.flatnonzero(smooth):
            around = smooth[max(i - WIDE, 0) : i + WIDE + 1]
            near = smooth[max(i - AROUND, 0) : i + AROUND + 1]
            if smooth[i] == near.max() and smooth[i] > MODE * np.median(around) and 0 < i < smooth.size - 1:
                bins.add(int(max(i - SMOOTH, 0) + np.argmax(column[max(i - SMOOTH, 0) : i + SMOOTH + 1])))
    places = sorted(bins)
    kept = [i for k, i in enumerate(places) if not k or i - places[k - 1] > AROUND]
    return np.asarray(frequency[kept])


def _owners(orders: FloatArray, speeds: FloatArray, frequency: FloatArray) -> tuple[BoolArray, NDArray[np.int64]]:
    """Bins (s, f) that have power of a harmonic, and of which one: that which is nearest."""
    if not orders.size:
        return np.zeros((speeds.size, frequency.size), bool), np.zeros((speeds.size, frequency.size), np.int64)
    miss = np.abs(frequency[None, :, None] - orders * speeds[:, None, None])
    near = miss.min(axis=2) <= (REACH + 0.5) * bin_widths(frequency)
    return near, miss.argmin(axis=2)


def _between(power: FloatArray, left_out: BoolArray) -> FloatArray:
    """Powers with those of the bins that are left out on the line between the means of `AROUND` bins beside them."""
    filled = power.copy()
    for j, out in enumerate(left_out):
        kept = np.flatnonzero(~out)
        if kept.size < 2 or not out.any():
            continue
        for i in np.flatnonzero(out):
            place = int(np.searchsorted(kept, i))
            beside = kept[max(place - AROUND // 2, 0) : place + AROUND // 2]
            filled[j, i] = power[j, beside].mean(axis=0)
    return filled


def _crosses(frequency: FloatArray, modes: FloatArray, width: float) -> BoolArray:
    """Speeds at which a harmonic is at a mode, which amplifies it, or has the bins of one beside its own."""
    miss = np.abs(frequency[:, None] - modes)
    return np.asarray((miss <= np.maximum((AROUND + REACH) * width, BESIDE * modes)).any(axis=1))


def _coefficients(level: FloatArray, speeds: FloatArray, usable: BoolArray) -> tuple[FloatArray, float]:
    """Amplitude coefficients (6,) by least squares, and the largest amplitude over its own.

    Parameters
    ----------
    level : (s, 2, 6) power in the bins of the harmonic, and of the noise in them
    speeds : (s,) [Hz]
    usable : (s,) speeds that count
    """
    total, noise = level[usable, 0], level[usable, 1]
    amplitude = np.sqrt(2.0 * np.clip(level[:, 0] - level[:, 1], 0.0, None))
    weight = np.square(speeds)
    coefficient = weight[usable] @ amplitude[usable] / np.square(weight[usable]).sum()
    coefficient = np.where(total.sum(axis=0) > SIGNIFICANT * noise.sum(axis=0), coefficient, 0.0)
    expected = coefficient * weight[:, None]
    main = int(np.argmax(coefficient))
    if not coefficient[main]:
        return coefficient, 1.0
    return coefficient, float((amplitude[:, main] / expected[:, main]).max())
