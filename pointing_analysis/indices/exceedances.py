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
Survey Methodology 24, 1998). A record has few long blocks, whose F scatters: fewer than `sure` blocks count only where
F is larger than the correlation of the values explains, by more than chance at `doubt`. From one length of these and
to the next F has come half of the way that is left (what is missing falls as 1 / B): as much is added again.

Of fewer than `typical` exceedances as many of the largest values are asked as well: a burst of which two samples are
above the limit has more that are just below it. The few themselves count as they are.

A record that repeats itself exactly (a tone without noise whose period is a whole number of samples) has no more than
the samples of one period.

**Clusters that may come.** Where exceedances excite each other, or last for times with a long tail, the largest
cluster of the record is not the largest one: at 95 % confidence at most 3 of m clusters are larger than any of the m
that were seen, and those may be several times as large. For compliance a multiple of the largest cluster is added to
the exceedances, more of it where there are few (`ClusterSettings`). A cluster is what a block of the record has beyond
the largest number that independent samples with the correlation of the values would have there. Clusters are counted
at further limits, too: above the limit a few large ones are lost among the exceedances of scattered noise, or each of
them has only a few samples.

**Missing samples** are, for compliance, exceedances at their places: lost in clumps, they weigh as a burst does.

**Persistent motion.** The mean of a motion whose blocks scatter as a power :math:`F \propto B^\beta`, up to the length
of the record, is as uncertain as that of :math:`n^{1 - \beta}` samples (fractional noise with
:math:`\beta = 2 H - 1`; Beran, Statistics for Long-Memory Processes, 1994). It is recognised by the slope over all
blocks and over the longest ones (`PersistenceSettings`).

**What no estimate sees** are events that are not in the record: of those that are in it k times on average, a part
:math:`e^{-k}` of the records has none. Nor does one see changes that are slower than the record, or a motion that
never returns (a random walk).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np  # scipy where it computes: see pointing_analysis.indices.confidence
from numpy.typing import ArrayLike

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.indices.confidence import EffectiveSamples, effective_number
from pointing_analysis.read.mapped_arrays import PART, SortedValues, by_parts, parts, present


@dataclass(frozen=True)
class BlockSettings(AlgorithmSettings):
    """Estimates of a scatter over blocks of samples.

    Attributes
    ----------
    sure : blocks from which an estimate always counts
    fewest : fewest blocks that are asked
    doubt : chance of a scatter of fewer than `sure` blocks that counts
    tail : probability of the quantiles by which an uncertain variance is taken larger
    typical : exceedances that tell how long a burst is
    """

    sure: int = 128
    fewest: int = 4
    doubt: float = 0.005
    tail: float = 0.95
    typical: int = 32


@dataclass(frozen=True)
class ClusterSettings(AlgorithmSettings):
    """Allowance for clusters of exceedances that are larger than those of the record.

    Attributes
    ----------
    largest : how many times the largest cluster of the record is added
    few : clusters below which it is added more often, in inverse proportion to their number
    fewest : blocks of a record, the longest in which a cluster is sought
    chance : that the largest sum of blocks of one length is beyond the expected one without a cluster
    beyond : factor above that of the correlated values from which exceedances come in clusters
    between : factor between the numbers of exceedances of the further limits above which clusters are sought, and
        how many times as many exceedances as the limit the lowest of them has at most
    usual : quantiles between which values are usual: their correlation is not that of the clusters
    """

    largest: float = 10.0
    few: float = 20.0
    fewest: int = 8
    chance: float = 1e-3
    beyond: float = 2.0
    between: int = 8
    usual: tuple[float, float] = (0.1, 0.9)


@dataclass(frozen=True)
class PersistenceSettings(AlgorithmSettings):
    """Recognition of a motion whose scatter over blocks is a power of their length.

    A first-order process has the power 1 in blocks that are shorter than its memory, and 0 in longer ones.

    Attributes
    ----------
    samples : fewest in which a power is sought
    long : blocks of a record of which each is a long one, or fewer
    most : blocks of a record, the most that count
    least, largest : powers of the short blocks between which the motion is persistent
    least_of_long : power above which that of the long blocks is
    """

    samples: int = 4096
    long: int = 127
    most: int = 2047
    least: float = 0.6
    largest: float = 0.92
    least_of_long: float = 0.42


@dataclass(frozen=True)
class ExceedanceSettings:
    """Settings of all estimates of independent samples."""

    blocks: BlockSettings = BlockSettings()
    clusters: ClusterSettings = ClusterSettings()
    persistence: PersistenceSettings = PersistenceSettings()


SETTINGS = ExceedanceSettings()


