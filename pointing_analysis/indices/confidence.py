r"""Statistics of pointing errors: quantiles with confidence bounds that assume no distribution.

A pointing requirement is a probability with a confidence: :math:`P(|e| < \text{limit}) \ge 99.7\,\%` at 95 %. The
count of exceedances among independent samples is binomial, so Clopper and Pearson's exact bounds on its probability
decide the requirement, and the same reasoning on ranks bounds a quantile, whatever the distribution. Samples of a
line of sight are *not* independent: N of them weigh as much as :math:`N / (2\tau_{int})` independent ones, with the
integrated autocorrelation time :math:`\tau_{int}` (Sokal 1997) estimated from the run itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np  # scipy where it computes: every command imports this module, and few of them need scipy
from numpy.typing import ArrayLike

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, parts, present, release

LAGS = 1 << 18
"""Lags of an autocorrelation that are formed at a time."""
SOKAL_WINDOW = 6.0  # the sum over lags stops at this many autocorrelation times


def _probability(p: float) -> float:
    if not 0 < p < 1:
        raise InputError(f"probability must be between 0 and 1, got {p:g}")
    return p


def exceedance_upper(exceedances: int, samples: int, confidence: float) -> float:
    """Clopper-Pearson upper bound on the probability of exceeding, one-sided, from independent samples."""
    from scipy import special

    if exceedances >= samples:
        return 1.0
    return float(special.betaincinv(exceedances + 1, samples - exceedances, confidence))


def exceedance_lower(exceedances: int, samples: int, confidence: float) -> float:
    """Clopper-Pearson lower bound on the probability of exceeding, one-sided, from independent samples."""
    from scipy import special

    if exceedances <= 0:
        return 0.0
    return float(special.betaincinv(exceedances, samples - exceedances + 1, 1 - confidence))


def samples_needed(probability: float, confidence: float, exceedances: int = 0) -> int:
    """Independent samples needed to show `probability` at `confidence` when so many of them exceed the limit.

    Examples
    --------
    >>> [samples_needed(0.997, 0.95, k) for k in (0, 1, 2, 5)]
    [998, 1580, 2097, 3502]
    """
    from scipy import special

    p, c = 1 - _probability(probability), _probability(confidence)
    low, high = exceedances, max(exceedances, 1)
    while special.bdtr(exceedances, high, p) > 1 - c:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if special.bdtr(exceedances, middle, p) > 1 - c else (low, middle)
    return high


def samples_to_refute(probability: float, confidence: float, rate: float) -> float:
    """Independent samples after which an exceedance rate above 1 - `probability` would refute the requirement."""
    if rate <= 1 - _probability(probability):
        return math.inf
    n = 1.0
    while n < 1e12:
        if exceedance_lower(int(rate * n), int(n), confidence) > 1 - probability:
            return float(int(n))
        n = max(n + 1, n * 1.02)
    return math.inf


def samples_to_decide(probability: float, confidence: float, rate: float, unseen: float = 0.0) -> float:
    """Independent samples after which the requirement would be decided if the exceedance rate stays as it is.

    Parameters
    ----------
    probability, confidence : of the requirement
    rate : share of the samples above the limit
    unseen : samples above it that are added, however many there are
    """
    if rate > 1 - probability:
        return samples_to_refute(probability, confidence, rate)
    n = float(samples_needed(probability, confidence))
    while n < 1e12:
        if exceedance_upper(math.ceil(rate * n + unseen), int(n), confidence) <= 1 - probability:
            return float(int(n))
        n *= 1.02
    return math.inf


def autocorrelation_time(values: ArrayLike) -> float:
    r"""Integrated autocorrelation time :math:`\tau_{int} = 1/2 + \sum_{k \ge 1} \rho_k` in samples, at least 1/2.

    The sum stops at the first lag above `SOKAL_WINDOW` times the sum so far (Sokal's automatic window); NaN are left
    out.

    Parameters
    ----------
    values : (n,)

    Examples
    --------
    A first-order process with pole 0.9 has (1 + 0.9) / (2 (1 - 0.9)) = 9.5:

    >>> from scipy.signal import lfilter
    >>> white = np.random.default_rng(1).standard_normal(200_000)
    >>> 9 < autocorrelation_time(lfilter([1], [1, -0.9], white)) < 10
    True
    """
    x = present(np.asarray(values, dtype=float))
    n = int(x.size)
    if n < 4:
        return 0.5
    largest = max(float(np.abs(x[part]).max()) for part in parts(n))
    mean = sum(float(x[part].sum()) for part in parts(n)) / n
    x = by_parts(lambda rows: rows - mean, x)
    power = sum(float(x[part] @ x[part]) for part in parts(n))
    # A constant: one value n times. Rounding noise about it must not count as information.
    if power <= n * (1e-14 * largest) ** 2:
        return n / 2
    total = -0.5
    for first, products in _autocorrelation(x):
        tau = total + np.cumsum(products / power)
        total = float(tau[-1])
        ends = np.flatnonzero(first + np.arange(tau.size) >= SOKAL_WINDOW * np.maximum(tau, 0.5))
        if ends.size:
            # Taken about the sample mean every lag comes out too low; Wolff (2004), equation 49, puts that back. With
            # the lag below n and the time at most a sixth of the lag the result is below n / 2.
            lag = first + int(ends[0])
            return float(max(tau[ends[0]], 0.5) * (1 + (2 * lag + 1) / n))
    return n / 2  # a sample is infinite: over all lags the sum of finite ones is zero, far below the last lag


def _autocorrelation(x: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Sums of x[i] x[i + lag] over i, by lag: some lags at a time, with the first of them."""
    from scipy import fft

    n = len(x)
    block = min(n, LAGS)
    size = fft.next_fast_len(2 * block, real=True)
    for first in range(0, n, block):
        total = np.zeros(min(block, n - first))
        for begin in range(0, n - first, block):
            earlier, later = x[begin : begin + block], x[begin + first : begin + first + 2 * block]
            product = fft.rfft(later, size) * np.conj(fft.rfft(earlier, size))
            total += fft.irfft(product, size)[: total.size]
            release()
        yield first, total


def effective_number(values: ArrayLike) -> float:
    r"""Number of independent samples that weigh as much as these: :math:`N/(2\tau_{int})`, between 1 and N."""
    x = np.asarray(values, dtype=float)
    n = sum(int((~np.isnan(x[part])).sum()) for part in parts(len(x)))
    return max(1.0, n / (2 * autocorrelation_time(x))) if n else 0.0


@dataclass(frozen=True)
class EffectiveSamples:
    """Independent samples that the exceedances of a limit weigh as much as.

    Attributes
    ----------
    number : of the samples that are there
    with_missing : of all samples, with the missing ones as exceedances
    unseen : samples that clusters beyond those of the record may exceed in the same time
    """

    number: float
    with_missing: float
    unseen: float = 0.0

    @classmethod
    def of(cls, number: EffectiveSamples | float) -> EffectiveSamples:
        """From a number of samples that are known to be independent."""
        return number if isinstance(number, EffectiveSamples) else cls(number, number)


@dataclass(frozen=True)
class Quantile:
    """A quantile with one-sided bounds, each at the stated confidence.

    Attributes
    ----------
    probability, confidence : as asked
    value : point estimate
    lower, upper : bounds; ``upper`` is infinite where the samples are too few to bound it
    effective : number of independent samples that was used
    """

    probability: float
    confidence: float
    value: float
    lower: float
    upper: float
    effective: float


def _binomial_quantile(q: float, n: int, p: float) -> int:
    """Smallest k with P(Binomial(n, p) <= k) >= q (scipy.stats has it too, at the cost of a slow, large import)."""
    from scipy import special

    k = max(math.ceil(special.bdtrik(q, n, p)), 1)
    return k - 1 if special.bdtr(k - 1, n, p) >= q else k


def quantile(
    values: ArrayLike,
    probability: float,
    confidence: float = 0.95,
    effective: EffectiveSamples | float | None = None,
    missing: float = 0.0,
) -> Quantile:
    """Quantile of samples with distribution-free confidence bounds from order statistics.

    Parameters
    ----------
    values : (n,) samples, NaN left out
    probability : of being below the quantile
    confidence : of each one-sided bound
    effective : number of independent samples; by default estimated with `effective_number`
    missing : samples beside them that may be of any size: the upper bound holds if they are above all others

    Examples
    --------
    With 997 independent samples the largest one does not yet bound the 99.7 % quantile at 95 %, with 998 it does:

    >>> [quantile(np.arange(n), 0.997, 0.95, effective=n).upper for n in (997, 998)]
    [inf, 997.0]
    """
    p, c = _probability(probability), _probability(confidence)
    x = SortedValues(np.asarray(values, dtype=float))
    if not x.size:
        return Quantile(p, c, math.nan, math.nan, math.inf, 0.0)
    known = EffectiveSamples.of(effective_number(values) if effective is None else effective)
    number = min(known.number, x.size)
    n = max(int(number), 1)
    # Largest rank r with P(Binomial(n, p) >= r) >= confidence; 0 if there is none
    low = _binomial_quantile(1 - c, n, p)
    lower_rank = max(math.floor((low - 1) * x.size / n), 0) if low >= 1 else 0
    n, upper_rank = max(int(min(known.with_missing, x.size + missing)), 1), x.size
    # Smallest rank r with P(Binomial(n, p) < r) >= confidence; n + 1 if there is none
    if (up := _binomial_quantile(c, n, p) + 1) <= n and math.isfinite(missing):
        upper_rank = math.ceil(up * (x.size + missing) / n + known.unseen) - 1
    lower, upper = x.at([lower_rank, min(upper_rank, x.size - 1)]).tolist()
    return Quantile(p, c, x.quantile(p), lower, upper if upper_rank < x.size else math.inf, float(number))
