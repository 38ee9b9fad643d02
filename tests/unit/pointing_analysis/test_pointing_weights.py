"""Spectral weights against the numbers of the design pages and against one another."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.indices import weights
from titop_plant.telescope.weights import relative_error_weight, rpe_weight

WINDOW = 0.02


@pytest.mark.parametrize(("hertz", "exact"), [(1, 0.036266), (10, 0.353355), (25, 0.771178), (50, 1.0), (100, 1.0)])
def test_values_for_twenty_milliseconds(hertz: float, exact: float) -> None:
    assert weights.rpe_exact(2 * np.pi * hertz, WINDOW) == pytest.approx(exact, abs=6e-7)


def test_the_rational_weight_of_the_synthesis_is_no_upper_bound() -> None:
    """Its system and its magnitude agree, and the exact weight is up to 4.5 % larger, near 42 Hz."""
    omega = 2 * np.pi * np.arange(1.0, 100.0, 0.25)
    rational = rpe_weight(omega, WINDOW)
    system = relative_error_weight(WINDOW, 1).nominal()
    np.testing.assert_allclose([abs(complex(system(1j * w))) for w in omega], rational, rtol=1e-12)
    ratio = weights.rpe_exact(omega, WINDOW) / rational
    assert ratio.max() == pytest.approx(1.045, abs=5e-4)
    assert omega[ratio.argmax()] / (2 * np.pi) == pytest.approx(42, abs=1)


def test_mean_and_rpe_weights_are_complementary() -> None:
    omega = np.geomspace(1e-6, 1e5, 400)
    total = np.sinc(omega * WINDOW / (2 * np.pi)) ** 2 + weights.rpe_exact(omega, WINDOW) ** 2
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
