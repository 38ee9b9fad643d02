"""Transfer function of motion: closed forms, averages by brute force, and the law that bounds it by the variance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from pointing_analysis.image import motion_blur
from pointing_analysis.image.motion_blur import (
    centred,
    covariance,
    exposures,
    means,
    missing,
    motion_transfer,
    sizes,
    worst_transfer,
)

F = 1.3e6
"""[cycles/rad]"""


def path_of(x: Any, y: Any = 0.0) -> Any:
    x = np.asarray(x, dtype=float)
    return np.column_stack([x, np.broadcast_to(y, x.shape)])[None]


def random_paths(count: int, samples: int, size: float, seed: int) -> Any:
    return np.cumsum(np.random.default_rng(seed).standard_normal((count, samples + 1, 2)), axis=1) * size


def test_a_ramp_is_a_sinc() -> None:
    """Whatever the number of samples: the path is linear between them."""
    length, angle = 0.9e-6, 0.4
    ramp = np.linspace(-length / 2, length / 2, 21)
    path = path_of(ramp * math.cos(angle), ramp * math.sin(angle))
    frequencies = np.array([[0.0, 0.0], [F, 0.0], [0.3 * F, -0.8 * F], [5 * F, 2 * F]])
    along = frequencies @ [math.cos(angle), math.sin(angle)]
    assert np.abs(motion_transfer(path, frequencies)[0] - np.sinc(length * along)).max() < 1e-14


def test_a_tone_over_many_periods_is_a_bessel_function() -> None:
    """The polygon of 4000 chords a period lies inside the sine by 2e-7 of the amplitude."""
    phase = 2 * math.pi * np.arange(40 * 4000 + 1) / 4000
    for amplitude in (1e-8, 2e-7, 6e-7):
        path = path_of(amplitude * np.sin(phase))
        polygon = amplitude * (1 - (math.pi / 4000) ** 2 / 3)  # chords of the same mean square
        found = motion_transfer(path, np.array([[F, 0.0], [0.0, F]]))[0]
        assert abs(found[0] - special.j0(2 * math.pi * F * polygon)) < 1e-9
        assert abs(found[1] - 1.0) < 1e-15


def test_gaussian_motion_by_its_covariance() -> None:
    """Nodes of Gauss and Hermite, each for a time as long as its weight: the mean is that of the distribution."""
    node, weight = np.polynomial.hermite_e.hermegauss(60)
    sigma, weight = 8e-8, weight / weight.sum()
    for f in (0.5 * F, F, 2 * F):
        still = [motion_transfer(path_of([x, x]), np.array([[f, 0.0]]))[0, 0] for x in sigma * node]
        assert abs(np.dot(weight, still) - math.exp(-2 * math.pi**2 * sigma**2 * f**2)) < 1e-9


def test_against_averages_by_brute_force() -> None:
    """Gauss points on every segment, hundreds of times as many as needed for the accuracy asked for."""
    node, twice = np.polynomial.legendre.leggauss(40)
    s, weight = (node + 1) / 2, twice / 2
    for size in (1e-9, 1e-7, 2e-6):
        paths = random_paths(5, 20, size, 3)
        between = paths[:, :-1, None, :] * (1 - s[:, None]) + paths[:, 1:, None, :] * s[:, None]
        for f in ([F, 0.0], [-0.2 * F, 0.7 * F]):
            wave = np.exp(-2j * math.pi * between @ np.array(f))
            expected = (wave @ weight).mean(axis=1)
            assert np.abs(motion_transfer(paths, np.array([f]))[:, 0] - expected).max() < 1e-9


def test_frequencies_of_each_exposure_and_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    paths, f = random_paths(50, 10, 1e-7, 4), F * np.random.default_rng(5).standard_normal((50, 3, 2))
    together = motion_transfer(paths, f)
    alone = np.array([motion_transfer(p[None], g)[0] for p, g in zip(paths, f)])
    assert np.abs(together - alone).max() < 1e-15
    monkeypatch.setattr(motion_blur, "BLOCK", 40)
    assert np.abs(motion_transfer(paths, f) - together).max() < 1e-15


@given(st.integers(0, 2**32 - 1), st.floats(-9.0, -5.5), st.floats(0.0, math.pi), st.integers(1, 30))
def test_the_variance_bounds_the_loss(seed: int, exponent: float, angle: float, samples: int) -> None:
    """|M| >= 1 - 2 pi^2 f' C f and, below a quarter of a cycle, |M| >= cos(2 pi sqrt(f' C f))."""
    paths = random_paths(4, samples, 10**exponent, seed)
    f = F * np.array([math.cos(angle), math.sin(angle)])
    transfer = np.abs(motion_transfer(paths, f[None])[:, 0])
    spread = np.einsum("i,mij,j->m", f, covariance(paths), f)
    assert (transfer >= 1 - 2 * math.pi**2 * spread - 1e-12).all()
    near = 2 * math.pi * np.sqrt(spread)
    assert (transfer[near < math.pi / 2] >= np.cos(near[near < math.pi / 2]) - 1e-12).all()


def test_the_sharper_law_is_tight() -> None:
    """Half of the time at either end of a jump, all of the rms: the cosine itself."""
    paths = np.zeros((1, 20_001, 2))
    paths[:, 10_001:, 0] = 2e-7
    sigma = math.sqrt(covariance(paths)[0, 0, 0])
    found = abs(motion_transfer(paths, np.array([[F, 0.0]]))[0, 0])
    assert 0.0 <= found - math.cos(2 * math.pi * F * sigma) < 1e-4


def test_means_and_covariance_of_the_path_between_the_samples() -> None:
    paths = random_paths(6, 12, 1e-7, 6)
    s = (np.arange(2000) + 0.5)[:, None] / 2000
    fine = (paths[:, :-1, None] * (1 - s) + paths[:, 1:, None] * s).reshape(6, -1, 2)
    assert np.abs(means(paths) - fine.mean(axis=1)).max() < 1e-20
    expected = np.array([np.cov(x.T, bias=True) for x in fine])
    assert np.abs(covariance(paths) - expected).max() < 1e-7 * expected.max()
    assert np.abs(means(centred(paths))).max() < 1e-21
    assert np.allclose(sizes(paths), np.hypot(*np.moveaxis(centred(paths), -1, 0)).max(axis=1))


@pytest.mark.parametrize("size", [1e-9, 3e-8, 2e-7])
def test_the_worst_direction_is_that_of_a_fine_grid(size: float) -> None:
    paths, angles = random_paths(8, 20, size, 7), math.pi * np.arange(20_000) / 20_000
    transfer, angle = worst_transfer(paths, F)
    f = F * np.column_stack([np.cos(angles), np.sin(angles)])
    on_grid = np.array([np.abs(motion_transfer(x[None], f))[0].min() for x in centred(paths)])
    assert (transfer <= on_grid + 1e-12).all() and (transfer >= on_grid - 1e-6).all()
    there = F * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
    assert np.allclose(np.abs(motion_transfer(paths, there))[:, 0], transfer, atol=1e-12)


def test_exposures_share_their_ends() -> None:
    error = np.arange(24.0).reshape(12, 2)
    paths = exposures(error, 1e-3, 5e-3)
    assert paths.shape == (2, 6, 2)
    assert (paths[0, -1] == paths[1, 0]).all() and (paths[1, -1] == error[10]).all()
    error[5] = np.nan
    assert missing(exposures(error, 1e-3, 5e-3)).tolist() == [True, True]
    for n, text in ((5, "the run must last for one exposure of 0.005 s and a sample, got 5 samples of 0.001 s"),):
        with pytest.raises(ValueError, match=text):
            exposures(error[:n], 1e-3, 5e-3)
    with pytest.raises(ValueError, match="window must be a whole number"):
        exposures(error, 1e-3, 4.5e-3)
