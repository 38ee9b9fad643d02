"""Fits of a gain: what is exactly of the order is found, envelopes stay above, and every fit is minimum phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import InputError, System
from lftkit.analysis.magnitude_fit import fit_magnitude

OMEGA = np.geomspace(0.01, 100.0, 60)
JW = 1j * OMEGA


def gain(system: System) -> Any:
    return np.abs(system.response(OMEGA)[:, 0, 0])


@pytest.mark.parametrize(
    ("response", "order"),
    [
        (3.0 + 0.0 * JW, 0),
        ((JW - 2.0) / (JW - 0.5), 1),
        ((JW**2 - 0.2 * JW + 4.0) / (JW**2 + 0.1 * JW + 1.0), 2),
        ((JW**2 + 0.2 * JW + 4.0) / (JW**2 + 0.1 * JW + 1.0) * (3.0 * JW + 1.0) / (0.1 * JW + 1.0), 3),
    ],
)
def test_a_gain_of_that_order_is_found(response: Any, order: int) -> None:
    found = fit_magnitude(OMEGA, np.abs(response), order)
    assert found.order == order
    assert gain(found) == pytest.approx(np.abs(response), rel=1e-6)


@pytest.mark.further
@pytest.mark.parametrize(
    ("order", "seed", "dt"), [(0, 0, 0.02), (1, 1, 0.0), (2, 0, 0.02), pytest.param(3, 1, 0.0, marks=pytest.mark.slow)]
)
def test_an_envelope_is_above_and_minimum_phase(order: int, seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    wanted = np.exp(0.7 * rng.standard_normal(len(OMEGA))) / np.abs(1.0 + JW)
    found = fit_magnitude(OMEGA, wanted, order, above=True, dt=dt)
    assert np.all(gain(found) >= wanted)
    assert (gain(found) / wanted).min() == pytest.approx(1.0, abs=1e-6), "no more than is needed"
    for system in (found, found.inverse()):
        poles = system.poles()
        assert np.all(np.abs(poles) < 1.0) if dt else np.all(poles.real < 0.0)
    lower = fit_magnitude(OMEGA, wanted, order, dt=dt)
    raised = gain(lower) * (wanted / gain(lower)).max()
    assert (gain(found) / wanted).max() <= (raised / wanted).max() * (1.0 + 1e-6), "no worse than least squares, raised"


def test_a_weight_says_where_the_fit_counts() -> None:
    wanted = np.where(OMEGA < 1.0, 1.0, 10.0)
    low = fit_magnitude(OMEGA, wanted, 0, weight=np.where(OMEGA < 1.0, 1.0, 1e-3))
    assert abs(low.D.item()) == pytest.approx(1.0, rel=1e-3)


def test_units_of_frequency_do_not_matter() -> None:
    wanted = np.abs((JW + 1.0) / (JW + 10.0))
    fast = fit_magnitude(1e6 * OMEGA, wanted, 1)
    assert fast.poles().real == pytest.approx([-1e7], rel=1e-5)


@pytest.mark.parametrize(
    ("omega", "magnitude", "order", "message"),
    [
        ([1.0, 2.0], [1.0], 1, "omega and magnitude must be as many numbers"),
        ([0.0, 2.0], [1.0, 1.0], 1, "omega must be positive, finite and rising"),
        ([2.0, 1.0], [1.0, 1.0], 1, "omega must be positive, finite and rising"),
        ([1.0, 2.0], [1.0, 0.0], 1, "magnitude must be positive and finite, got 0.0 to 1.0"),
        ([1.0, 2.0], [1.0, 1.0], -1, "order must be at least 0, got -1"),
        ([1.0, 2.0], [1.0, 1.0], 1.5, "order must be an integer, got 1.5"),
        ("low", [1.0], 1, "omega must be a vector of finite numbers, got str"),
        ([1.0], 1j, 1, "magnitude must be a rectangular array of real numbers, got complex"),
    ],
)
def test_what_cannot_be_fitted_is_refused(omega: Any, magnitude: Any, order: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_magnitude(omega, magnitude, order)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 2.0}, "omega must be below pi / dt"),
        ({"dt": "fast"}, "dt must be a finite real number, got 'fast'"),
        ({"dt": -1.0}, "dt must be positive, got -1.0"),
        ({"weight": [1.0]}, "weight must be 2 finite numbers, zero or positive, not all zero"),
        ({"weight": [1.0, np.nan]}, "weight must be 2 finite numbers"),
        ({"weight": "some"}, "weight must be a rectangular array of real numbers, got str"),
    ],
)
def test_options_of_a_fit_that_mean_nothing_are_refused(options: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_magnitude([1.0, 2.0], [1.0, 1.0], 1, **options)
