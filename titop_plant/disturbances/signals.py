"""Wrench of a source over time: forces and torques (6) at the requested instants inside each tick.

A source is a function of time and of its seed alone: `Signal.tick` is bit-identical in any order of calls, so that a
run in one process, in lockstep and in real time has the same values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Protocol

import numpy as np
from scipy import fft, special

from lftkit.arrays import ComplexArray, FloatArray

ATTENUATION = 140.0
"""Of what the resampling filter stops [dB]."""
PASSES, STOPS = 400.0, 500.0
"""Edges of the resampling filter [Hz]: half of the tick rate is the upper one."""
PHASES_KEPT = 20_000
"""Weights of the filter that are kept, one set for each position of an instant between two samples."""
OTHER_STEP = 1.5
"""A step, or a bend, from the end of a record to its beginning that is so many times the largest one in it is none of
its own. It is not 1: of tones with eight samples in a period the largest one may be there."""
FEWEST_MEANS = 8
"""Means of a record that are compared with the one across its ends; fewer do not tell what is usual in it."""
NOISE_SECONDS = 600.0
"""Longest stretch of noise that is made; a longer run has it again."""


class Signal(Protocol):
    """Forces and torques of a source."""

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values (q, 6) [N, Nm] at the `instants` (q,) of tick k, parts of a tick."""

    @property
    def lines(self) -> FloatArray:
        """Frequencies [rad/s] of what are tones; empty where none is."""


NO_LINES = np.zeros(0)


@dataclass(frozen=True)
class ToneSignal:
    """Tones of constant amplitude.

    Parameters
    ----------
    frequency : ndarray, shape (q,)
        rad/s.
    amplitude : ndarray, shape (q, 6), complex
        N, Nm; the value is the imaginary part of ``amplitude exp(i frequency t)``.
    dt : float
        Tick [s].
    """

    frequency: FloatArray
    amplitude: ComplexArray
    dt: float

    @property
    def lines(self) -> FloatArray:
        """Frequencies of the tones."""
        return self.frequency

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        whole = np.multiply.outer(np.fmod(k * self.dt * self.frequency, 2 * np.pi), np.ones(instants.size))
        angle = whole + np.multiply.outer(self.frequency * self.dt, instants)
        return np.asarray((np.exp(1j * angle).T @ self.amplitude).imag)


@dataclass(frozen=True)
class _Parts:
    """Several signals at a time."""

    parts: tuple[Signal, ...]

    @property
    def lines(self) -> FloatArray:
        """Frequencies of all tones."""
        return np.asarray(np.unique(np.concatenate([part.lines for part in self.parts])))


