"""Quantiles, windows and bounds of the histogram of durations."""

import numpy as np
import pytest
from los_testbed.run.loop.latency_histogram import LatencyHistogram


@pytest.mark.parametrize("probability", [0.01, 0.5, 0.9, 0.99, 0.999, 1.0])
def test_quantiles_of_durations_agree_with_numpy(probability):
    values = np.random.default_rng(2).gamma(2.0, 150_000, 5000).astype(int)
    durations = LatencyHistogram()
    for value in values:
        durations.add(int(value))
    expected = np.quantile(values, probability, method="inverted_cdf") / 1000
    assert expected - 1 <= durations.quantiles_us((probability,))[0] <= expected
    assert durations.maximum_us == values.max() / 1000
    assert durations.mean_us == pytest.approx(values.mean() / 1000)


def test_durations_of_any_size_are_kept_in_bounds():
    durations = LatencyHistogram()
    assert np.isnan(durations.quantiles_us((0.5,))[0])
    for value in (-5_000, 0, 10**12):
        durations.add(value)
    assert durations.quantiles_us((0.3,))[0] == 0
    assert durations.quantiles_us((1.0,))[0] == 10**9


def test_a_window_holds_what_came_since_the_last_one():
    durations = LatencyHistogram()
    for value in (9_000_000, 1_000_000):
        durations.add(value)
    assert durations.window("x") == {"x_mean_us": 5000.0, "x_max_us": 9000.0}
    durations.add(2_000_000)
    assert durations.window("x") == {"x_mean_us": 2000.0, "x_max_us": 2000.0}
    assert durations.maximum_us == 9000.0
    assert durations.histogram() == {1000: 1, 2000: 1, 9000: 1}
