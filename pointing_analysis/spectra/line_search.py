r"""Separation of lines and noise: sinusoids of unknown frequencies in a record.

A line is a sinusoid that keeps its frequency, amplitude and phase through the whole record. At each frequency the power
of the fitted sinusoid is compared with that of the noise beside it, both axes together: with the Fourier transforms
:math:`X = (X_x, X_y)` of the tapered record and the covariance :math:`S` of d independent transforms beside it, the
statistic :math:`t = X^* S^{-1} X` of noise alone has

.. math:: P(t > t_0) = u^{d-1} (1 + (d - 1)(1 - u)), \quad u = 1 / (1 + t_0 / d)

(Hotelling's :math:`T^2` of two complex variables, an F distribution of 4 and 2(d - 1) degrees of freedom; the harmonic
F-test of Thomson, Proc. IEEE 70, 1982, section XIII, is the one of one axis with tapers in place of neighbours). This
holds where the density of the noise changes little over the neighbours, whatever it is elsewhere.

**What is a line.** Two sets of neighbours are asked. The wide one has many degrees of freedom and decides: among all
frequencies of a record of noise the expected number of false lines is at most `false_lines`. The narrow one refuses
noise of a narrow band, for instance of a resonance: noise whose band is wider than some 10 / T is not taken for a line
in a record of length T; noise of a narrower band is coherent as long as the record is, and nothing tells it from one.
Where the noise on both sides differs, the larger one counts (the noise of a drift falls with frequency).

**What is found.** A line is L dB above the noise where its power, both axes, is 10^(L/10) times the power that the
noise has in a band of `LineSearchSettings.band`, the resolution bandwidth of the report's spectrum (Hann, 4 s): there
its peak is L dB above the noise. Strong lines are fitted and taken away, so that weaker ones beside them come out.

**Sidebands** of a tone that moves name their carrier (:mod:`pointing_analysis.spectra.sidebands`).

Bounds of an amplitude are those of its noncentral distribution with the noise beside the line. Samples that are missing
are left out of the fits and are zero in the transforms.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft, special

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import ComplexArray, FloatArray, IntArray
from pointing_analysis.spectra.sidebands import FittedRecord, FoundLine, with_carriers
from pointing_analysis.spectra.sinusoid_fit import Sinusoids, fit_sinusoids

EULER = 0.5772156649015329
"""The mean of the logarithm of an exponentially distributed power is lower than that of its mean by so much."""


@dataclass(frozen=True)
class LineSearchSettings(AlgorithmSettings):
    """What is a line, and how it is looked for.

    Attributes
    ----------
    false_lines : expected number of false lines in a record of noise
    band : resolution bandwidth of the report's spectrum [Hz]
    core, narrow, wide : neighbours are from `core` to `narrow`, or `wide`, times 1 / T away
    narrow_chance : probability in noise of a statistic as large as one that passes the narrow neighbours
    loose : factor of both chances for candidates: a line between two frequencies of the spectrum is seen less
    fewest_periods : of a line in the record: below, there are not enough neighbours
    steep : ratio of the noise on both sides from which that on the larger side counts
    cap : neighbours count with at most so many times the level beside each: another line among them hides nothing
    edges : part of the record over which the taper rises and falls (Tukey)
    exact : median density over the largest one below which a record is one without noise
    added : noise that is added to it then, a part of its root mean square: without any, a line has only what the taper
        leaves of it to stand out of
    most_lines, most_asked, passes : lines, candidates of one pass that are compared, and passes
    block : frequencies of the spectrum at a time
    most_missing : part of the samples that may be missing
    fewest_samples : of a record
    """

    false_lines: float = 2e-3
    band: float = 1.5 / 4.0
    core: float = 1.5
    narrow: float = 7.0
    wide: float = 32.0
    narrow_chance: float = 1e-4
    loose: float = 10.0
    fewest_periods: float = 7.0
    steep: float = 1.5
    cap: float = 6.0
    edges: float = 0.25
    exact: float = 1e-15
    added: float = 1e-6
    most_lines: int = 60
    most_asked: int = 2000
    passes: int = 8
    block: int = 1 << 16
    most_missing: float = 0.25
    fewest_samples: int = 64


SETTINGS = LineSearchSettings()


def find_lines(
    error: ArrayLike, dt: float, confidence: float = 0.95, settings: LineSearchSettings = SETTINGS
) -> tuple[FoundLine, ...]:
    """Lines of a record, the lowest frequency first.

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt : [s]
    confidence : of the bounds of the amplitudes
    settings : of the search

    Returns
    -------
    Lines; none for a record with fewer samples than the settings ask, or more of them missing

    Examples
    --------
    >>> t = 1e-3 * np.arange(10_000)
    >>> noise = np.random.default_rng(0).standard_normal((10_000, 2))
    >>> tones = np.column_stack([0.3 * np.sin(280.0 * t), 0.2 * np.cos(565.0 * t)])
    >>> [round(line.omega) for line in find_lines(noise + tones, 1e-3)], find_lines(noise, 1e-3)
    ([280, 565], ())
    """
    e = np.asarray(error, dtype=float)
    present = np.isfinite(e).all(axis=1)
    n = len(e)
    if n < settings.fewest_samples or present.sum() < (1.0 - settings.most_missing) * n:
        return ()
    largest = float(np.abs(e[present]).max())
    if not largest > 0.0:
        return ()
    unit = 2.0 ** math.floor(math.log2(largest))  # squares of all values are numbers then, and no value is rounded
    e = e / unit
    # Tukey's taper: ones with cosine edges
    edge = max(round(0.5 * settings.edges * n), 1)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / edge)
    weight = np.where(present, np.concatenate([rise, np.ones(n - 2 * edge), rise[::-1]]), 0.0)
    fitted = fit_sinusoids(e, weight, dt, np.empty(0))
    if not np.abs(fitted.rest).max() > 0.0:
        return ()
    density = _Background.of(fitted.rest, weight, dt, settings).power[:, :2].sum(axis=1)
    if np.median(density) < settings.exact * density.max():
        rms = float(np.sqrt(np.mean(np.square(fitted.rest[present]))))
        e = e + settings.added * rms * np.random.default_rng(0).standard_normal(e.shape)
        fitted = fit_sinusoids(e, weight, dt, np.empty(0))
    for _ in range(settings.passes):
        background = _Background.of(fitted.rest, weight, dt, settings)
        more = background.candidates(fitted.omega)[: settings.most_lines - fitted.omega.size]
        if not more.size:
            break
        before = fitted.omega.size
        fitted = fit_sinusoids(e, weight, dt, np.concatenate([fitted.omega, more]))
        fitted = _significant(fitted, e, weight, dt, settings)
        if fitted.omega.size <= before:
            break
    lines = _lines(fitted, dt, confidence, weight, settings)
    noise_of = _Background.of(fitted.rest, weight, dt, settings).noise_of
    lines = with_carriers(lines, FittedRecord(e, weight, dt, fitted, noise_of))
    return tuple(line.times(unit) for line in lines)


@dataclass(frozen=True)
class _Background:
    """Spectrum of what is left of a record, and the noise beside each frequency.

    Attributes
    ----------
    step : distance of the frequencies [rad/s]
    power : (m, 4) of x, of y, real and imaginary cross power: one-sided density [unit^2/Hz]
    resolution : frequencies of the spectrum for one 1 / T
    each : independent transforms for each frequency of the spectrum
    settings : of the search
    duration : of a record without taper in which the phasor of a line has the scatter that it has in this one [s]
    """

    step: float
    power: FloatArray
    resolution: float
    each: float
    duration: float
    settings: LineSearchSettings

    @classmethod
    def of(cls, rest: FloatArray, weight: FloatArray, dt: float, settings: LineSearchSettings) -> _Background:
        n = len(rest)
        size = int(fft.next_fast_len(2 * n, real=True))
        X = fft.rfft(rest.T * weight, size)
        squares = np.square(weight)
        scale = 2.0 * dt / squares.sum()
        cross = scale * X[0] * X[1].conj()
        powers = [scale * (one.real**2 + one.imag**2) for one in X]
        each = squares.sum() ** 2 / (size * np.square(squares).sum())
        step = 2.0 * np.pi / (size * dt)
        matrix = np.stack([*powers, cross.real, cross.imag], axis=1)
        return cls(step, matrix, size / n, float(each), float(dt * weight.sum() ** 2 / squares.sum()), settings)

    @property
    def lowest(self) -> int:
        """Index of the lowest frequency that is a neighbour."""
        return round(self.resolution)

    @cached_property
    def tiny(self) -> float:
        """Offset added to a power before its logarithm."""
        return 1e-30 * float(self.power[:, :2].max(initial=0.0)) + 1e-300

    @property
    def first(self) -> int:
        """Index of the lowest frequency that is asked."""
        return math.ceil(self.settings.fewest_periods * self.resolution)

    @property
    def end(self) -> int:
        """Index behind the highest frequency that is asked."""
        return max(len(self.power) - self.first, self.first)

    @property
    def asked(self) -> int:
        """Number of frequencies that are asked."""
        return max(self.end - self.first, 1)

    def noise(self, begin: int, end: int, width: float) -> tuple[FloatArray, FloatArray]:
        """Density matrix (k, 4) of the noise beside the frequencies from an index to another, and its transforms (k,).

        Parameters
        ----------
        begin, end : of the frequencies
        width : of the neighbours [1/T]
        """
        near, far = round(self.settings.core * self.resolution), round(width * self.resolution)
        first, last = max(begin - far, self.lowest), min(end + far, len(self.power))
        power, places = self.power[first:last], _places_beside(np.arange(begin, end), near, far, first, last)
        around = self._level(first, last, self.settings.narrow)
        weight = np.minimum(1.0, 2.0 * self.settings.cap / np.maximum((power[:, :2] / around).sum(axis=1), 1e-300))
        level = self._level(begin, end, width)
        sides, counts = _sums(power * weight[:, None], places)
        means = [side / np.maximum(count, 1)[:, None] for side, count in zip(sides, counts)]
        sizes = [(mean[:, :2] / level).sum(axis=1) for mean in means]
        both = (sides[0] + sides[1]) / np.maximum(counts.sum(axis=0), 1)[:, None]
        steep = np.maximum(sizes[0], sizes[1]) > self.settings.steep * np.minimum(sizes[0], sizes[1])
        density = np.where(steep[:, None], np.where((sizes[0] > sizes[1])[:, None], *means), both)
        return density, np.maximum(self.each * counts.sum(axis=0), 2.0)

    def _level(self, begin: int, end: int, width: float) -> FloatArray:
        """Level (k, 2) of the noise of each axis beside the frequencies from an index to another: a mean of logarithms.

        A line among the neighbours hardly changes it.
        """
        near, far = round(self.settings.core * self.resolution), round(width * self.resolution)
        first, last = max(begin - far, self.lowest), min(end + far, len(self.power))
        logarithm = np.log(self.power[first:last, :2] + self.tiny)
        sides, counts = _sums(logarithm, _places_beside(np.arange(begin, end), near, far, first, last))
        return np.asarray(np.exp((sides[0] + sides[1]) / np.maximum(counts.sum(axis=0), 1)[:, None] + EULER))

    def noise_of(self, line: FoundLine) -> tuple[ComplexArray, float]:
        """Covariance (2, 2) that the phasor of a line has from the noise beside it, and its transforms."""
        index = min(round(line.omega / self.step), len(self.power) - 1)
        noise, number = self.noise(index, index + 1, self.settings.wide)
        x, y, re, im = noise[0]
        matrix = np.array([[x, re + 1j * im], [re - 1j * im, y]]) + 1e-12 * (x + y) * np.eye(2) + 1e-60 * np.eye(2)
        return 2.0 * matrix / self.duration, float(number[0])

    def candidates(self, known: FloatArray) -> FloatArray:
        """Frequencies [rad/s] of new lines, the clearest first."""
        chance = np.concatenate(
            [self._chances(begin) for begin in range(self.first, self.end, self.settings.block)] or [np.empty(0)]
        )
        at = np.flatnonzero(chance * self.asked < self.settings.loose * self.settings.false_lines)
        indices: list[int] = []
        taken = sorted(map(float, known / self.step))
        for index in at[np.argsort(chance[at], kind="stable")][: self.settings.most_asked] + self.first:
            place = bisect_left(taken, float(index))
            if all(abs(index - other) >= self.resolution for other in taken[max(place - 1, 0) : place + 1]):
                taken.insert(place, float(index))
                if (
                    float(self.chance(self.power[index], int(index), self.settings.narrow)[0])
                    < self.settings.loose * self.settings.narrow_chance
                ):
                    indices.append(int(index))
        return np.array(indices[: self.settings.most_lines], dtype=float) * self.step

    def _chances(self, begin: int) -> FloatArray:
        """Probabilities by the wide neighbours for a block of frequencies."""
        end = min(begin + self.settings.block, self.end)
        return _chance(self.power[begin:end], *self.noise(begin, end, self.settings.wide))

    def chance(self, power: FloatArray, index: int, width: float) -> FloatArray:
        """Probability that noise has such a power (4,) at a frequency."""
        return _chance(power[None], *self.noise(index, index + 1, width))


def _places_beside(k: IntArray, near: int, far: int, first: int, last: int) -> list[tuple[IntArray, IntArray]]:
    """First and last neighbours of some frequencies on each side, within a range and from its first one."""
    edges = ((k - far, k - near + 1), (k + near, k + far + 1))
    return [(np.clip(low, first, last) - first, np.clip(high, first, last) - first) for low, high in edges]


def _sums(values: FloatArray, places: Sequence[tuple[IntArray, IntArray]]) -> tuple[list[FloatArray], IntArray]:
    """Sums of values (m, q) from index to index of each side, and their numbers (2, k)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    sums = [total[np.maximum(begin, end)] - total[begin] for begin, end in places]
    return sums, np.stack([np.maximum(end - begin, 0) for begin, end in places])


