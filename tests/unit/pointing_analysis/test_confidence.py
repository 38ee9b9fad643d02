"""Confidence bounds and independent exceedances hold what they promise, on independent and on correlated samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special, stats
from scipy.signal import lfilter
from support.slow_cases import slow

from pointing_analysis.indices import confidence
from pointing_analysis.indices.confidence import effective_number
from pointing_analysis.indices.exceedances import BlockSums, IndependentSamples, inflation, persistence, pooled_number


def reference_time(x: np.ndarray) -> float:
    """Sokal's window and Wolff's correction with the correlations summed lag by lag."""
    n, x = len(x), x - x.mean()
    tau = -0.5
    for lag in range(n):
        tau += float(x[: n - lag] @ x[lag:]) / float(x @ x)
        if lag >= 6.0 * max(tau, 0.5):
            return min(max(tau, 0.5) * (1.0 + (2 * lag + 1) / n), n / 2)
    return n / 2


@pytest.mark.parametrize("n", [4, 5, 8, 40, 300])
@pytest.mark.parametrize("pole", [-0.7, 0.0, 0.8, 0.99])
def test_autocorrelation_time_is_the_windowed_sum(n: int, pole: float) -> None:
    x = lfilter([1], [1, -pole], np.random.default_rng(n).standard_normal(n)) + 3.0
    assert confidence.autocorrelation_time(x) == pytest.approx(reference_time(x), rel=1e-9)
    assert confidence.effective_number(x) == pytest.approx(max(1.0, n / (2.0 * reference_time(x))), rel=1e-9)


def test_autocorrelation_time_of_odd_samples() -> None:
    assert [confidence.autocorrelation_time(np.arange(k, dtype=float)) for k in (0, 1, 3)] == [0.5] * 3
    assert confidence.effective_number([1.0, 5.0, 2.0]) == 3.0
    assert confidence.autocorrelation_time(np.full(10, 7.0)) == 5.0
    noise = 1e-3 * np.random.default_rng(0).standard_normal(500)
    assert confidence.effective_number(1.0 + noise) > 300  # small, and no rounding noise
    infinite = np.append(np.random.default_rng(0).standard_normal(50), np.inf)  # it leaves the weight of one
    with np.errstate(invalid="ignore"):
        assert confidence.autocorrelation_time(infinite) == 25.5 and confidence.effective_number(infinite) == 1.0


@pytest.mark.parametrize("p", [0.0, 1.0, -0.1, 1.1, float("nan")])
def test_what_is_no_probability_is_refused(p: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        confidence.samples_needed(p, 0.9)
    with pytest.raises(ValueError, match="between 0 and 1"):
        confidence.samples_needed(0.9, p)


@pytest.mark.parametrize("p", [0.5, 0.75, 0.9, 0.997])
def test_a_bound_that_lies_at_the_limit_refutes_nothing_and_shows_compliance(p: float) -> None:
    """Bounds from one sample are 1 - c and c themselves, without rounding."""
    assert confidence.exceedance_lower(1, 1, p) == 1.0 - p
    assert confidence.samples_to_refute(p, p, 1.0) == 2
    assert confidence.samples_to_decide(0.5, 0.5, 0.0) == 1


def test_bounds_at_the_ends_of_the_count() -> None:
    assert confidence.exceedance_lower(0, 7, 0.9) == 0.0 and confidence.exceedance_lower(-1, 7, 0.9) == 0.0
    assert confidence.exceedance_upper(7, 7, 0.9) == 1.0 and confidence.exceedance_upper(8, 7, 0.9) == 1.0
    assert confidence.exceedance_upper(0, 7, 0.9) == pytest.approx(1.0 - 0.1 ** (1 / 7), rel=1e-12)
    assert confidence.exceedance_lower(7, 7, 0.9) == pytest.approx(0.1 ** (1 / 7), rel=1e-12)
    assert confidence.exceedance_upper(6, 7, 0.9) == pytest.approx(0.9 ** (1 / 7), rel=1e-12)


@pytest.mark.parametrize("k", [0, 1, 2, 7, 40])
@pytest.mark.parametrize(("p", "c"), [(0.4, 0.55), (0.3, 0.9), (0.9, 0.95), (0.01, 0.2)])
def test_samples_needed_by_trying_all_numbers(p: float, c: float, k: int) -> None:
    n = k + 1
    while stats.binom.cdf(k, n, 1 - p) > 1 - c:
        n += 1
    assert confidence.samples_needed(p, c, k) == n


@pytest.mark.parametrize(
    ("p", "c", "rate"), [(0.5, 0.95, 1.0), (0.5, 0.95, 0.8), (0.9, 0.9, 0.5), (0.99, 0.95, 0.04), (0.99, 0.9, 1.0)]
)
def test_samples_to_refute_by_trying_all_numbers(p: float, c: float, rate: float) -> None:
    """Exact up to 50 samples, then in steps of 2 %."""

    def refutes(n: int) -> bool:
        return confidence.exceedance_lower(int(rate * n), n, c) > 1 - p

    first = next(n for n in range(1, 100_000) if refutes(n))
    found = confidence.samples_to_refute(p, c, rate)
    assert found == confidence.samples_to_decide(p, c, rate) and refutes(int(found))
    assert found == first if first <= 50 else first <= found < 1.3 * first
    assert confidence.samples_to_refute(p, c, 0.5 * (1 - p)) == math.inf
    assert confidence.samples_to_refute(p, c, 1 - p) == math.inf


@pytest.mark.parametrize(("p", "c", "rate"), [(0.5, 0.95, 0.2), (0.9, 0.9, 0.03), (0.99, 0.95, 0.004)])
def test_samples_to_decide_shows_compliance_within_two_percent(p: float, c: float, rate: float) -> None:
    found = int(confidence.samples_to_decide(p, c, rate))

    def shows(n: float) -> bool:
        return confidence.exceedance_upper(math.ceil(rate * int(n)), int(n), c) <= 1 - p

    n = float(confidence.samples_needed(p, c))
    while not shows(n):
        n *= 1.02
    assert found == int(n)


@pytest.mark.parametrize(("p", "c"), [(0.5, 0.95), (0.9, 0.9), (0.99, 0.95), (0.05, 0.6)])
@pytest.mark.parametrize(("n", "effective"), [(1, 1), (30, 30), (1000, 1000), (1000, 217), (50, 400), (7, 0.3)])
def test_quantile_bounds_are_the_ranks_of_the_binomial(p: float, c: float, n: int, effective: float) -> None:
    """Samples are 0, 1, ... n - 1; with fewer independent ones the ranks are stretched, each to its safe side."""
    x = np.random.default_rng(0).permutation(np.r_[np.arange(float(n)), np.nan])
    found = confidence.quantile(x, p, c, effective=effective)
    m = max(int(min(effective, n)), 1)
    assert (found.probability, found.confidence, found.effective) == (p, c, float(min(effective, n)))
    assert found.value == max(math.ceil(p * n - 1e-9), 1) - 1, "the smallest one that a share p does not exceed"
    up = next((r for r in range(1, m + 1) if stats.binom.cdf(r - 1, m, p) >= c), None)
    low = max((r for r in range(1, m + 1) if stats.binom.sf(r - 1, m, p) >= c), default=None)
    assert found.upper == (math.inf if up is None else min(math.ceil(up * n / m), n) - 1)
    assert found.lower == (0.0 if low is None else math.floor((low - 1) * n / m))


def test_quantile_takes_95_percent_and_the_effective_number_by_default() -> None:
    x = lfilter([1], [1, -0.9], np.random.default_rng(3).standard_normal(3000))
    found = confidence.quantile(x, 0.9)
    assert found == confidence.quantile(x, 0.9, 0.95, confidence.effective_number(x))
    assert found.effective < 300
    empty = confidence.quantile([np.nan], 0.5)
    assert math.isnan(empty.value) and math.isnan(empty.lower) and (empty.upper, empty.effective) == (math.inf, 0.0)


@pytest.mark.parametrize("scale", [2.0**-80, 2.0**-30, 2.0**40])
def test_effective_number_does_not_depend_on_the_unit(scale: float) -> None:
    x = 1.0 + 0.1 * lfilter([1], [1, -0.5], np.random.default_rng(5).standard_normal(500))
    assert confidence.effective_number(scale * x) == pytest.approx(confidence.effective_number(x), rel=1e-9)
    assert confidence.effective_number(np.full(500, 0.1 * scale)) == pytest.approx(1.0)


@pytest.mark.parametrize("p", [0.003, 0.05, 0.5, 0.9])
def test_binomial_quantile_at_every_step_of_the_distribution(p: float) -> None:
    """At q = P(X <= k) the quantile is k, between two steps the upper one: the inverse function alone rounds up."""
    for n in (1, 2, 7, 60, 331):
        steps = special.bdtr(np.arange(n + 1), n, p)
        for k in np.flatnonzero((np.diff(steps, prepend=0.0) > 1e-9) & (steps < 1.0 - 1e-9)):
            assert confidence._binomial_quantile(steps[k], n, p) == k
            assert confidence._binomial_quantile(0.5 * (steps[k] + steps[k + 1]), n, p) == k + 1


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, 0.98])
def test_autocorrelation_time_of_a_first_order_process(pole: float) -> None:
    rng = np.random.default_rng(int(100 * pole))
    x = lfilter([1], [1, -pole], rng.standard_normal(400_000))
    assert confidence.autocorrelation_time(x) == pytest.approx((1 + pole) / (2 * (1 - pole)), rel=0.06)


@pytest.mark.parametrize(
    ("pole", "p"),
    [(0.0, 0.99), (0.97, 0.95), *(slow(pole, p) for pole in (0.0, 0.8, 0.97) for p in (0.95, 0.99))],
)
def test_bounds_cover_on_500_runs(pole: float, p: float) -> None:
    """Each one-sided 95 % bound covers the true quantile in at least 93 % of 500 runs, correlated or not."""
    rng = np.random.default_rng(7)
    n, runs = 4000, 500
    white = rng.standard_normal((runs, 2, n + 400))
    e = lfilter([math.sqrt(1 - pole**2)], [1, -pole], white, axis=2)[:, :, 400:]
    true = math.sqrt(-2 * math.log(1 - p))  # radius that holds the share p of two equal Gaussian axes
    bounds = [confidence.quantile(np.hypot(*one), p, 0.95) for one in e]
    assert np.mean([b.upper >= true for b in bounds]) >= 0.93
    assert np.mean([b.lower <= true for b in bounds]) >= 0.93
    if pole < 0.9:  # they cover by being right, not by being infinite
        assert np.median([b.upper for b in bounds]) < 1.2 * true
        assert np.median([b.lower for b in bounds]) > 0.8 * true


@pytest.mark.parametrize(("k", "n"), [(0, 10), (3, 50), (10, 1000), (0, 998)])
def test_clopper_pearson_is_the_binomial_tail_turned_round(k: int, n: int) -> None:
    upper, lower = confidence.exceedance_upper(k, n, 0.95), confidence.exceedance_lower(k, n, 0.95)
    assert stats.binom.cdf(k, n, upper) == pytest.approx(0.05, rel=1e-9)
    if k:
        assert stats.binom.sf(k - 1, n, lower) == pytest.approx(0.05, rel=1e-9)
    else:
        assert lower == 0
    test = stats.binomtest(k, n).proportion_ci(0.90, method="exact")  # two-sided 90 %: 5 % on either side
    assert (lower, upper) == (pytest.approx(test.low), pytest.approx(test.high))
    assert confidence.exceedance_upper(n, n, 0.95) == 1.0


def noise(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize("limit", [-1.0, 0.0, 1.3, 2.6, 6.0])
def test_independent_samples_count_as_they_are(limit: float) -> None:
    counts = [IndependentSamples.of(noise(5000, seed)).above(limit).number for seed in range(40)]
    assert np.median(counts) > 0.85 * 5000 and max(counts) <= 5000


@pytest.mark.parametrize("long", [10, 100])
def test_bursts_count_once(long: int) -> None:
    """Forty bursts of `long` samples: the exceedances weigh as much as some 40, the values as much as thousands."""
    ratios = []
    for seed in range(20):
        x = noise(40_000, seed)
        for start in np.random.default_rng([1, seed]).integers(0, 40_000 - long, 40):
            x[start : start + long] += 9.0
        found = IndependentSamples.of(x)
        ratios.append(found.above(5.0).number * np.mean(x >= 5.0) / 40.0)
        assert found.above(5.0).number <= found.most <= found.correlated <= 40_000
    assert 0.5 < np.median(ratios) < 1.3


def test_a_burst_of_which_little_exceeds_is_seen_by_what_is_below_the_limit() -> None:
    x = noise(10_000)
    x[5000:5030] = 4.0 + 0.01 * np.arange(30)
    alone = IndependentSamples.of(x)
    assert alone.above(4.285).number < 1500 and effective_number(x) > 7000
    x[5000:5030] = noise(30, 2)
    assert IndependentSamples.of(x).above(4.285).number > 7000


def test_a_slow_change_of_the_size_is_seen_where_no_limit_is_near() -> None:
    """The correlation of the values does not see it under the noise."""
    rng, n = np.random.default_rng(3), 20_000
    x = np.abs(rng.standard_normal(n)) * np.exp(0.3 * np.sin(2.0 * np.pi * np.arange(n) / 8000.0))
    assert effective_number(x) > 0.5 * n and IndependentSamples.of(x).above(99.0).number < 0.05 * n


def test_signs_scales_gaps_and_constants() -> None:
    x = np.repeat(noise(300), 7)
    found = IndependentSamples.of(x)
    assert IndependentSamples.of(-x).above(-1.5, lower=True) == found.above(1.5)
    scaled = IndependentSamples.of(1e-9 * x).above(1.5e-9)
    assert vars(scaled) == pytest.approx(vars(found.above(1.5)))
    gap = IndependentSamples.of(np.append(x, np.nan)).above(1.5)
    assert (gap.number, gap.unseen) == (found.above(1.5).number, found.above(1.5).unseen)
    assert gap.with_missing <= gap.number
    assert IndependentSamples.of(x, cap=20.0).above(1.5).number == 20.0
    assert IndependentSamples.of(np.full(1000, 0.1)).above(0.05).number == 1.0
    assert IndependentSamples.of([np.nan]).above(0.0).number == 0.0
    for few in range(1, 9):
        assert 1.0 <= IndependentSamples.of(noise(few)).above(0.0).number <= few


def test_a_record_that_repeats_itself_is_one_period() -> None:
    """Of 600 s of a tone of 1.7 Hz at 100 Hz there are 500 phases of its size: none may be in a tenth of a per cent."""
    phase = 2.0 * np.pi * 0.017 * np.arange(60_000)
    size = np.abs(np.cos(phase + 0.3))
    assert IndependentSamples.of(size).above(0.9999).number <= 500
    assert IndependentSamples.of(np.abs(np.cos(3.0**0.5 / 1.7 * phase))).most > 10_000
    assert IndependentSamples.of(np.round(np.abs(noise(5000)), 1)).most > 4000, "values of few digits do not repeat"


def test_blocks_of_a_long_record_are_those_of_a_short_one() -> None:
    """Record by record and in parts: the sums of squares are those of the blocks."""
    for n in (1, 5, 64, 1000, 300_001):
        x = noise(n)
        found = BlockSums.of(lambda part, x=x: x[part], n)
        assert found.samples.tolist() == [2.0**k for k in range(20) if n // 2**k >= 4]
        for level, size in enumerate(found.samples.astype(int)):
            sums = x[: n // size * size].reshape(-1, size).sum(axis=1)
            assert (found.blocks[level], found.squares[level]) == (len(sums), pytest.approx(np.sum(sums**2)))
            assert found.fourth[level] == pytest.approx(np.sum(sums**4))
            assert found.largest[level] == pytest.approx(sums.max())


def test_the_factor_is_that_of_the_correlation() -> None:
    """Of a first-order process with pole 0.9 it is (1 + 0.9) / (1 - 0.9) = 19."""
    from scipy.signal import lfilter

    x = lfilter([1.0], [1.0, -0.9], noise(400_000))
    assert 19.0 < BlockSums.of(lambda part: x[part] - x.mean(), len(x)).factor(float(x.var()), 19.0) < 24.0
    assert BlockSums.of(lambda part: 0.0 * x[part], len(x)).factor(0.0, 1.0) == 0.0


def test_an_uncertain_variance_is_taken_larger() -> None:
    """Student's and the normal quantile: 1.895 and 1.645 at seven degrees of freedom."""
    assert inflation(7.0) == pytest.approx((1.894579 / 1.644854) ** 2, rel=1e-5)
    assert np.all(np.diff(inflation(np.arange(1.0, 50.0))) < 0.0) and inflation(0.0) == inflation(1.0)


