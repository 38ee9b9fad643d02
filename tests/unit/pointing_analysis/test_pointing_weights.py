"""Spectral weights against the numbers of the design pages and against one another."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis import weights

WINDOW = 0.02


@pytest.mark.parametrize(
    ("hertz", "exact", "rational"),
    [
        (1, 0.036266, 0.036276),
        (10, 0.353355, 0.360016),
        (25, 0.771178, 0.774485),
        (50, 1.0, 0.966350),
        (100, 1.0, 0.997327),
    ],
)
def test_values_for_twenty_milliseconds(hertz: float, exact: float, rational: float) -> None:
    omega = 2 * np.pi * hertz
    assert weights.rpe_exact(omega, WINDOW) == pytest.approx(exact, abs=6e-7)
    assert weights.rpe_rational(omega, WINDOW) == pytest.approx(rational, abs=6e-7)


def test_rational_weight_is_no_upper_bound() -> None:
    ratio, y = weights.worst_ratio()
    assert ratio == pytest.approx(1.045, abs=5e-4)
    assert y / (2 * np.pi * WINDOW) == pytest.approx(42, abs=1)
    assert weights.rpe_exact(y, 1.0) > weights.rpe_rational(y, 1.0)


def test_mean_and_rpe_weights_are_complementary() -> None:
    omega = np.geomspace(1e-6, 1e5, 400)
    total = weights.mean_exact(omega, WINDOW) ** 2 + weights.rpe_exact(omega, WINDOW) ** 2
    assert np.allclose(total, 1, atol=1e-12)


def test_no_digits_are_lost_at_low_frequency() -> None:
    omega = np.geomspace(1e-9, 0.2, 50)
    y = omega * WINDOW
    assert np.allclose(weights.rpe_exact(omega, WINDOW), y / np.sqrt(12), rtol=1e-6)


def test_discrete_weight_tends_to_the_continuous_one() -> None:
    omega = np.geomspace(1, 1000, 50)
    coarse = np.abs(weights.rpe_discrete(omega, 20, 1e-3) - weights.rpe_exact(omega, WINDOW)).max()
    fine = np.abs(weights.rpe_discrete(omega, 2000, 1e-5) - weights.rpe_exact(omega, WINDOW)).max()
    assert fine < 1e-3 * coarse
    assert weights.rpe_discrete(0.0, 20, 1e-3) == 0


def test_drift_weights() -> None:
    omega = np.linspace(0, 100, 50)
    assert np.allclose(weights.drift_exact(omega, 0.1), np.sqrt(2 * (1 - np.cos(omega * 0.1))))
    both = weights.pde_exact(omega, WINDOW, 0.1)
    assert np.allclose(both, weights.mean_exact(omega, WINDOW) * weights.drift_exact(omega, 0.1))