@dataclass(frozen=True)
class IndependentSamples:
    """Independent samples of one record, at any limit.

    Attributes
    ----------
    values : (N,) samples in the order of time, NaN where one is missing
    correlated : those that the correlation of the values leaves
    most : no more than this many are independent, whatever the limit
    explained : factor by which the correlation of the usual values makes the sums of blocks scatter more
    settings : of the estimates
    """

    values: FloatArray
    correlated: float
    most: float
    explained: float = 1.0
    settings: ExceedanceSettings = SETTINGS

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        cap: float = math.inf,
        components: ArrayLike | None = None,
        settings: ExceedanceSettings = SETTINGS,
    ) -> IndependentSamples:
        """Of samples (N,).

        Parameters
        ----------
        values : (N,) in the order of time, NaN where one is missing
        cap : a number of independent samples that is known to be the most
        components : (n, k) signed motion of which the values are the size; a persistent one is recognised in it
        settings : of the estimates

        Examples
        --------
        >>> white = np.random.default_rng(1).standard_normal(20_000)
        >>> 0.7 < IndependentSamples.of(white).above(2.0).number / 20_000 <= 1.0
        True
        >>> bursts = np.repeat(white[:1000], 20) + 1e-6 * white
        >>> 600 < IndependentSamples.of(bursts).above(2.0).number < 1100
        True
        """
        everything = np.asarray(values, dtype=float)
        x = present(everything)
        n = len(x)
        if not n:
            return cls(everything, 0.0, 0.0, settings=settings)
        correlated = effective_number(x)
        mean = sum(float(x[part].sum()) for part in parts(n)) / n
        power = sum(float(np.square(x[part] - mean).sum()) for part in parts(n)) / n
        known = correlated / float(inflation(correlated - 1.0, settings.blocks.tail))
        unit = math.sqrt(power) or 1.0
        sums = BlockSums.of(lambda part: (x[part] - mean) / unit, n, settings.blocks)
        factor = sums.factor(1.0, n / correlated, math.inf)
        once = period(x, unit)
        most = min(known, n / factor if factor else n, cap * min(once / len(x), 1.0), once)
        if components is not None and (beta := persistence(components, settings)):
            most = min(most, n ** (1.0 - beta))
        usual = SortedValues(x)
        low, high = (usual.quantile(part) for part in settings.clusters.usual)
        explained = n / effective_number(by_parts(lambda rows: np.clip(rows, low, high), x)) if high > low else 1.0
        return cls(everything, correlated, max(most, 1.0), explained, settings)

    def above(self, limit: float, lower: bool = False) -> EffectiveSamples:
        """Weight of the exceedances of a limit: each number is at least one and at most `most`.

        Parameters
        ----------
        limit : samples at or above it exceed it
        lower : whether the limit is a lower one, which samples at or below it violate
        """
        x, sign, clusters = present(self.values), -1.0 if lower else 1.0, self.settings.clusters
        n = len(x)
        if not n:
            return EffectiveSamples(0.0, 0.0)
        above = sum(int(np.count_nonzero(sign * x[part] >= sign * limit)) for part in parts(n))
        few = above < self.settings.blocks.typical < n
        seen = [self._exceedances(x, sign, sign * limit, certain=few)]
        ranked = self._below if lower else self._above
        if few and ranked:
            seen.append(ranked[self.settings.blocks.typical])
        number = self._number(n, seen)
        lowest = clusters.between * max(above, self.settings.blocks.typical)
        near = [one for rank, one in ranked.items() if rank <= lowest]
        unseen = max(one.largest * max(1.0, clusters.few / one.clusters) for one in [*seen, *near])
        with_missing = number
        if n < len(self.values):
            lost = [self._exceedances(self.values, sign, sign * limit, certain=True)]
            with_missing = min(number, self._number(len(self.values), lost))
        return EffectiveSamples(number, with_missing, clusters.largest * unseen)

    @cached_property
    def _above(self) -> dict[int, _Exceedances]:
        return self._ranked(1.0)

    @cached_property
    def _below(self) -> dict[int, _Exceedances]:
        return self._ranked(-1.0)

    def _ranked(self, sign: float) -> dict[int, _Exceedances]:
        """Exceedances of the limits that `typical` values exceed, and `between` times as many each."""
        x, rank, ranked = present(self.values), self.settings.blocks.typical, {}
        while rank < len(x):
            ranked[rank] = self._exceedances(x, sign, _largest(x, sign, rank))
            rank *= self.settings.clusters.between
        return ranked

    def _number(self, n: int, seen: Sequence[_Exceedances]) -> float:
        return max(min([self.most, *(n / one.factor for one in seen if one.factor)]), 1.0)

    def _exceedances(self, x: FloatArray, sign: float, level: float, certain: bool = False) -> _Exceedances:
        """Exceedances of a level, missing samples among them; `certain`: their factor is not taken larger."""
        n = len(x)

        def beyond(part: slice) -> FloatArray:
            return np.asarray(~(sign * x[part] < level), dtype=float)

        share = sum(float(beyond(part).sum()) for part in parts(n)) / n
        sums = BlockSums.of(lambda part: beyond(part) - share, n, self.settings.blocks)
        variance = share * (1.0 - share)
        factor = sums.factor(variance, n / self.correlated, certain=certain)
        clusters = share * n / factor if factor > self.settings.clusters.beyond * self.explained else math.inf
        return _Exceedances(factor, sums.largest_cluster(share, self.explained, self.settings.clusters), clusters)


