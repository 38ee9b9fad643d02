r"""ECSS pointing error indices of a sampled line of sight.

Definitions of ECSS-E-ST-60-10C section 3.2 and ESSB-HB-E-003. With the error :math:`e(t)` (a 2-vector: rotation of the
line of sight about the two transverse axes) and the mean :math:`\bar e` over a window of length :math:`\Delta t`:

=====  ==============================================  ==========================================================
index  value                                           meaning
=====  ==============================================  ==========================================================
APE    :math:`e(t)`                                    absolute performance error
MPE    :math:`\bar e`                                  mean performance error
RPE    :math:`e(t) - \bar e`, t in the window          relative performance error (jitter in an exposure)
PDE    :math:`\bar e(t + \Delta t_s) - \bar e(t)`      performance drift error: two windows of one observation
PRE    :math:`\bar e_1 - \bar e_2`                     performance reproducibility error: windows of two observations
=====  ==============================================  ==========================================================

AKE, MKE, RKE are the same on the knowledge error (estimate minus truth).

Everything is done **on the 2-vector, and the norm is taken last**: a circular motion of constant radius has zero RPE in
the norm and smears the picture all the same. Two estimators of the RPE exist and both are here:

*window* estimator
    per axis :math:`v = \overline{e^2} - \bar e^2` of each disjoint window (division by N); rms is
    :math:`\sqrt{\bar v}`. This one corresponds to the spectral weight of `weights`.
*instant* estimator
    the samples of :math:`e(t) - \bar e` themselves, for quantiles. By default t runs through every instant of disjoint
    windows, so that the mean square equals that of the window estimator. A t fixed in its (sliding) window is another
    quantity: at the end slow motion counts :math:`\sqrt 3` times, **at the centre it nearly vanishes** (the weight of a
    tone is :math:`1 - \mathrm{sinc}`; at 14 Hz and 20 ms a quarter of the rms weight), so a quantile formed there may
    lie below the rms.

Missing samples are NaN in the input. A window that holds one is left out and counted; nothing is interpolated.

A window may be any number N of samples, two or more. Where N is no whole number each sample stands for its period, and
samples at the edges of a window count by their fraction (`pointing_analysis.indices.window_rows`); an instant belongs
to the window that holds the middle of its period.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lftkit.errors import InputError
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.indices.window_rows import ROUNDING, sliding_means, windows_of
from pointing_analysis.read.mapped_arrays import PART, GrowingArray, by_parts, empty, release
from pointing_analysis.read.topic import read_only

Position = Literal["all", "centred", "end"]
AXES = ("x", "y")
ROUNDED = 1e-3
"""Part of a sample by which a window may miss a whole number of them."""
HALF_NANOSECOND = 0.5e-9
"""[s] By which a period of whole nanoseconds may miss the true one."""


def radial(error: ArrayLike) -> FloatArray:
    """Norm of the 2-vector: (n, 2) -> (n,), same unit."""
    e = _series(error)
    return by_parts(lambda rows: np.hypot(rows[:, 0], rows[:, 1]), e)


def rms(values: ArrayLike) -> FloatArray:
    """Root mean square per axis, NaN left out: (n, 2) -> (2,), same unit. The radial one is its norm."""
    return np.asarray(np.sqrt(np.nanmean(np.square(_series(values)), axis=0)))


def samples_in(window: float, dt: float) -> float:
    """Number of samples N in a window, whole or not.

    Raises
    ------
    ValueError
        Less than two.
    """
    if is_whole(window, dt):
        return round(window / dt)
    if not holds(window, dt):
        raise InputError(f"window must last for two samples of {1e3 * dt:g} ms or more, got {1e3 * window:g} ms")
    return window / dt


def holds(window: float, dt: float) -> bool:
    """Whether a window [s] has two or more samples of `dt` [s]."""
    return is_whole(window, dt) or (dt > 0 and 2.0 <= window / dt < np.inf)


def samples_or_one(window: float, dt: float) -> float:
    """Number of samples N in a window, at least one: of a shorter window the sample is its own mean."""
    return samples_in(window, dt) if holds(window, dt) else 1


def window_samples(window: float, dt: float) -> int:
    """Number of samples N in a window, where a whole number is needed, as of the exposures of an image.

    Raises
    ------
    ValueError
        The window is not a whole number of at least two samples.
    """
    if not is_whole(window, dt):
        raise InputError(
            f"window must be a whole number (two or more) of samples of {1e3 * dt:g} ms, got {1e3 * window:g} ms"
        )
    return round(window / dt)


def is_whole(window: float, dt: float) -> bool:
    """Whether a window [s] is a whole number, two or more, of samples of `dt` [s].

    A period comes from stamps of whole nanoseconds and may be off by half of one: for 1 s at 3 kHz 0.0045 samples.

    Examples
    --------
    >>> is_whole(1.0, 333_333e-9), is_whole(1.0001, 333_333e-9), is_whole(0.1, 166_667e-9)
    (True, False, True)
    """
    ratio = window / dt if dt > 0 else float("nan")
    if not np.isfinite(ratio) or round(ratio) < 2:
        return False
    return bool(abs(ratio - round(ratio)) <= max(ROUNDED, ratio * HALF_NANOSECOND / dt))


def _series(error: ArrayLike) -> FloatArray:
    e = np.asarray(error, dtype=float)
    if e.ndim != 2 or e.shape[1] != 2:
        raise InputError(f"error must have the shape (n, 2), got {e.shape}")
    return e


def _fits(e: FloatArray, window: float, dt: float) -> float:
    n = samples_in(window, dt)
    if n > len(e) + ROUNDED:
        raise InputError(f"the run must be at least as long as the window of {window:g} s, got {len(e) * dt:g} s")
    return n


@dataclass(frozen=True)
class Windows:
    """Disjoint windows of an error series.

    Attributes
    ----------
    mean : (m, 2) mean error of each complete window (the samples of the MPE)
    variance : (m, 2) mean square about that mean, division by N
    start : (m,) index of the first sample of each window
    begin : (m,) begin of each window [periods]
    samples : N, samples per window; a whole number, or not
    skipped : windows left out because a sample is missing
    """

    mean: FloatArray
    variance: FloatArray
    start: IntArray
    begin: FloatArray
    samples: float
    skipped: int

    @property
    def rpe_rms(self) -> FloatArray:
        """(2,) RPE rms per axis by the window estimator; the radial one is its norm."""
        return np.asarray(np.sqrt(self.variance.mean(axis=0))) if len(self.variance) else np.full(2, np.nan)

    def in_order(self, values: FloatArray) -> FloatArray:
        """Values (m, k) of the complete windows at the places of these among all windows, NaN at the others."""
        every = np.full((len(self.mean) + self.skipped, *values.shape[1:]), np.nan)
        every[np.rint(self.begin / self.samples).astype(np.int64)] = values
        return every


def windows(error: ArrayLike, dt: float, window: float) -> Windows:
    r"""Cut the series into disjoint windows; an incomplete one at the end is dropped.

    Parameters
    ----------
    error : (n, 2) error, NaN where a sample is missing
    dt : sampling period [s]
    window : window length [s]

    Raises
    ------
    ValueError
        The window is longer than the run or shorter than two samples.

    Examples
    --------
    A circular motion has a constant distance from its centre, and a large RPE:

    >>> t = 1e-3 * np.arange(1000)
    >>> circle = np.column_stack([np.cos(2 * np.pi * 50 * t), np.sin(2 * np.pi * 50 * t)])
    >>> float(np.ptp(radial(circle)).round(9))
    0.0
    >>> windows(circle, dt=1e-3, window=0.02).rpe_rms.round(6)
    array([0.707107, 0.707107])
    """
    e = _series(error)
    n = _fits(e, window, dt)
    m, first = _count(e, n), 0
    means, variances, begins = GrowingArray(2), GrowingArray(2), GrowingArray(None)
    for mean, variance in _disjoint(e, n):
        kept = ~np.isnan(mean).any(axis=1)
        means.append(mean[kept])
        variances.append(variance[kept])
        begins.append((first + np.flatnonzero(kept)) * float(n))
        first += len(mean)
    mean, variance, begin = (read_only(grown.array()) for grown in (means, variances, begins))
    start = read_only(np.floor(begin + ROUNDING).astype(np.int64))
    return Windows(mean, variance, start, begin, n, m - len(start))


def _count(e: FloatArray, n: float) -> int:
    """Disjoint windows of n samples in a record."""
    return int(len(e) / n + ROUNDING)


def _disjoint(e: FloatArray, n: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Mean (m, 2) and mean square about it (m, 2) of disjoint windows, some at a time; NaN where a sample is missing.

    About the window's own mean, not mean(e^2) - mean(e)^2: the same in exact arithmetic, without cancellation.
    """
    if n != round(n):
        yield from windows_of(e, n * np.arange(_count(e, n), dtype=np.float64), n)
        return
    for blocks in _blocks(e, round(n)):
        mean = blocks.mean(axis=1)
        yield mean, np.square(blocks - mean[:, None, :]).mean(axis=1)


