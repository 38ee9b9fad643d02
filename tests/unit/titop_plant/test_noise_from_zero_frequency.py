"""Spectral densities whose first row is at 0 Hz, which has no place on a logarithmic axis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal as spectra

from titop_plant.disturbances.signals import noise_of_density

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


@pytest.mark.parametrize("first", [0.0, 1.0, 4.0, 100.0])
def test_the_first_segment_is_straight_on_linear_axes_whatever_the_length_of_the_run(first: float) -> None:
    """The row at 0 Hz of a Welch table is little but the mean: it must not count more in a shorter run."""
    expected = 40.0 * (first + 4.0) / 2
    for seconds in (5.0, 100.0):
        found, power = noise([0.0, 40.0], [first, 4.0], seconds)
        assert np.trapezoid(power, found) == pytest.approx(expected, rel=0.15)


def test_rows_below_the_lowest_frequency_of_a_short_run_do_no_harm() -> None:
    found, power = noise([0.0, 1e-4, 40.0], [4.0, 4.0, 4.0], 20.0)
    assert np.isfinite(power).all()
    assert power[(found > 0.5) & (found < 39.0)].mean() == pytest.approx(4.0, rel=0.2)