@dataclass(frozen=True)
class _Exceedances:
    """Factor of their blocks, samples of the largest cluster, and number of clusters; infinite where there are none."""

    factor: float
    largest: float
    clusters: float


@dataclass(frozen=True)
class BlockSums:
    """Sums of a record's samples, less their mean, over blocks of 1, 2, 4, 8 ... samples.

    Attributes
    ----------
    samples : (m,) in a block
    blocks : (m,) number of them
    squares, fourth : (m,) sums over the blocks of the squares, and of the fourth powers, of their sums
    largest : (m,) largest of their sums
    settings : of the estimates
    """

    samples: FloatArray
    blocks: FloatArray
    squares: FloatArray
    fourth: FloatArray
    largest: FloatArray
    settings: BlockSettings = SETTINGS.blocks

    @classmethod
    def of(
        cls, deviation: Callable[[slice], FloatArray], n: int, settings: BlockSettings = SETTINGS.blocks
    ) -> BlockSums:
        """Of n samples less their mean, of which `deviation` gives a slice; lengths with enough blocks."""
        levels = max(n.bit_length(), 1)
        blocks, squares, fourth = np.zeros((3, levels))
        largest = np.full(levels, -math.inf)
        within = PART.bit_length() - 1

        def add(sums: FloatArray, first: int, last: int) -> FloatArray:
            for level in range(first, last):
                square = np.square(sums)
                blocks[level] += len(sums)
                squares[level] += square.sum()
                fourth[level] += np.square(square).sum()
                largest[level] = max(largest[level], sums.max(initial=-math.inf))
                even = len(sums) // 2 * 2
                sums = sums[0:even:2] + sums[1:even:2]
            return sums

        long = [add(deviation(part), 0, min(within, levels)) for part in parts(n)]
        if levels > within:
            add(np.concatenate(long), within, levels)
        enough = (blocks >= settings.fewest) & (squares > 0.0)
        samples = np.power(2.0, np.flatnonzero(enough), dtype=np.float64)
        return cls(samples, blocks[enough], squares[enough], fourth[enough], largest[enough], settings)

    def factor(self, variance: float, explained: float, sure: float | None = None, certain: bool = False) -> float:
        """Largest factor F by which blocks scatter more than independent samples do; zero if it is unknown.

        Parameters
        ----------
        variance : of an independent sample
        explained : factor that is known of the values: fewer than `sure` blocks count only above it
        sure : blocks from which the factor always counts; default: those of the settings
        certain : whether it is taken as it is, not larger for its own uncertainty
        """
        from scipy import special

        if not variance > 0.0:
            return 0.0
        blocks = self.blocks
        factor = self.squares / (blocks - 1.0) / (self.samples * variance)
        kurtosis = blocks * self.fourth / self.squares**2
        free = np.clip(2.0 * blocks / np.maximum(kurtosis - 1.0, 1e-12), 1.0, blocks - 1.0)
        beyond = factor > explained * special.chdtri(blocks - 1.0, self.settings.doubt) / (blocks - 1.0)
        growth = np.maximum(np.diff(factor, prepend=factor[:1]), 0.0)
        factor += np.where(blocks < 2 * self.settings.sure, growth, 0.0)
        counts = (blocks >= (self.settings.sure if sure is None else sure)) | beyond
        return float((factor * (1.0 if certain else inflation(free, self.settings.tail)))[counts].max(initial=0.0))

    def largest_cluster(self, share: float, explained: float, settings: ClusterSettings) -> float:
        """Samples of the largest cluster: beyond the largest sum that is expected of correlated samples.

        These come in groups at random: a Poisson distribution of groups, each of as many samples as give the sums of
        the blocks their scatter.

        Parameters
        ----------
        share : of the samples that exceed
        explained : factor by which the correlation of the values makes the sums of blocks scatter more
        settings : of clusters
        """
        from scipy import special

        chosen = self.blocks >= settings.fewest
        mean, group = share * self.samples[chosen], explained * (1.0 - share)
        groups = np.ceil(special.pdtrik(1.0 - settings.chance / self.blocks[chosen], mean / group))
        return float(np.max(self.largest[chosen] - (group * np.maximum(groups, 1.0) - mean), initial=0.0))

    def power(self, fewest: int, most: int) -> float:
        """Power of the length with which the scatter of blocks grows beyond that of white noise.

        Parameters
        ----------
        fewest, most : of the blocks that count
        """
        chosen = (self.blocks >= fewest) & (self.blocks <= most)
        blocks, length = self.blocks[chosen], np.log(self.samples[chosen])
        scatter = np.log(self.squares[chosen] / (blocks - 1.0)) - length
        length, scatter = length - np.average(length, weights=blocks), scatter - np.average(scatter, weights=blocks)
        return float(np.sum(blocks * length * scatter) / np.sum(blocks * length**2))


