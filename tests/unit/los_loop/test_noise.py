"""Sensor noise in the line of sight: its correlation against the power density, and sums that it must obey."""

from __future__ import annotations

import numpy as np
import pytest
from small_loop import small_controllers, small_plant

from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.noise import correlation, covariances, covariances_in_window
from los_loop.sampled_loop import SampledLoop
from titop_plant.telescope.load import load_telescope

SIGMA = 1e-3 * np.linspace(0.5, 2.0, 22)
TICKS = 40000


def loop(frame_ticks: int) -> SampledLoop:
    return sampled_loop(small_plant(), ControlLaws(*small_controllers(), "fsm+pma"), frame_ticks=frame_ticks)


def test_the_correlation_is_the_transform_of_the_power_density() -> None:
    """Of a loop with a sample of every sensor at each tick: a sum over frequencies, exact once it has decayed."""
    own = loop(1)
    poles, vectors = np.linalg.eig(own.frame)
    left, right = np.linalg.solve(vectors, own.noise_frame * SIGMA), own.truth @ vectors
    z = np.exp(2j * np.pi * np.arange(TICKS) / TICKS)
    G = np.einsum("ik,kn,kj->nij", right, 1.0 / (z - poles[:, None]), left)
    density = G @ G.conj().swapaxes(1, 2)
    found = correlation(own, SIGMA)
    for lag in (0, 1, 7, 30):
        expected = np.mean(density * z[:, None, None] ** lag, axis=0).real
        np.testing.assert_allclose(found(lag), expected, rtol=1e-6, atol=1e-9 * np.abs(found(0)).max())


@pytest.mark.parametrize("frame_ticks", [1, 20])
def test_without_a_lag_it_is_the_covariance(frame_ticks: int) -> None:
    telescope, own = load_telescope(), loop(frame_ticks)
    plain, _ = covariances(own, telescope, None)
    found = correlation(own, telescope.loop_ports.reference.noise)(0)
    np.testing.assert_allclose(found, plain, rtol=1e-9)
    np.testing.assert_allclose(found, found.T, rtol=1e-9)


def test_a_unit_divides_the_line_of_sight() -> None:
    own = loop(20)
    one, thousandth = correlation(own, SIGMA)(3), correlation(own, SIGMA, unit=1e-3)(3)
    np.testing.assert_allclose(thousandth, 1e6 * one, rtol=1e-12)


@pytest.mark.parametrize("ticks", [1, 2, 9])
def test_what_is_within_a_window_is_the_whole_less_its_mean(ticks: int) -> None:
    """The mean square of x less its mean is that of x, less that of the mean; of one tick nothing is left."""
    found = correlation(loop(20), SIGMA)
    within = covariances_in_window(found, ticks)
    assert within.shape == (ticks, 2, 2)
    of_mean = np.mean(
        [[found(j - i) if j >= i else found(i - j).T for j in range(ticks)] for i in range(ticks)], (0, 1)
    )
    np.testing.assert_allclose(within.mean(axis=0), found(0) - of_mean, atol=1e-9 * np.abs(found(0)).max())


def test_a_window_that_is_no_whole_number_of_ticks_has_them_by_their_share() -> None:
    """The mean over the begins of disjoint windows, in closed form for white noise: 1 less the mean of the squares."""
    within = covariances_in_window(lambda lag: np.eye(2) * (lag == 0), 2.5)
    squares = [(1 + 1 + 0.25) / 2.5**2, (0.25 + 1 + 1) / 2.5**2]  # of the weights of windows that begin at 0 and 0.5
    np.testing.assert_allclose(within.mean(axis=0), (1 - np.mean(squares)) * np.eye(2), atol=1e-12)
