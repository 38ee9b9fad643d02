"""Spectra of the line of sight: power density, cumulative RMS, contribution of each disturbance line to the RPE.

Nothing is detrended: an offset is part of the APE and stays in the spectrum at zero frequency.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.errors import InputError
from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from pointing_analysis.indices import metrics, weights
from pointing_analysis.read.mapped_arrays import by_parts, empty, parts, release
from pointing_analysis.read.topic import read_only
from pointing_analysis.spectra.sidebands import FoundLine

NEIGHBOURS = np.arange(2, 8)  # whole periods in the run by which the frequencies of `background` lie beside a tone
FITTED = 20_000  # rows of a fit at a time
MEDIAN = np.log(2.0)  # median over mean of the square of one complex component of noise, exponential
CLEAR = 3.0
"""A line is above the noise if its amplitude is at least this many times that of the noise beside it."""
LEAK = 1.05
"""Ratio of the RPE of the parts of a record, tones and rest, to that of the record: above it the fit has taken a drift
or a pulse for tones. Parts that are independent differ from the whole by their scatter alone, some 2 % in short runs.
"""
FEWEST = 10
"""Windows of a record whose parts are compared with the whole."""


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density.

    Attributes
    ----------
    frequency : (m,) [Hz]
    density : (m, 2) per axis [unit^2/Hz]; the integral over frequency is the mean square
    segments, skipped : averaged segments, and those left out because a sample is missing
    """

    frequency: FloatArray
    density: FloatArray
    segments: int
    skipped: int

    @property
    def step(self) -> float:
        """Distance of two frequencies [Hz]."""
        return float(self.frequency[1] - self.frequency[0])

    def cumulative_rms(self, weight: ArrayLike = 1.0) -> FloatArray:
        """Radial RMS of all that lies at or below each frequency: (m,), same unit as the error.

        Parameters
        ----------
        weight : (m,) magnitude of a weight, for instance `weights.rpe_exact` for the RPE
        """
        total = self.density.sum(axis=1) * np.square(weight)
        return np.asarray(np.sqrt(np.cumsum(total) * self.step))


@dataclass(frozen=True)
class BandSettings(AlgorithmSettings):
    """What counts as the end of a spectrum.

    Attributes
    ----------
    rows, fewest : of a record that are looked at, from its begin
    beta : of the Kaiser window
    top : part of the frequencies, the highest, that have the floor
    rounding : power of the floor over the largest one that is the rounding of a double
    quantum : power of the floor over that of the smallest step that is its quantisation
    above : power over that of the floor up to which there is motion
    lines : median power of the band over the largest one below which there are lines alone
    early : part of the Nyquist frequency below which a spectrum ends early
    """

    rows: int = 1 << 16
    fewest: int = 256
    beta: float = 30.0
    top: float = 0.1
    rounding: float = 1e-20
    quantum: float = 4.0
    above: float = 100.0
    lines: float = 1e-9
    early: float = 0.5


BAND = BandSettings()


def highest_frequency(error: FloatArray, dt: float, settings: BandSettings = BAND) -> float | None:
    """Frequency [Hz] above which a record (n, 2) has only the rounding of its numbers; None where it goes on.

    So are records that were made from slower ones by a smooth interpolation.

    Examples
    --------
    >>> from scipy.signal import resample
    >>> slow = np.random.default_rng(1).standard_normal((400, 2))
    >>> round(highest_frequency(resample(slow, 8000), 1e-3)), highest_frequency(slow, 1e-3)
    (26, None)
    """
    e = np.asarray(error[: settings.rows], dtype=float)
    if len(e) < settings.fewest or np.isnan(e).any():
        return None
    # A window whose side lobes are below the rounding of a double: leakage would hide the end.
    taper = np.kaiser(len(e), settings.beta)
    power = np.square(np.abs(np.fft.rfft((e - e.mean(axis=0)) * taper[:, None], axis=0)))
    size, steps = power.max(axis=1), np.abs(np.diff(e, axis=0))
    quantum = float(np.min(steps, where=steps > 0.0, initial=np.inf))
    of_quantum = quantum**2 / 12.0 * float(np.square(taper).sum())
    floor = float(np.median(size[-int(settings.top * len(size)) :]))
    if not floor <= max(settings.rounding * float(size.max()), settings.quantum * of_quantum) < np.inf:
        return None
    moving = np.flatnonzero(size > max(settings.above * floor, settings.rounding * float(size.max())))
    if not moving.size or float(np.median(size[: moving[-1] + 1])) <= settings.lines * float(size.max()):
        return None  # lines alone
    top = float(moving[-1]) / (len(e) * dt)
    return top if top < settings.early * 0.5 / dt else None