def persistence(components: ArrayLike, settings: ExceedanceSettings = SETTINGS) -> float:
    """Power of a persistent motion (n, k), NaN where a sample is missing, the mean over its components; else zero.

    Examples
    --------
    >>> white = np.random.default_rng(1).standard_normal((20_000, 2))
    >>> persistence(white)
    0.0
    """
    powers, power_law = [], settings.persistence
    for column in np.asarray(components, dtype=float).T:
        x = present(column)
        if len(x) < power_law.samples:
            continue
        mean = sum(float(x[part].sum()) for part in parts(len(x))) / len(x)
        rest = by_parts(lambda rows, mean=mean: rows - mean, x)
        sums = BlockSums.of(rest.__getitem__, len(rest), settings.blocks)
        if len(sums.blocks):  # else it is a constant
            of_short = sums.power(power_law.long + 1, len(x))
            powers.append((of_short, sums.power(0, power_law.long), sums.power(0, power_law.most)))
    if not powers:
        return 0.0
    of_short, of_long, power = np.mean(powers, axis=0).tolist()
    straight = power_law.least < of_short < power_law.largest and of_long > power_law.least_of_long
    return min(power, 1.0) if straight else 0.0


def inflation(free: ArrayLike, tail: float = SETTINGS.blocks.tail) -> FloatArray:
    """Factor by which a variance of so many degrees of freedom is taken larger: :math:`(t_d / z)^2`.

    Examples
    --------
    >>> inflation([7.0, 1e9]).round(3).tolist()
    [1.327, 1.0]
    """
    from scipy import special

    d = np.maximum(np.asarray(free, dtype=float), 1.0)
    return np.asarray((special.stdtrit(d, tail) / special.ndtri(tail)) ** 2)


def period(values: FloatArray, size: float, same: float = 1e-6, compared: int = 32) -> int:
    """Samples after which a record repeats itself; all of them where it does not.

    A tone without noise whose period is so many samples is seen at so many phases, however often.

    Parameters
    ----------
    values : (n,)
    size : scatter of the record
    same : part of its size by which equal values may differ
    compared : samples in which a repetition is sought

    Examples
    --------
    >>> tone = np.cos(2.0 * np.pi * 1.7e-3 * np.arange(20_000))
    >>> period(tone, 0.7), period(tone + 1e-3 * np.sin(np.arange(20_000) ** 2), 0.7)
    (10000, 20000)
    """
    n, allowed = len(values), same * size
    if n < 2 * compared:
        return n
    near = [np.flatnonzero(np.abs(values[part] - values[0]) <= allowed) + part.start for part in parts(n)]
    lags: IntArray = np.concatenate(near)
    lags = lags[(lags > 0) & (lags <= n // 2)]
    for k in range(1, compared):
        lags = lags[np.abs(values[lags + k] - values[k]) <= allowed]
    for lag in lags[:compared].tolist():
        if all(np.abs(values[lag:][part] - values[:-lag][part]).max() <= 4.0 * allowed for part in parts(n - lag)):
            return int(lag)
    return n


def _largest(values: FloatArray, sign: float, rank: int) -> float:
    """The least of the largest values, so many of them, signed."""
    top: FloatArray = np.empty(0)
    for part in parts(len(values)):
        top = np.concatenate([top, sign * values[part]])
        if len(top) > rank:
            top = np.partition(top, len(top) - rank)[-rank:]
    return float(top.min())


def pooled_number(numbers: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Independent samples that several runs together weigh as much as: at most one of each run.

    What differs between runs, as between the members of a family, is seen as often as there are runs, however long each
    of them is: a member in ten that always exceeds is in none of twenty with a probability of 12 %.

    Parameters
    ----------
    numbers : (m,) independent samples of each run
    weights : (m,) of each run in the pooled share; by default their numbers

    Examples
    --------
    >>> pooled_number([100.0, 100.0, 100.0]), pooled_number([0.5, 0.5])
    (3.0, 1.0)
    """
    n = np.asarray(numbers, dtype=float)
    w = n if weights is None else np.asarray(weights, dtype=float)
    total = float(w.sum() ** 2)
    return max(min(total / float(np.sum(w**2 / n)), total / float(np.sum(w**2))), 1.0)
