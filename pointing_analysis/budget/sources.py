r"""Error sources of a pointing budget: what each one contributes to an index, as a distribution and as sigma.

A source is drawn at a random instant: `ErrorSource.draw` gives its error at n instants, for the APE as it is, for the
RPE less its mean over the window in which the instant has the position u (0 to 1, uniform). So all sources of a budget
share one window, and the total is the distribution of their sum, with no assumption about its shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.errors import InputError
from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.indices import metrics, weights
from pointing_analysis.indices.window_rows import ROUNDING, window_rows, window_starts

Draw = Callable[[np.random.Generator, FloatArray, float | None], FloatArray]
Sigma = Callable[[float | None], FloatArray]
POSITIONS = 40
"""Equal parts of a window, for each of which a random process has a covariance: the mean over the part."""
TIME, ENSEMBLE = "time", "ensemble"


@dataclass(frozen=True, eq=False)
class ErrorSource:
    """One error source, after its transfer; each is equal to itself alone.

    Attributes
    ----------
    path : names from the root of the tree to the source
    kind : type of the source
    random : ``time`` or ``ensemble``: over which it varies
    mean : (k,) known constant part; no part of the RPE
    draw : (generator, positions (n,), window or None for the APE) -> errors (n, k), without the mean
    sigma : window or None -> standard deviations (k,)
    worst : window or None -> largest magnitudes (k,); infinite where the distribution has no bound
    """

    path: tuple[str, ...]
    kind: str
    random: str
    mean: FloatArray
    draw: Draw
    sigma: Sigma
    worst: Sigma

    @property
    def name(self) -> str:
        """Path as text."""
        return " / ".join(self.path)

    def scaled(self, gain: float) -> ErrorSource:
        """The source behind a constant gain, which may be negative."""
        draw, sigma, worst = self.draw, self.sigma, self.worst
        return replace(
            self,
            mean=gain * self.mean + 0.0,  # no -0
            draw=lambda rng, u, window: gain * draw(rng, u, window),
            sigma=lambda window: abs(gain) * sigma(window),
            worst=lambda window: abs(gain) * worst(window),
        )


def constant(
    path: tuple[str, ...], mean: ArrayLike, half_range: ArrayLike, sigma: ArrayLike, random: str = ENSEMBLE
) -> ErrorSource:
    """Error that is constant in time: known (`mean`), uniform within `half_range`, Gaussian with `sigma`."""
    m, h, s = (np.asarray(x, dtype=float) for x in (mean, half_range, sigma))
    spread = np.sqrt(h**2 / 3 + s**2)
    zero = np.zeros(m.size)

    def draw(rng: np.random.Generator, u: FloatArray, window: float | None) -> FloatArray:
        shape = u.size, m.size
        if window is not None:
            return np.zeros(shape)
        return np.asarray(rng.uniform(-1, 1, shape) * h + rng.standard_normal(shape) * s)

    def largest(window: float | None) -> FloatArray:
        return zero if window is not None else np.where(s > 0, np.inf, h)

    return ErrorSource(path, "constant", random, m, draw, lambda w: zero if w is not None else spread, largest)


def tones(path: tuple[str, ...], omega: ArrayLike, phasor: ArrayLike, dt: float | None = None) -> ErrorSource:
    """Sum of tones of unknown phase.

    Parameters
    ----------
    path : of the source
    omega : (q,) frequencies [rad/s]
    phasor : (k, q) complex amplitudes; the angle between axes is kept
    dt : sampling period [s] of the windows; None for continuous windows
    """
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    p = np.asarray(phasor, dtype=complex).reshape(-1, w.size)

    def draw(rng: np.random.Generator, u: FloatArray, window: float | None) -> FloatArray:
        total = np.zeros((u.size, len(p)))
        for one, amplitudes in zip(w, p.T):
            turning = np.exp(1j * rng.uniform(0, 2 * np.pi, u.size))
            if window is not None:
                turning = turning * _relative(one, u, window, dt)
            total += (turning[:, None] * amplitudes).imag
        return total

    def weight(window: float | None) -> FloatArray:
        if window is None:
            return np.ones(w.size)
        if dt is None:
            return weights.rpe_exact(w, window)
        return weights.rpe_discrete(w, metrics.samples_or_one(window, dt), dt)

    def sigma(window: float | None) -> FloatArray:
        return np.asarray(np.sqrt((np.abs(p * weight(window)) ** 2).sum(axis=1) / 2))

    def largest(window: float | None) -> FloatArray:
        peaks: FloatArray = np.ones(w.size)
        if window is not None:
            u: FloatArray = np.arange(POSITIONS) / POSITIONS
            peaks = np.array([np.abs(_relative(one, u, window, dt)).max() for one in w])
        return np.asarray((np.abs(p) * peaks).sum(axis=1))

    return ErrorSource(path, "tones", TIME, np.zeros(len(p)), draw, sigma, largest)


def _relative(omega: float, u: FloatArray, window: float, dt: float | None) -> ComplexArray:
    """Factor of a tone less its mean over the window in which its instant has the position u."""
    if dt is None:
        y = omega * window
        mean = np.sinc(y / (2 * np.pi)) * np.exp(1j * y * (0.5 - u))
    else:
        n = metrics.samples_or_one(window, dt)
        starts = window_starts(n)
        index, weight = window_rows(starts, n)
        means = (weight * np.exp(1j * omega * dt * index)).sum(axis=1) / n
        number = np.minimum((u * len(starts)).astype(int), len(starts) - 1)
        j = np.floor(starts[number] + (u * len(starts) - number) * n)
        mean = means[number] * np.exp(-1j * omega * dt * j)
    return np.asarray(1 - mean)


def gaussian(
    path: tuple[str, ...], covariance: FloatArray, within: Callable[[float], FloatArray], kind: str
) -> ErrorSource:
    """Gaussian process.

    Parameters
    ----------
    path : of the source
    covariance : (k, k) of the process
    within : window -> (positions, k, k) covariance of the process less its mean over the window, at each position
    kind : type of the source
    """
    k = len(covariance)

    def draw(rng: np.random.Generator, u: FloatArray, window: float | None) -> FloatArray:
        white = rng.standard_normal((u.size, k))
        if window is None:
            return np.asarray(white @ _root(covariance))
        table = within(window)
        roots = np.stack([_root(c) for c in table])
        return np.asarray(np.einsum("ni,nij->nj", white, roots[np.floor(u * len(table)).astype(int)]))

    def sigma(window: float | None) -> FloatArray:
        matrix = covariance if window is None else within(window).mean(axis=0)
        return np.asarray(np.sqrt(np.maximum(np.diag(matrix), 0)))

    def largest(window: float | None) -> FloatArray:
        return np.where(sigma(window) > 0, np.inf, 0.0)

    return ErrorSource(path, kind, TIME, np.zeros(k), draw, sigma, largest)


def _root(matrix: FloatArray) -> FloatArray:
    """Symmetric square root of a covariance."""
    values, vectors = linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)


def spectrum(path: tuple[str, ...], hertz: FloatArray, power: FloatArray) -> ErrorSource:
    r"""Gaussian process with independent axes, from its power at many frequencies.

    Parameters
    ----------
    path : of the source
    hertz : (m,) frequencies [Hz], in steps that are small against themselves
    power : (m, k) mean square of each axis at each frequency

    Notes
    -----
    At the position u of a window T the share of the power at f that is left is
    :math:`|1 - s e^{2\pi i f T (1/2 - u)}|^2` with :math:`s = \sin(\pi f T) / (\pi f T)`. Its mean over a
    part of the window is a closed form, and over the whole window :math:`1 - s^2`, at any frequency.
    """

    def within(window: float) -> FloatArray:
        turns = hertz * window
        u = (np.arange(POSITIONS) + 0.5) / POSITIONS
        # 1 - s and 1 - cos lose their digits at low frequencies, where a drifting process has most of its power.
        off, off_part = _one_less_sinc(turns), _one_less_sinc(turns / POSITIONS)
        off_cosine = off_part + (1 - off_part) * 2 * np.sin(np.pi * np.outer(0.5 - u, turns)) ** 2
        left = off**2 + 2 * (1 - off) * off_cosine
        return np.stack([np.diag(v) for v in np.maximum(left @ power, 0)])

    return gaussian(path, np.diag(power.sum(axis=0)), within, "spectrum")


def _one_less_sinc(turns: FloatArray) -> FloatArray:
    """1 - sin(pi x) / (pi x) with all its digits."""
    square = (np.pi * turns) ** 2
    return np.asarray(np.where(square < 1e-2, square / 6 * (1 - square / 20 * (1 - square / 42)), 1 - np.sinc(turns)))


def correlated(path: tuple[str, ...], sigma: ArrayLike, time: float) -> ErrorSource:
    r"""Gaussian process with independent axes and the autocovariance :math:`\sigma^2 e^{-|\tau| / T_c}`.

    Parameters
    ----------
    path : of the source
    sigma : (k,) standard deviations
    time : correlation time [s]
    """
    variance = np.square(np.asarray(sigma, dtype=float))

    def within(window: float) -> FloatArray:
        lost = _decorrelation(window / time)
        return np.stack([np.diag(v) for v in (2 * lost - lost.mean())[:, None] * variance])

    return gaussian(path, np.diag(variance), within, "random")


def _decorrelation(x: float) -> FloatArray:
    """Mean of 1 - exp(-x |u - v|) over u in each part of a window and v in the whole of it, 0 to 1."""
    ends: FloatArray = np.arange(POSITIONS + 1) / POSITIONS
    if x > 0.1:
        half = 0.5 - (1 + np.exp(-x * ends[:-1]) * math.expm1(-x / POSITIONS) * POSITIONS / x) / x
    else:  # where the closed form loses its digits
        terms = [-((-x) ** n) / math.factorial(n + 2) * np.diff(ends ** (n + 2)) for n in range(1, 10)]
        half = POSITIONS * np.sum(terms, axis=0)
    return np.asarray(half + half[::-1])


def white(path: tuple[str, ...], sigma: ArrayLike) -> ErrorSource:
    """Gaussian noise that is independent from instant to instant; its mean over a window is zero."""
    matrix = np.diag(np.square(np.asarray(sigma, dtype=float)))
    return gaussian(path, matrix, lambda window: matrix[None], "random")


def drift(path: tuple[str, ...], rate: ArrayLike, duration: float) -> ErrorSource:
    """Linear drift from zero over `duration` [s], at `rate` [unit/s], instant unknown."""
    r = np.asarray(rate, dtype=float)

    def draw(rng: np.random.Generator, u: FloatArray, window: float | None) -> FloatArray:
        along = duration * (rng.uniform(0, 1, u.size) - 0.5) if window is None else window * (u - 0.5)
        return np.asarray(along[:, None] * r)

    def length(window: float | None) -> float:
        return duration if window is None else window

    return ErrorSource(
        path,
        "drift",
        TIME,
        r * duration / 2,
        draw,
        lambda window: np.abs(r) * length(window) / math.sqrt(12),
        lambda window: np.abs(r) * length(window) / 2,
    )


def measured(path: tuple[str, ...], error: FloatArray, dt: float) -> ErrorSource:
    """Recorded error (n, 2): its mean, and its own samples as the distribution of the rest.

    For the RPE the recording must have one window without gaps; else a ValueError names the source when the budget is
    evaluated. A window need not be a whole number of samples: each sample stands for its period.
    """
    mean = np.nanmean(error, axis=0)
    present = error[~np.isnan(error).any(axis=1)] - mean

    def complete(window: float) -> metrics.Windows:
        try:
            windows = metrics.windows(error, dt, window)
        except ValueError as wrong:
            raise InputError(f"{' / '.join(path)}: {wrong}") from None
        if not len(windows.start):
            raise InputError(f"{' / '.join(path)}: recording must have whole windows of {window:g} s, got none")
        return windows

    def draw(rng: np.random.Generator, u: FloatArray, window: float | None) -> FloatArray:
        if window is None:
            return np.asarray(present[rng.integers(0, len(present), u.size)])
        windows = complete(window)
        chosen = rng.integers(0, len(windows.start), u.size)
        begin = windows.begin[chosen]
        last = np.ceil(begin + windows.samples - ROUNDING) - 1.0
        at = np.minimum(np.floor(begin + u * windows.samples), last).astype(np.int64)
        return np.asarray(error[at] - windows.mean[chosen])

    def sigma(window: float | None) -> FloatArray:
        return np.asarray(present.std(axis=0) if window is None else complete(window).rpe_rms)

    def largest(window: float | None) -> FloatArray:
        if window is None:
            return np.asarray(np.abs(present).max(axis=0))
        windows = complete(window)
        index, weight = window_rows(windows.begin, windows.samples)
        rest = error[np.minimum(index, len(error) - 1)] - windows.mean[:, None, :]
        return np.asarray(np.abs(np.where(weight[..., None] > 0.0, rest, 0.0)).max(axis=(0, 1)))

    return ErrorSource(path, "measured", TIME, mean, draw, sigma, largest)