def test_runs_are_at_most_one_sample_each() -> None:
    """One in ten always exceeds: of twenty none does in 12 % of the cases, whatever their length."""
    assert pooled_number([1000.0] * 20) == pytest.approx(20.0)
    assert pooled_number([0.5] * 20) == pytest.approx(10.0)
    assert pooled_number([10.0, 10.0], [3.0, 1.0]) == pytest.approx(1.6)


def test_samples_lost_in_clumps_weigh_as_bursts() -> None:
    """Ten gaps of 300 of 60 000 samples: what exceeds in them are ten events, not three thousand."""
    x = noise(60_000)
    for start in range(2000, 60_000, 5800):
        x[start : start + 300] = np.nan
    gaps = IndependentSamples.of(x).above(1.28)
    assert gaps.number > 40_000 and gaps.with_missing < 15_000 and gaps.unseen == 0.0


def test_a_larger_cluster_than_those_of_the_record_may_come() -> None:
    """None is expected of independent or correlated samples; of clusters the largest counts several times."""
    from scipy.signal import lfilter

    assert max(IndependentSamples.of(noise(20_000, k)).above(2.5).unseen for k in range(20)) < 40.0
    correlated = lfilter([1.0], [1.0, -0.95], noise(20_000))
    assert IndependentSamples.of(correlated).above(6.0).unseen == 0.0
    x = noise(20_000)
    for start, long in zip(range(500, 20_000, 1500), (10, 20, 10, 40, 10, 20, 10, 160, 10, 20, 10, 40, 10)):
        x[start : start + long] += 9.0
    assert IndependentSamples.of(x).above(5.0).unseen > 8.0 * 120.0