def _chance(power: FloatArray, noise: FloatArray, d: FloatArray) -> FloatArray:
    """Probability that noise (k, 4) of d independent transforms (k,) has a larger statistic than powers (k, 4)."""
    x, y, re, im = noise.T
    floor = 1e-12 * (x + y) + 1e-60  # an axis without noise; the record is near one
    x, y = x + floor, y + floor
    px, py, p_re, p_im = power.T
    determinant = np.maximum(x * y - re**2 - im**2, 1e-12 * x * y)  # both axes alike
    t = (px * y + py * x - 2.0 * (p_re * re + p_im * im)) / determinant
    u = 1.0 / (1.0 + np.maximum(t, 0.0) / d)
    return np.asarray(np.exp((d - 1.0) * np.log(u)) * (1.0 + (d - 1.0) * (1.0 - u)))


def _significant(
    fitted: Sinusoids, e: FloatArray, weight: FloatArray, dt: float, settings: LineSearchSettings
) -> Sinusoids:
    """The fit without those lines that do not stand out of what all of them leave."""
    background = _Background.of(fitted.rest, weight, dt, settings)
    stays = np.zeros(fitted.omega.size, dtype=bool)
    for i, (index, power) in enumerate(_places(fitted, background)):
        if background.first <= index < background.end:
            wide, narrow = (
                float(background.chance(power, index, width)[0]) for width in (settings.wide, settings.narrow)
            )
            stays[i] = wide * background.asked < settings.false_lines and narrow < settings.narrow_chance
    return fitted if stays.all() else fit_sinusoids(e, weight, dt, fitted.omega[stays], moves=False)


