"""Spectral densities whose first row is at 0 Hz, which has no place on a logarithmic axis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal as spectra

from titop_plant.simulation.sources.signals import noise_of_density

DT = 1e-3


def noise(frequency: list[float], density: list[float], seconds: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and density of noise that is made of the rows, with the lowest frequencies resolved."""
    table = np.zeros((len(frequency), 6))
    table[:, 4] = density
    one = noise_of_density(np.array(frequency), table, seconds, DT, np.random.default_rng(4))
    return spectra.welch(one.values[:, 4], one.rate, nperseg=8192)


def test_the_density_of_the_row_at_0_hz_reaches_to_the_next_row() -> None:
    found, power = noise([0.0, 40.0], [4.0, 4.0])
    inside = (found > 0.5) & (found < 39.0)
    assert power[inside].mean() == pytest.approx(4.0, rel=0.1)
    assert np.sqrt(np.trapezoid(power, found)) == pytest.approx(np.sqrt(4.0 * 40.0), rel=0.05)


def test_the_row_at_0_hz_changes_little_where_the_next_row_is_near() -> None:
    near, far = (noise([first, 0.02, 40.0], [4.0, 4.0, 4.0])[1] for first in (0.0, 0.01))
    assert near.sum() == pytest.approx(far.sum(), rel=0.1)


def test_the_first_segment_falls_from_the_density_of_the_row_at_0_hz() -> None:
    """From 4 at the lowest frequency, 1 / T, to 0.04 at 40 Hz: a straight line on logarithmic axes."""
    found, power = noise([0.0, 40.0], [4.0, 0.04])
    near = np.abs(found - 1.0) < 0.3
    lowest = 1.0 / 102.0
    expected = 4.0 * 0.01 ** (np.log(1.0 / lowest) / np.log(40.0 / lowest))
    assert power[near].mean() == pytest.approx(expected, rel=0.3)


def test_rows_below_the_lowest_frequency_of_a_short_run_do_no_harm() -> None:
    found, power = noise([0.0, 1e-4, 40.0], [4.0, 4.0, 4.0], 20.0)
    assert np.isfinite(power).all()
    assert power[(found > 0.5) & (found < 39.0)].mean() == pytest.approx(4.0, rel=0.2)