def test_few_clusters_are_seen_beside_scattered_exceedances() -> None:
    """Two bursts above a limit that a tenth of the noise exceeds too, and bursts that reach above it now and then."""
    x = noise(20_000)
    assert IndependentSamples.of(x).above(1.28).unseen == 0.0
    x[4000:4100] += 5.0
    x[14_000:14_050] += 5.0
    assert IndependentSamples.of(x).above(1.28).unseen > 20.0 / 2.0 * 10.0 * 50.0
    assert IndependentSamples.of(x).above(6.5).unseen > 20.0 / 2.0 * 10.0 * 50.0


def test_a_persistent_motion_has_the_mean_of_few_samples() -> None:
    """Fractional noise: the power of its blocks is 2 H - 1; white and first-order noise have none in the long run."""
    from scipy.signal import lfilter

    def fractional(hurst: float, n: int, seed: int) -> np.ndarray:
        k = np.arange(n + 1.0)
        row = 0.5 * (np.abs(k - 1) ** (2 * hurst) - 2 * k ** (2 * hurst) + (k + 1) ** (2 * hurst))
        size = np.sqrt(np.maximum(np.fft.rfft(np.append(row, row[-2:0:-1])).real, 0.0))
        return np.fft.irfft(np.fft.rfft(noise(2 * n, seed)) * size)[:n]

    def share(make: object) -> float:
        return float(np.mean([persistence(np.column_stack([make(k), make(50 + k)])) > 0.0 for k in range(20)]))

    assert share(lambda k: fractional(0.9, 10_000, k)) > 0.6
    assert share(lambda k: fractional(0.7, 10_000, k)) == share(lambda k: noise(10_000, k)) == 0.0
    for pole in (0.8, 0.95, 0.99):
        assert share(lambda k, pole=pole: lfilter([1.0], [1.0, -pole], noise(10_000, k))) == 0.0
    e = np.column_stack([fractional(0.9, 10_000, 3), fractional(0.9, 10_000, 4)])
    assert IndependentSamples.of(np.hypot(*e.T), components=e).most < 10_000.0 ** (1.0 - 0.6)


def test_a_record_that_repeats_itself_has_the_windows_of_one_period() -> None:
    """The relative error at every instant has one independent sample a window at most: 250 in 5 s, not 2750 in 55."""
    repeated = np.tile(np.abs(noise(5000)), 11)
    assert IndependentSamples.of(repeated, cap=2750.0).most == pytest.approx(250.0)
    assert IndependentSamples.of(np.abs(noise(55_000)), cap=2750.0).most == pytest.approx(2750.0)
