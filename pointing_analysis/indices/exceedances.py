r"""Independent samples that the exceedances of a limit weigh as much as, from one record.

A share of samples above a limit is as certain as one of n independent samples, with n the share's own variance over
:math:`p (1 - p)`. Correlated values have fewer than there are samples; exceedances that come in bursts have fewer
still, though the values between them look independent. Three estimates are formed, and **the smallest counts**:

- of the values: :math:`N / (2 \tau_{int})` (:func:`pointing_analysis.indices.confidence.effective_number`);
- of the values over blocks: changes that are slow and small beside the noise;
- of the exceedances over blocks: bursts.

**Blocks.** The record is cut into blocks of 1, 2, 4, 8 ... samples (Flyvbjerg and Petersen, J. Chem. Phys. 91, 1989).
With B samples in a block the variance of its sum is :math:`F B` times that of a sample; F grows with B until a block is
as long as the correlation, and :math:`n = N / F`. The largest F counts. An estimate of a variance is uncertain itself:
it has d degrees of freedom, from the number and the kurtosis of the blocks (Satterthwaite), and F is taken
:math:`(t_d / z)^2` times as large, with the quantiles of Student's and of the normal distribution (Korn and Graubard,
Survey Methodology 24, 1998). A record has few long blocks, whose F scatters: fewer than `SURE` blocks count only where
F is larger than the correlation of the values explains, by more than chance at `DOUBT`. From one length of these and
to the next F has come half of the way that is left (what is missing falls as 1 / B): as much is added again.

Of fewer than `TYPICAL` exceedances the largest `TYPICAL` values are asked as well: a burst of which two samples are
above the limit has more that are just below it. The few themselves count as they are.

A record that repeats itself exactly (a tone without noise whose period is a whole number of samples) has no more than
the samples of one period.

**What no estimate sees** are events that are not in the record: of those that are in it k times on average, a part
:math:`e^{-k}` of the records has none. Nor does one see changes that are slower than the record, or a motion that
never returns (a random walk).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np  # scipy where it computes: see pointing_analysis.indices.confidence
from numpy.typing import ArrayLike

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.indices.confidence import effective_number
from pointing_analysis.read.mapped_arrays import PART, parts, present

SURE = 128
"""Blocks from which an estimate always counts."""

FEWEST = 4
"""Fewest blocks that are asked."""

DOUBT = 0.005
"""Chance of a scatter of fewer than `SURE` blocks that counts."""

TAIL = 0.95
"""Probability of the quantiles by which an uncertain variance is taken larger."""

TYPICAL = 32
"""Exceedances that tell how long a burst is; samples that tell a record that repeats itself."""

SAME = 1e-6
"""Of the scatter of a record: values that are as near as this are one."""


@dataclass(frozen=True)
class IndependentSamples:
    """Independent samples of one record, at any limit.

    Attributes
    ----------
    values : (N,) samples, without NaN
    correlated : those that the correlation of the values leaves
    most : no more than this many are independent, whatever the limit
    """

    values: FloatArray
    correlated: float
    most: float

    @classmethod
    def of(cls, values: ArrayLike, cap: float = math.inf) -> IndependentSamples:
        """Of samples (N,), NaN left out; `cap` is a number of them that is known to be the most.

        Examples
        --------
        >>> white = np.random.default_rng(1).standard_normal(20_000)
        >>> 0.7 < IndependentSamples.of(white).above(2.0) / 20_000 <= 1.0
        True
        >>> bursts = np.repeat(white[:1000], 20) + 1e-6 * white
        >>> 600 < IndependentSamples.of(bursts).above(2.0) < 1100
        True
        """
        x = present(np.asarray(values, dtype=float))
        n = len(x)
        if not n:
            return cls(x, 0.0, 0.0)
        correlated = effective_number(x)
        mean = sum(float(x[part].sum()) for part in parts(n)) / n
        power = sum(float(np.square(x[part] - mean).sum()) for part in parts(n)) / n
        known = correlated / float(inflation(correlated - 1.0))
        unit = math.sqrt(power) or 1.0
        factor = block_factor(lambda part: (x[part] - mean) / unit, n, 1.0, n / correlated, math.inf)
        most = min(known, n / factor if factor else n, cap, period(x, unit))
        return cls(x, correlated, max(most, 1.0))

    def above(self, limit: float, lower: bool = False) -> float:
        """Independent samples that the exceedances of a limit weigh as much as: at least one, at most `most`.

        Parameters
        ----------
        limit : samples at or above it exceed it
        lower : whether the limit is a lower one, which samples at or below it violate
        """
        x, sign = self.values, -1.0 if lower else 1.0
        n = len(x)
        if not n:
            return 0.0
        few = self._count(sign, sign * limit) < TYPICAL < n
        factors = [self._factor(sign, sign * limit, certain=few)]
        if few:
            factors.append(self._factor(sign, _ranked(x, sign)))
        return max(min([self.most, *(n / factor for factor in factors if factor)]), 1.0)

    def _count(self, sign: float, level: float) -> int:
        return sum(int(np.count_nonzero(sign * self.values[part] >= level)) for part in parts(len(self.values)))

    def _factor(self, sign: float, level: float, certain: bool = False) -> float:
        """Factor F of the exceedances of a level, `certain` or taken larger for what is not known of it."""
        n = len(self.values)
        share = self._count(sign, level) / n

        def deviation(part: slice) -> FloatArray:
            return np.asarray((sign * self.values[part] >= level) - share)

        return block_factor(deviation, n, share * (1.0 - share), n / self.correlated, certain=certain)


def block_factor(
    deviation: Callable[[slice], FloatArray],
    n: int,
    variance: float,
    explained: float,
    sure: float = SURE,
    certain: bool = False,
) -> float:
    """Largest factor F by which blocks scatter more than independent samples of a variance do; zero if it is unknown.

    Parameters
    ----------
    deviation : samples less their mean, of a slice of the record
    n : samples of the record
    variance : of an independent sample
    explained : factor that is known of the values: fewer than `sure` blocks count only above it
    sure : blocks from which the factor always counts
    certain : whether it is taken as it is, not larger for its own uncertainty
    """
    from scipy import special

    if not variance > 0.0:
        return 0.0
    blocks, squares, fourth = _moments(deviation, n)
    enough = (blocks >= FEWEST) & (squares > 0.0)
    blocks, squares, fourth, size = blocks[enough], squares[enough], fourth[enough], 2.0 ** np.flatnonzero(enough)
    factor = squares / (blocks - 1.0) / (size * variance)
    kurtosis = blocks * fourth / squares**2
    free = np.clip(2.0 * blocks / np.maximum(kurtosis - 1.0, 1e-12), 1.0, blocks - 1.0)
    beyond = factor > explained * special.chdtri(blocks - 1.0, DOUBT) / (blocks - 1.0)
    growth = np.maximum(np.diff(factor, prepend=factor[:1]), 0.0)
    factor += np.where(blocks < 2 * SURE, growth, 0.0)
    counts = (blocks >= sure) | beyond
    return float((factor * (1.0 if certain else inflation(free)))[counts].max(initial=0.0))


def _moments(deviation: Callable[[slice], FloatArray], n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the sums over blocks of 1, 2, 4 ... samples: their number, and their sums of squares and of fourth powers."""
    levels = max(n.bit_length(), 1)
    blocks, squares, fourth = np.zeros((3, levels))
    within = PART.bit_length() - 1

    def add(sums: FloatArray, first: int, last: int) -> FloatArray:
        for level in range(first, last):
            square = np.square(sums)
            blocks[level] += len(sums)
            squares[level] += square.sum()
            fourth[level] += np.square(square).sum()
            even = len(sums) // 2 * 2
            sums = sums[0:even:2] + sums[1:even:2]
        return sums

    long = [add(deviation(part), 0, min(within, levels)) for part in parts(n)]
    if levels > within:
        add(np.concatenate(long), within, levels)
    return blocks, squares, fourth