def _places(fitted: Sinusoids, background: _Background) -> list[tuple[int, FloatArray]]:
    """Index of each line in the spectrum, and the power (4,) that a transform of noise like it has."""
    index = np.clip(np.round(fitted.omega / background.step).astype(int), 0, len(background.power) - 1)
    x, y = fitted.phasor.T
    cross = x * y.conj()
    power = 0.5 * background.duration * np.stack([np.abs(x) ** 2, np.abs(y) ** 2, cross.real, cross.imag], axis=1)
    return list(zip(index.tolist(), power))


def _lines(
    fitted: Sinusoids, dt: float, confidence: float, weight: FloatArray, settings: LineSearchSettings
) -> tuple[FoundLine, ...]:
    if not fitted.omega.size:
        return ()
    background = _Background.of(fitted.rest, weight, dt, settings)
    places = _places(fitted, background)
    beside = [background.noise(index, index + 1, settings.wide) for index, _ in places]
    density = np.array([noise[0, :2] for noise, _ in beside])
    number = np.array([d[0] for _, d in beside])
    chance = [float(background.chance(power, index, settings.wide)[0]) * background.asked for index, power in places]
    level = np.sum(np.abs(fitted.phasor) ** 2, axis=1) / 2.0 / np.maximum(density.sum(axis=1) * settings.band, 1e-300)
    spread = np.sqrt(density / background.duration)
    lower, upper = amplitude_bounds(np.abs(fitted.phasor), spread, number[:, None], confidence)
    decibels = 10.0 * np.log10(np.maximum(level, 1e-30))
    parts = zip(fitted.omega, fitted.phasor, lower, upper, decibels, chance)
    return tuple(FoundLine(float(w), p, a, b, float(dB), c) for w, p, a, b, dB, c in parts)