def psd(error: ArrayLike, dt: float, segment: float = 4.0) -> Spectrum:
    """One-sided power spectral density by Welch's method (Hann window, half overlap, no detrending).

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt : sampling period [s]
    segment : length of a segment [s]; cut to the length of the run

    Raises
    ------
    ValueError
        Fewer than 8 samples, or no segment without a missing sample.

    Examples
    --------
    White noise of one unit rms per axis at 1 kHz has a density of 1 / 500 Hz:

    >>> white = np.random.default_rng(0).standard_normal((100_000, 2))
    >>> spectrum = psd(white, dt=1e-3, segment=0.1)
    >>> bool(np.allclose(spectrum.density[1:-1].mean(axis=0), 1 / 500, rtol=0.02))
    True
    """
    e = np.asarray(error, dtype=float)
    n = min(max(round(segment / dt), 8), len(e))
    if n < 8:
        raise InputError(f"error must have at least 8 samples for a spectrum, got {len(e)}")
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)  # Hann, periodic
    scale = 2 * dt / np.square(window).sum()
    density = np.zeros((n // 2 + 1, 2))
    used = skipped = 0
    for start in range(0, len(e) - n + 1, max(n // 2, 1)):
        piece = np.array(e[start : start + n])
        release()
        if np.isnan(piece).any():
            skipped += 1
            continue
        density += scale * np.square(np.abs(np.fft.rfft(piece * window[:, None], axis=0)))
        used += 1
    if not used:
        raise InputError(f"error must have a segment of {n * dt:g} s without missing samples for a spectrum, got none")
    density /= used
    density[0] /= 2
    if n % 2 == 0:
        density[-1] /= 2
    return Spectrum(read_only(np.fft.rfftfreq(n, dt)), read_only(density), used, skipped)


@dataclass(frozen=True)
class SpectralLine:
    """A disturbance line in the error.

    Attributes
    ----------
    omega : [rad/s]
    phasor : (2,) complex per axis, unit of the error; the line is the real part of phasor times exp(i omega t), t from
        the first sample
    rms : radial rms of the line
    rpe : radial RPE rms the line causes in windows of the stated length
    merged : number of given tones merged in this line (the run is too short to resolve them)
    found : for an unknown frequency: the line as found, with bounds
    """

    omega: float
    phasor: ComplexArray
    rms: float
    rpe: float
    merged: int = 1
    found: FoundLine | None = None

    @property
    def amplitude(self) -> FloatArray:
        """(2,) amplitude per axis, unit of the error."""
        return np.abs(self.phasor)


def _resolved(omegas: FloatArray, duration: float) -> list[FloatArray]:
    """Group tones closer than one period over the whole run."""
    groups: list[list[float]] = []
    for omega in np.sort(omegas):
        if groups and omega - groups[-1][0] < 2 * np.pi / duration:
            groups[-1].append(float(omega))
        else:
            groups.append([float(omega)])
    return [np.array(g) for g in groups]


def background(error: ArrayLike, dt: float, omegas: ArrayLike, phasors: ArrayLike) -> FloatArray:
    """Amplitude that a fit of a tone finds where there is none: noise and drift, rms, along and across the tone.

    From the medians over frequencies that lie two to seven whole periods in the run below and above the tone, where the
    tone itself adds nothing; their geometric mean. Along the tone is the component of the noise's phasors of both axes
    in the direction of the tone's, across is the other one: noise that acts on one axis does not disturb a tone on the
    other to first order.

    Parameters
    ----------
    error : (n, 2), rows with NaN count as zero
    dt : [s]
    omegas : (k,) frequencies of tones [rad/s]
    phasors : (k, 2) complex, of the tones on both axes, any scale; (k, 2) zeros count as a tone on the first axis

    Returns
    -------
    (k, 2) along and across, unit of the error; NaN for tones with less than 2.5 periods in the run, which have no such
    neighbours below

    Examples
    --------
    >>> noise = np.random.default_rng(4).standard_normal((10_000, 2)) * [1.0, 0.1]
    >>> along, across = background(noise, 1e-3, [500.0], [[1.0, 0.0]])[0] / np.sqrt(6 / 10_000)
    >>> bool(abs(along - 1) < 0.4), bool(abs(across - 0.1) < 0.04)
    (True, True)
    """
    e = np.asarray(error, dtype=float)
    tones = np.atleast_1d(np.asarray(omegas, dtype=float))
    along = _directions(np.asarray(phasors, dtype=complex).reshape(-1, 2))
    present = by_parts(lambda rows: ~np.isnan(rows).any(axis=1), e, dtype=bool)
    n = len(e)
    if n <= 2 * NEIGHBOURS[-1] or not present.any():
        return np.full((tones.size, 2), np.nan)
    offsets = 2 * np.pi / (dt * n) * np.concatenate([-NEIGHBOURS, NEIGHBOURS])
    spectra, weight = _transforms(e, dt, tones[:, None] + offsets, present)
    levels = np.full((tones.size, 2), np.nan)
    for i, omega in enumerate(tones):
        across = np.array([-along[i, 1], along[i, 0]])  # conjugate of the vector that is orthogonal to the tone's
        components = np.column_stack([spectra[i] @ along[i].conj(), spectra[i] @ across])
        lower, upper = np.split(np.square(2 * np.abs(components) / weight) / MEDIAN, 2)
        lower = lower[omega * n * dt / (2 * np.pi) - NEIGHBOURS > 0.5]
        if len(lower):
            levels[i] = np.power(np.median(lower, axis=0) * np.median(upper, axis=0), 0.25)
    return levels


def _transforms(e: FloatArray, dt: float, omegas: FloatArray, present: BoolArray) -> tuple[ComplexArray, float]:
    """Tapered transforms (k, m, 2) at frequencies (k, m), the mean removed, and the sum of the weights."""
    transforms, means = np.zeros((*omegas.shape, 2), complex), np.zeros(omegas.shape, complex)
    total, weight = np.zeros(2), 0.0
    for part in _fit_parts(len(e)):
        index = part.start + np.flatnonzero(present[part])
        w, rows = _taper(len(e), index), e[index]
        total += w @ rows
        weight += float(w.sum())
        for i, row in enumerate(omegas):
            turning = np.exp(np.outer(row, -1j * dt * index)) * w
            transforms[i] += turning @ rows
            means[i] += turning.sum(axis=1)
    transforms -= means[..., None] * (total / weight)
    return transforms, weight


def _directions(phasors: ComplexArray) -> ComplexArray:
    """Unit vectors along phasors (k, 2); the first axis for zeros."""
    size = linalg.norm(phasors, axis=1, keepdims=True)
    return np.asarray(np.where(size > 0.0, phasors / np.where(size > 0.0, size, 1.0), [1.0, 0.0]))


def _taper(n: int, rows: IntArray) -> FloatArray:
    """Hann weights of some of n rows."""
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * (rows + 1) / (n + 1)), dtype=np.float64)


def _fit_parts(rows: int) -> Iterator[slice]:
    """Parts of a fit, smaller than others: each row has as many columns as there are tones."""
    for part in parts(rows):
        for begin in range(part.start, part.stop, FITTED):
            yield slice(begin, min(begin + FITTED, part.stop))


def exceeds(error: ArrayLike, rest: ArrayLike, powers: Sequence[float], dt: float, window: float) -> bool:
    """Whether tones and what they leave of a record are together larger than the record, by more than `LEAK`.

    Parameters
    ----------
    error, rest : (n, 2), NaN where a sample is missing
    powers : mean square in windows of each tone, unit of the error squared
    dt, window : [s]

    Returns
    -------
    False also for a record with fewer than `FEWEST` windows

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal((1000, 2))
    >>> exceeds(noise, noise, [0.01], 1e-3, 0.02), exceeds(noise, noise, [1.0], 1e-3, 0.02)
    (False, True)
    """
    if not metrics.holds(window, dt) or dt * len(np.asarray(error)) < FEWEST * window:
        return False
    whole, left = (float(np.square(metrics.rpe_rms(one, dt, window)).sum()) for one in (error, rest))
    return left + sum(powers) > LEAK**2 * whole


def lines(error: ArrayLike, dt: float, omegas: ArrayLike, window: float) -> tuple[SpectralLine, ...]:
    """Least-squares amplitudes of known tones in the error, and the RPE each causes.

    All tones are fitted together with a constant, with Hann weights: a drift or a pulse stays out of them. Tones that
    the run is too short to tell apart are fitted as one.

    Parameters
    ----------
    error : (n, 2), rows with NaN are left out
    dt : [s]
    omegas : tone frequencies [rad/s]; those beyond the Nyquist frequency or slower than one period in the run are
        left out
    window : RPE window [s]

    Returns
    -------
    Lines, largest RPE first

    Examples
    --------
    >>> t = 1e-3 * np.arange(5000)
    >>> tone = np.column_stack([3 * np.sin(100 * t + 1), np.zeros(5000)])
    >>> lines(tone, 1e-3, [100.0], window=0.02)[0].amplitude.round(9)
    array([3., 0.])
    """
    e = np.asarray(error, dtype=float)
    duration = dt * len(e)
    tones = np.atleast_1d(np.asarray(omegas, dtype=float))
    tones = tones[np.isfinite(tones) & (tones * duration > 2 * np.pi) & (tones < np.pi / dt)]
    present = by_parts(lambda rows: ~np.isnan(rows).any(axis=1), e, dtype=bool)
    groups = _resolved(np.unique(tones), duration)
    if not groups or present.sum() < 4 * len(groups) + 2:
        return ()
    centre = np.array([g.mean() for g in groups])
    k = 2 * len(centre) + 1
    gram, right = np.zeros((k, k)), np.zeros((k, 2))
    for part in _fit_parts(len(e)):
        index = part.start + np.flatnonzero(present[part])
        angle = np.outer(index * dt, centre)
        basis = np.hstack([np.ones((index.size, 1)), np.cos(angle), np.sin(angle)])
        weighted = basis.T * _taper(len(e), index)
        gram += weighted @ basis
        right += weighted @ e[index]
    # Constant, cosines, sines
    solution = np.asarray(linalg.lstsq(gram, right)[0])
    m = len(centre)
    phasor = solution[1 : m + 1] - 1j * solution[m + 1 :]
    rms = linalg.norm(phasor, axis=1) / np.sqrt(2)
    rpe = rms * weights.rpe_discrete(centre, metrics.samples_or_one(window, dt), dt)
    order = np.argsort(-rpe, kind="stable")
    return tuple(
        SpectralLine(float(centre[i]), read_only(phasor[i].copy()), float(rms[i]), float(rpe[i]), len(groups[i]))
        for i in order
    )


def above_noise(
    fitted: Sequence[SpectralLine], error: ArrayLike, dt: float
) -> tuple[tuple[SpectralLine, ...], tuple[SpectralLine, ...]]:
    """Known lines that are above the noise beside them, by `CLEAR`, and those that are not.

    Parameters
    ----------
    fitted : by `lines`; one with less than 2.5 periods in the run, whose noise is not known, counts as above
    error : (n, 2), rows with NaN are left out
    dt : [s]

    Examples
    --------
    >>> noise = np.random.default_rng(4).standard_normal((5000, 2))
    >>> tone = np.sin(0.1 * np.arange(5000))[:, None] + noise
    >>> above, within = above_noise(lines(tone, 1e-3, [100.0, 200.0], window=0.02), tone, 1e-3)
    >>> [line.omega for line in above], [line.omega for line in within]
    ([100.0], [200.0])
    """
    omegas, phasors = [line.omega for line in fitted], [line.phasor for line in fitted]
    noise = background(without_lines(error, dt, fitted), dt, omegas, phasors)
    sizes = np.array([linalg.norm(line.phasor) for line in fitted])
    within = sizes < CLEAR * np.hypot(*noise.T)
    return tuple(itertools.compress(fitted, np.logical_not(within))), tuple(itertools.compress(fitted, within))


def found_lines(
    found: Sequence[FoundLine], known: Sequence[SpectralLine], run: float, window: float, dt: float
) -> tuple[SpectralLine, ...]:
    """Lines that were found, with the RPE each causes, beside those that are known.

    Parameters
    ----------
    found : lines of the spectrum; one that the run is too short to tell from a known line is left out
    known : lines at frequencies that are given
    run : length of the run [s]
    window : RPE window [s]
    dt : [s]
    """
    apart = 2 * np.pi / run
    new = [line for line in found if all(abs(line.omega - other.omega) >= apart for other in known)]
    if not new:
        return ()
    weight = weights.rpe_discrete(np.array([line.omega for line in new]), metrics.samples_or_one(window, dt), dt)
    rms = [float(np.sqrt(line.power)) for line in new]
    return tuple(
        SpectralLine(line.omega, read_only(line.phasor * _turned(line, run, dt)), r, float(r * w), found=line)
        for line, r, w in zip(new, rms, weight)
    )


def _turned(line: FoundLine, run: float, dt: float) -> complex:
    """Factor from the phasor in the middle of a run [s] to that at its first sample."""
    return complex(np.exp(-0.5j * line.omega * (run - dt)))


def without_lines(error: ArrayLike, dt: float, fitted: Sequence[SpectralLine]) -> FloatArray:
    """The error without some of its lines: noise and what else there is.

    Parameters
    ----------
    error : (n, 2), rows with NaN stay NaN
    dt : [s]
    fitted : by `lines`

    Examples
    --------
    >>> t = 1e-3 * np.arange(5000)
    >>> tone = np.column_stack([3 * np.sin(100 * t + 1), np.cos(4 * t)])
    >>> bool(np.abs(without_lines(tone, 1e-3, lines(tone, 1e-3, [100.0, 4.0], window=0.02))).max() < 1e-9)
    True
    """
    e = np.asarray(error, dtype=float)
    omegas, phasors = np.array([line.omega for line in fitted]), np.array([line.phasor for line in fitted])
    rest = empty(e.shape)
    for part in _fit_parts(len(e)):
        angle = np.outer(dt * np.arange(part.start, part.stop), omegas)
        rest[part] = e[part] - (np.exp(1j * angle) @ phasors.reshape(-1, 2)).real
    return rest