def inflation(free: ArrayLike) -> FloatArray:
    """Factor by which a variance of so many degrees of freedom is taken larger: :math:`(t_d / z)^2`.

    Examples
    --------
    >>> inflation([7.0, 1e9]).round(3).tolist()
    [1.327, 1.0]
    """
    from scipy import special

    d = np.maximum(np.asarray(free, dtype=float), 1.0)
    return np.asarray((special.stdtrit(d, TAIL) / special.ndtri(TAIL)) ** 2)


def period(values: FloatArray, size: float) -> int:
    """Samples after which a record repeats itself to 1e-6 of its size; all of them where it does not.

    A tone without noise whose period is so many samples is seen at so many phases, however often.

    Examples
    --------
    >>> tone = np.cos(2.0 * np.pi * 1.7e-3 * np.arange(20_000))
    >>> period(tone, 0.7), period(tone + 1e-3 * np.sin(np.arange(20_000) ** 2), 0.7)
    (10000, 20000)
    """
    n, allowed = len(values), SAME * size
    if n < 2 * TYPICAL:
        return n
    near = [np.flatnonzero(np.abs(values[part] - values[0]) <= allowed) + part.start for part in parts(n)]
    found: IntArray = np.concatenate(near)
    found = found[(found > 0) & (found <= n // 2)]
    for k in range(1, TYPICAL):
        found = found[np.abs(values[found + k] - values[k]) <= allowed]
    for lag in found[:TYPICAL].tolist():
        if all(np.abs(values[lag:][part] - values[:-lag][part]).max() <= 4.0 * allowed for part in parts(n - lag)):
            return int(lag)
    return n


def _ranked(values: FloatArray, sign: float) -> float:
    """The `TYPICAL`-th largest value, signed."""
    top: FloatArray = np.empty(0)
    for part in parts(len(values)):
        top = np.concatenate([top, sign * values[part]])
        if len(top) > TYPICAL:
            top = np.partition(top, len(top) - TYPICAL)[-TYPICAL:]
    return float(top.min())


def pooled_number(shares: Sequence[float], numbers: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Independent samples that several runs together weigh as much as, with the scatter between the runs.

    Parameters
    ----------
    shares : (m,) share of exceedances of each run
    numbers : (m,) independent samples of each
    weights : (m,) of each in the pooled share; by default their numbers

    Examples
    --------
    >>> round(pooled_number([0.1, 0.1, 0.1], [100.0, 200.0, 300.0]))
    600
    >>> pooled_number([0.0, 0.5, 0.0, 0.5], [1e6] * 4) < 10.0
    True
    """
    from scipy import special

    r, n = np.asarray(shares, dtype=float), np.asarray(numbers, dtype=float)
    w = n if weights is None else np.asarray(weights, dtype=float)
    within = float(w.sum() ** 2 / np.sum(w**2 / n))
    pooled = float(np.average(r, weights=w))
    variance, m = pooled * (1.0 - pooled), len(r)
    if m < 2 or not variance > 0.0:
        return within
    between = m / (m - 1.0) * float(np.sum(w**2 * (r - pooled) ** 2) / np.sum(w**2 * variance / n))
    if between <= special.chdtri(m - 1.0, DOUBT) / (m - 1.0):
        return within
    return max(min(within, within / between / float(inflation(m - 1.0))), 1.0)