def amplitude_bounds(
    amplitude: FloatArray, spread: FloatArray, number: FloatArray, confidence: float
) -> tuple[FloatArray, FloatArray]:
    """Bounds of amplitudes whose cosine and sine parts have Gaussian errors.

    Parameters
    ----------
    amplitude : (...) as fitted
    spread : (...) standard deviation of each part, as estimated
    number : (...) independent complex transforms that it is estimated from
    confidence : of both bounds together

    Examples
    --------
    >>> low, high = amplitude_bounds(np.array([0.5, 10.0]), np.ones(2), np.full(2, 1e6), 0.95)
    >>> low.round(2).tolist(), high.round(2).tolist()
    ([0.0, 7.98], [1.81, 11.91])
    """
    tail = 0.5 * (1.0 - confidence)
    normal = -special.ndtri(tail)  # scipy.stats has both, at the cost of a slow, large import
    wide = -special.stdtrit(2.0 * number, tail) / normal
    s = np.maximum(spread * wide, 1e-300)
    ratio = np.broadcast_to(amplitude / s, np.broadcast_shapes(amplitude.shape, s.shape))
    near = np.minimum(ratio, 25.0) ** 2  # beyond, the distribution is Gaussian
    low = np.where(special.chndtr(near, 2.0, 0.0) > 1.0 - tail, special.chndtrinc(near, 2.0, 1.0 - tail), 0.0)
    high = np.where(special.chndtr(near, 2.0, 0.0) > tail, special.chndtrinc(near, 2.0, tail), 0.0)
    far = ratio > 25.0
    return (
        np.where(far, ratio - normal, np.sqrt(low)) * s,
        np.where(far, ratio + normal, np.sqrt(high)) * s,
    )
