"""Independent exceedances of one record: bursts count once, what is independent counts as it is."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.indices.confidence import effective_number
from pointing_analysis.indices.exceedances import IndependentSamples, _moments, block_factor, inflation, pooled_number


def noise(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize("limit", [-1.0, 0.0, 1.3, 2.6, 6.0])
def test_independent_samples_count_as_they_are(limit: float) -> None:
    counts = [IndependentSamples.of(noise(5000, seed)).above(limit) for seed in range(40)]
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
        ratios.append(found.above(5.0) * np.mean(x >= 5.0) / 40.0)
        assert found.above(5.0) <= found.most <= found.correlated <= 40_000
    assert 0.5 < np.median(ratios) < 1.3


def test_a_burst_of_which_little_exceeds_is_seen_by_what_is_below_the_limit() -> None:
    x = noise(10_000)
    x[5000:5030] = 4.0 + 0.01 * np.arange(30)
    alone = IndependentSamples.of(x)
    assert alone.above(4.285) < 1500 and effective_number(x) > 7000
    x[5000:5030] = noise(30, 2)
    assert IndependentSamples.of(x).above(4.285) > 7000


def test_a_slow_change_of_the_size_is_seen_where_no_limit_is_near() -> None:
    """The correlation of the values does not see it under the noise."""
    rng, n = np.random.default_rng(3), 20_000
    x = np.abs(rng.standard_normal(n)) * np.exp(0.3 * np.sin(2.0 * np.pi * np.arange(n) / 8000.0))
    assert effective_number(x) > 0.5 * n and IndependentSamples.of(x).above(99.0) < 0.05 * n


def test_signs_scales_gaps_and_constants() -> None:
    x = np.repeat(noise(300), 7)
    found = IndependentSamples.of(x)
    assert IndependentSamples.of(-x).above(-1.5, lower=True) == found.above(1.5)
    assert IndependentSamples.of(1e-9 * x).above(1.5e-9) == pytest.approx(found.above(1.5))
    assert IndependentSamples.of(np.append(x, np.nan)).above(1.5) == found.above(1.5)
    assert IndependentSamples.of(x, cap=20.0).above(1.5) == 20.0
    assert IndependentSamples.of(np.full(1000, 0.1)).above(0.05) == 1.0
    assert IndependentSamples.of([np.nan]).above(0.0) == 0.0
    for few in range(1, 9):
        assert 1.0 <= IndependentSamples.of(noise(few)).above(0.0) <= few


def test_a_record_that_repeats_itself_is_one_period() -> None:
    """Of 600 s of a tone of 1.7 Hz at 100 Hz there are 500 phases of its size: none may be in a tenth of a per cent."""
    phase = 2.0 * np.pi * 0.017 * np.arange(60_000)
    size = np.abs(np.cos(phase + 0.3))
    assert IndependentSamples.of(size).above(0.9999) <= 500
    assert IndependentSamples.of(np.abs(np.cos(3.0**0.5 / 1.7 * phase))).most > 10_000
    assert IndependentSamples.of(np.round(np.abs(noise(5000)), 1)).most > 4000, "values of few digits do not repeat"


def test_blocks_of_a_long_record_are_those_of_a_short_one() -> None:
    """Record by record and in parts: the sums of squares are those of the blocks."""
    for n in (1, 5, 64, 1000, 300_001):
        x = noise(n)
        blocks, squares, fourth = _moments(lambda part, x=x: x[part], n)
        for level, size in enumerate(2 ** np.arange(len(blocks))):
            sums = x[: n // size * size].reshape(-1, size).sum(axis=1)
            assert (blocks[level], squares[level]) == (len(sums), pytest.approx(np.sum(sums**2)))
            assert fourth[level] == pytest.approx(np.sum(sums**4))


def test_the_factor_is_that_of_the_correlation() -> None:
    """Of a first-order process with pole 0.9 it is (1 + 0.9) / (1 - 0.9) = 19."""
    from scipy.signal import lfilter

    x = lfilter([1.0], [1.0, -0.9], noise(400_000))
    found = block_factor(lambda part: x[part] - x.mean(), len(x), float(x.var()), 19.0)
    assert 19.0 < found < 24.0
    assert block_factor(lambda part: 0.0 * x[part], len(x), 0.0, 1.0) == 0.0


def test_an_uncertain_variance_is_taken_larger() -> None:
    """Student's and the normal quantile: 1.895 and 1.645 at seven degrees of freedom."""
    assert inflation(7.0) == pytest.approx((1.894579 / 1.644854) ** 2, rel=1e-5)
    assert np.all(np.diff(inflation(np.arange(1.0, 50.0))) < 0.0) and inflation(0.0) == inflation(1.0)


def test_runs_that_scatter_are_the_samples() -> None:
    rng = np.random.default_rng(5)
    alike = pooled_number(rng.binomial(1000, 0.1, 20) / 1000, [1000.0] * 20)
    assert alike == pytest.approx(20_000)
    assert 50.0 < pooled_number(rng.beta(1.0, 9.0, 20), [1000.0] * 20) < 1000.0, "220 on average"
    assert pooled_number([0.2], [50.0]) == pytest.approx(50.0)
    assert pooled_number([0.1, 0.1], [10.0, 10.0], [3.0, 1.0]) == pytest.approx(16.0)
