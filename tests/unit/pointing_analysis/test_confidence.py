"""Confidence bounds hold what they promise, on independent and on correlated samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from pointing_analysis import confidence


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


@pytest.mark.parametrize("k", [0, 1, 5])
@pytest.mark.parametrize(("p", "c"), [(0.997, 0.95), (0.9, 0.99)])
def test_samples_needed_is_the_smallest_number(p: float, c: float, k: int) -> None:
    n = confidence.samples_needed(p, c, k)
    assert confidence.exceedance_upper(k, n, c) <= 1 - p < confidence.exceedance_upper(k, n - 1, c)


def test_order_statistic_bounds_against_the_binomial() -> None:
    """The bound is the smallest order statistic that lies above the quantile with the stated probability."""
    x = np.arange(2000.0)
    q = confidence.quantile(x, 0.99, 0.95, effective=2000)
    rank = int(q.upper) + 1
    assert stats.binom.cdf(rank - 1, 2000, 0.99) >= 0.95 > stats.binom.cdf(rank - 2, 2000, 0.99)
    rank = int(q.lower) + 1
    assert stats.binom.sf(rank - 1, 2000, 0.99) >= 0.95 > stats.binom.sf(rank, 2000, 0.99)


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, 0.98])
def test_autocorrelation_time_of_a_first_order_process(pole: float) -> None:
    rng = np.random.default_rng(int(100 * pole))
    x = lfilter([1], [1, -pole], rng.standard_normal(400_000))
    assert confidence.autocorrelation_time(x) == pytest.approx((1 + pole) / (2 * (1 - pole)), rel=0.06)


def test_autocorrelation_time_leaves_out_what_is_missing() -> None:
    x = np.random.default_rng(0).standard_normal(1000)
    assert confidence.effective_number(np.append(x, np.nan)) == confidence.effective_number(x)
    assert confidence.effective_number([np.nan, np.nan]) == 0


def test_a_constant_or_a_drift_is_hardly_any_information() -> None:
    assert confidence.effective_number(np.full(1000, 0.1)) == pytest.approx(1)
    assert confidence.effective_number(np.linspace(0, 1, 1000)) < 5


@pytest.mark.parametrize("pole", [0.0, 0.8, 0.97])
@pytest.mark.parametrize("p", [0.95, 0.99])
def test_bounds_cover_on_500_runs(pole: float, p: float) -> None:
    """Each one-sided 95 % bound covers the true quantile in at least 93 % of 500 runs, correlated or not."""
    rng = np.random.default_rng(7)
    n, runs = 4000, 500
    white = rng.standard_normal((runs, 2, n + 400))
    e = lfilter([math.sqrt(1 - pole**2)], [1, -pole], white, axis=2)[:, :, 400:]
    true = confidence.radial_factor(p)
    bounds = [confidence.quantile(np.hypot(*one), p, 0.95) for one in e]
    assert np.mean([b.upper >= true for b in bounds]) >= 0.93
    assert np.mean([b.lower <= true for b in bounds]) >= 0.93
    if pole < 0.9:  # they cover by being right, not by being infinite
        assert np.median([b.upper for b in bounds]) < 1.2 * true
        assert np.median([b.lower for b in bounds]) > 0.8 * true


def test_quantile_of_nothing_and_bad_probabilities() -> None:
    assert math.isnan(confidence.quantile([], 0.5).value)
    for call in (confidence.gaussian_factor, confidence.radial_factor):
        with pytest.raises(ValueError, match="between 0 and 1"):
            call(1.0)
    with pytest.raises(ValueError, match="between 0 and 1"):
        confidence.quantile([1.0], 99.7)


def test_length_of_run_that_would_decide() -> None:
    assert confidence.samples_to_decide(0.997, 0.95, 0.0) == 998
    good = confidence.samples_to_decide(0.997, 0.95, 0.001)
    assert confidence.exceedance_upper(math.ceil(0.001 * good), int(good), 0.95) <= 0.003
    bad = confidence.samples_to_decide(0.997, 0.95, 0.01)
    assert confidence.exceedance_lower(int(0.01 * bad), int(bad), 0.95) > 0.003
    assert confidence.samples_to_decide(0.997, 0.95, 0.003) == math.inf