@dataclass(frozen=True)
class JointSignal(_Parts):
    """Signals of a source that acts at several places, side by side: six axes of each.

    Parameters
    ----------
    parts : tuple of Signal
    """

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick, (q, 6 parts)."""
        return np.hstack([part.tick(k, instants) for part in self.parts])


@dataclass(frozen=True)
class SumSignal(_Parts):
    """Sum of signals at one place.

    Parameters
    ----------
    parts : tuple of Signal
    """

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        return np.asarray(sum(part.tick(k, instants) for part in self.parts))


@dataclass(frozen=True)
class PulseSignal:
    """Rectangular pulses; a tick has the mean of its part of the pulse, so that the impulse is right.

    Parameters
    ----------
    wrench : ndarray, shape (6,)
        N, Nm.
    first, width, period : float
        Of the pulses [s].
    last : float
        No pulse begins after this time [s].
    dt : float
        Tick [s].
    """

    wrench: FloatArray
    first: float
    width: float
    period: float
    last: float
    dt: float

    lines = NO_LINES

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        share = (self._on_until((k + 1) * self.dt) - self._on_until(k * self.dt)) / self.dt
        return np.asarray(np.ones((instants.size, 1)) * (share * self.wrench))

    def _on_until(self, time: float) -> float:
        """Seconds with force up to a time."""
        since = time - self.first
        if since <= 0.0:
            return 0.0
        count = math.floor(since / self.period + 1e-12)
        most = math.floor((self.last - self.first) / self.period + 1e-12) + 1 if math.isfinite(self.last) else count + 1
        if count >= most:
            return most * self.width
        return count * self.width + min(since - count * self.period, self.width)


@dataclass(frozen=True)
class SampledSignal:
    """A uniformly sampled series, periodic, between its samples by a band-limited filter (Kaiser window).

    What is below `PASSES` (of a slow series 0.8 times half of its rate) is passed to 1e-6, what is above `STOPS` (or
    half of its rate) and all images are stopped: nothing folds back at the ticks.

    Parameters
    ----------
    values : ndarray, shape (n, 6)
        N, Nm.
    rate : float
        Of the samples [Hz].
    dt : float
        Tick [s].
    """

    values: FloatArray
    rate: float
    dt: float
    _weights: dict[tuple[int, bytes], FloatArray] = field(default_factory=dict, repr=False, compare=False)

    lines = NO_LINES

    @property
    def edges(self) -> tuple[float, float]:
        """Pass band and stop band [Hz]."""
        half = 0.5 * self.rate
        return (PASSES, STOPS) if half >= STOPS else (0.8 * half, 1.2 * half)

    @property
    def reach(self) -> int:
        """Samples on each side of an instant that have a weight."""
        low, high = self.edges
        return math.ceil((ATTENUATION - 7.95) / (14.36 * (high - low) / self.rate) / 2) + 1

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        step = Fraction(self.rate * self.dt).limit_denominator(PHASES_KEPT)
        exact = abs(float(step) - self.rate * self.dt) * max(k, 1) < 1e-9
        if exact:
            whole, part = divmod(k * step.numerator, step.denominator)
            begin = part / step.denominator
        else:
            position = k * self.rate * self.dt
            whole, part = math.floor(position), -1
            begin = position - whole
        key = (part, instants.tobytes())
        weights = self._weights.get(key) if exact else None
        if weights is None:
            weights = self._kernel(begin + instants * self.rate * self.dt)
            if exact:
                self._weights[key] = weights
        rows = (whole - self.reach + np.arange(weights.shape[1])) % len(self.values)
        return np.asarray(weights @ self.values[rows])

    def _kernel(self, position: FloatArray) -> FloatArray:
        """Weights (q, 2 reach + 1 + span) of the samples from `reach` before to as many behind the instants."""
        reach, (low, high) = self.reach, self.edges
        span = math.ceil(float(position.max())) + 1
        distance = position[:, None] - (np.arange(2 * reach + span) - reach)
        cutoff = (low + high) / self.rate  # in units of half of the rate
        beta = 0.1102 * (ATTENUATION - 8.7)
        inside = np.clip(1.0 - (distance / reach) ** 2, 0.0, None)
        window = special.i0(beta * np.sqrt(inside)) / special.i0(beta) * (np.abs(distance) < reach)
        return np.asarray(cutoff * np.sinc(cutoff * distance) * window)


def closes(values: FloatArray) -> bool:
    """Whether the beginning of a record continues its end: steps and bends there are as those in it, also of its means.

    So it is for a record of whole periods, and for noise without drift. In noise with a drift the step from the end to
    the beginning is one of means over many samples, which are compared over 4, 16, 64 ... of them.

    Examples
    --------
    >>> t = np.arange(1000)[:, None] / 1000
    >>> closes(np.sin(2 * np.pi * 5.0 * t)), closes(np.sin(2 * np.pi * 5.3 * t)), closes(t)
    (True, False, False)
    """
    joint = np.vstack([values[-2:], values[:2]])
    for order in (1, 2):
        inside, across = (np.abs(np.diff(one, order, axis=0)) for one in (values, joint))
        if len(inside) and (across.max(axis=0) > inside.max(axis=0) * OTHER_STEP).any():
            return False
    length = 4
    while len(values) >= FEWEST_MEANS * length:
        count = len(values) // length
        means = values[: count * length].reshape(count, length, -1).mean(axis=1)
        across = np.abs(values[-length:].mean(axis=0) - means[0])
        if (across > np.abs(np.diff(means, axis=0)).max(axis=0) * OTHER_STEP).any():
            return False
        length *= 4
    return True


def repeated(values: FloatArray, rate: float, fade: float = 0.5) -> FloatArray:
    """A record that can be repeated: as it is where it :func:`closes`.

    Of another its end runs into its beginning over `fade` [s], at most a quarter of it, with constant power: it is so
    much shorter then, and its tones are not those of the record there.
    """
    n = min(round(fade * rate), len(values) // 4)
    if n < 1 or closes(values):
        return values
    turn = 0.5 * np.pi * (np.arange(n) + 0.5)[:, None] / n
    kept = values[: len(values) - n].copy()
    kept[:n] = np.sin(turn) * values[:n] + np.cos(turn) * values[-n:]
    return kept


def noise_of_density(
    frequency: FloatArray, density: FloatArray, seconds: float, dt: float, rng: np.random.Generator
) -> SampledSignal:
    """Gaussian noise of a one-sided power spectral density, interpolated between its points on logarithmic axes.

    From a first point at 0 Hz, which has no place on such axes, it is interpolated on linear ones, so that the power
    does not depend on the length of the run.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        Hz, ascending; below the first and above the last one, and above `PASSES`, the density is 0.
    density : ndarray, shape (f, 6)
        N^2/Hz, Nm^2/Hz; the axes are independent.
    seconds : float
        Length of the run.
    dt : float
        Tick [s].
    rng : numpy.random.Generator
    """
    rate = 2.0 / dt
    n = fft.next_fast_len(math.ceil(min(seconds + 2.0, NOISE_SECONDS) * rate), real=True)
    grid = np.arange(n // 2 + 1) * rate / n
    values = np.zeros((n, 6))
    inside = (grid >= frequency[0]) & (grid <= min(frequency[-1], PASSES)) & (grid > 0)
    for axis in np.flatnonzero(density.any(axis=0)):
        level = _interpolated(grid[inside], frequency, density[:, axis])
        spectrum = np.zeros(grid.size, complex)
        normal = rng.standard_normal((2, level.size))
        spectrum[inside] = np.sqrt(level * rate * n / 4.0) * (normal[0] + 1j * normal[1])
        values[:, axis] = fft.irfft(spectrum, n)
    return SampledSignal(values, rate, dt)


def _interpolated(points: FloatArray, frequency: FloatArray, density: FloatArray) -> FloatArray:
    """Density at positive frequencies: logarithmic axes, linear ones from a first frequency of 0 to the next."""
    positive = frequency > 0.0
    with np.errstate(divide="ignore"):
        logarithmic = np.interp(np.log(points), np.log(frequency[positive]), np.log(density[positive]))
    level = np.exp(logarithmic)
    if not positive[0]:
        low = points < frequency[1]
        level[low] = np.interp(points[low], frequency[:2], density[:2])
    return np.asarray(level)


def tone_signal(rows: Sequence[tuple[float, float, ComplexArray]], dt: float) -> ToneSignal:
    """Tones from rows of order, frequency [rad/s] and amplitudes (6,)."""
    _, frequency, amplitude = (np.array(x) for x in zip(*rows))
    return ToneSignal(frequency.astype(float), amplitude.astype(complex), dt)