def _blocks(e: FloatArray, n: int) -> Iterator[FloatArray]:
    """Disjoint windows of n samples (m, n, 2), some at a time."""
    m = len(e) // n
    for first in range(0, m, max(PART // n, 1)):
        last = min(first + max(PART // n, 1), m)
        yield e[first * n : last * n].reshape(last - first, n, 2)
        release()


def rpe_rms(error: ArrayLike, dt: float, window: float) -> FloatArray:
    """RPE rms per axis by the window estimator: (n, 2) -> (2,). The radial one is its norm."""
    return windows(error, dt, window).rpe_rms


def mpe(error: ArrayLike, dt: float, window: float) -> FloatArray:
    """Mean error of each complete disjoint window: (n, 2) -> (m, 2)."""
    return windows(error, dt, window).mean


def rpe_instant(error: ArrayLike, dt: float, window: float, position: Position = "all") -> FloatArray:
    """Samples of the RPE by the instant estimator.

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt, window : sampling period and window length [s]
    position : position of t in its window of N samples: ``all`` (every sample of disjoint windows), or in a sliding
        window ``centred`` (sample N // 2; in the middle where N is no whole number) or ``end`` (the last sample); see
        the notes of this module

    Returns
    -------
    (m, 2), NaN where a sample of the window is missing; for ``centred`` and ``end`` one row per position of the
    sliding window (m = n - N + 1)

    Examples
    --------
    A steady drift: 20 samples of 1 per sample, so t at the end is 9.5 from the mean, t at the centre half a sample.

    >>> drift = np.column_stack([np.arange(40.0), np.zeros(40)])
    >>> [float(rpe_instant(drift, 1.0, 20.0, where)[0, 0]) for where in ("centred", "end")]
    [0.5, 9.5]
    """
    e = _series(error)
    n = _fits(e, window, dt)
    if position not in ("all", "centred", "end"):
        raise InputError(f"position must be 'all', 'centred' or 'end', got {position!r}")
    if n != round(n):
        return _fractional_instant(e, n, position)
    n = round(n)
    if position == "all":
        errors, first = empty((len(e) // n * n, 2)), 0
        for blocks in _blocks(e, n):
            rest = (blocks - blocks.mean(axis=1, keepdims=True)).reshape(-1, 2)
            errors[first : first + len(rest)] = rest
            first += len(rest)
        return errors
    at = n // 2 if position == "centred" else n - 1
    missing: BoolArray = np.asarray(np.isnan(e).any(axis=1))
    # The constant is taken out before summing so that a large offset does not eat the digits of the jitter.
    offset = np.nanmean(e, axis=0) if not missing.all() else np.zeros(2)
    filled = e - offset
    filled[missing] = 0.0
    total = np.zeros((len(e) + 1, 2))
    np.cumsum(filled, axis=0, out=total[1:])
    mean = total[n:] - total[:-n]
    mean /= n
    result = np.subtract(filled[at : at + len(mean)], mean, out=mean)
    if missing.any():
        holes = np.cumsum(np.append(0, missing))
        result[(holes[n:] - holes[:-n]) > 0] = np.nan
    return np.asarray(result)


def _fractional_instant(e: FloatArray, n: float, position: Position) -> FloatArray:
    """`rpe_instant` with windows that are no whole number of samples."""
    if position == "all":
        errors = empty((int(np.ceil(_count(e, n) * n - 0.5)), 2))
        at = first = 0
        for mean, _ in _disjoint(e, n):
            first += len(mean)
            stop = min(int(np.ceil(first * n - 0.5)), len(errors))  # samples whose middle is in these windows
            window = ((np.arange(at, stop) + 0.5) / n).astype(np.int64) - (first - len(mean))
            errors[at:stop] = e[at:stop] - mean[window]
            at = stop
        return errors
    ahead = 0.5 * (n - 1) if position == "centred" else n - 1  # from the begin of a window to that of its sample
    k = np.arange(int(np.ceil(ahead)), len(e) if position == "end" else int(len(e) - ahead))
    starts = k.astype(np.float64) - ahead
    missing: BoolArray = np.asarray(np.isnan(e).any(axis=1))
    offset = np.nanmean(e, axis=0) if not missing.all() else np.zeros(2)
    filled = np.where(missing[:, None], 0.0, e - offset)
    result: FloatArray = filled[k] - sliding_means(filled, starts, n)
    if missing.any():
        holes = np.cumsum(np.append(0, missing))
        begins, ends = np.floor(starts + ROUNDING).astype(np.int64), np.ceil(starts + n - ROUNDING).astype(np.int64)
        result[(holes[ends] - holes[begins]) > 0] = np.nan
    return result


def pde(error: ArrayLike, dt: float, window: float, separation: float) -> FloatArray:
    """Drift: difference of the means of two windows `separation` apart (start to start), in one observation.

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt, window, separation : [s]

    Returns
    -------
    (m, 2) one row per position of the pair, first windows disjoint; NaN where a sample of a pair is missing
    """
    e = _series(error)
    n = _fits(e, window, dt)
    lag = samples_in(separation, dt)
    if n + lag > len(e) + ROUNDED:
        raise InputError(
            f"the run must last for window + separation = {window + separation:g} s or more, got {len(e) * dt:g} s"
        )
    if n == round(n) and lag == round(lag):
        n, lag = round(n), round(lag)
        starts = np.arange(0, len(e) - n - lag + 1, n)
        first = e[starts[:, None] + np.arange(n)].mean(axis=1)
        second = e[starts[:, None] + lag + np.arange(n)].mean(axis=1)
    else:
        begin = n * np.arange(int((len(e) - n - lag) / n + ROUNDING) + 1, dtype=np.float64)
        first, second = (np.concatenate([mean for mean, _ in windows_of(e, at, n)]) for at in (begin, begin + lag))
    return np.asarray(second - first)


PAIRED = 1000
"""Most windows of an observation that are compared with those of another."""


def pre(first: FloatArray, second: FloatArray, max_windows: int = PAIRED) -> FloatArray:
    """Reproducibility: differences of the window means of two observations, whose rates may differ.

    Parameters
    ----------
    first, second : (m1, 2), (m2, 2) means of their windows, `mpe`
    max_windows : windows to take of each observation, spread evenly over it (the number of pairs is its square)

    Returns
    -------
    (m1 * m2, 2) every window of the second minus every window of the first
    """
    a, b = (m[np.unique(np.linspace(0, len(m) - 1, min(max_windows, len(m))).astype(int))] for m in (first, second))
    return np.asarray((b[None, :, :] - a[:, None, :]).reshape(-1, 2))
