"""The largest gain of a member over a band, as a search finds it, against the norm that is bracketed."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import System
from lftkit.analysis.norms import band_gain
from lftkit.proofs.state_space.disk_search import DiskSearch
from lftkit.proofs.state_space.search import member_gain

CLOSE = 1e-3
"""Share of the largest gain that a search may miss."""


def modes_and_lags(rng: np.random.Generator) -> System:
    """Modes with damping ratios from 1e-4 on, from 0.1 to 1000 rad/s, and some lags beside them."""
    count, lags = int(rng.integers(1, 9)), int(rng.integers(0, 3))
    w, zeta = np.sort(10.0 ** rng.uniform(-1.0, 3.0, count)), 10.0 ** rng.uniform(-4.0, -0.2, count)
    n = 2 * count + lags
    A = np.zeros((n, n))
    A[:count, count : 2 * count] = np.eye(count)
    A[count : 2 * count, :count] = -np.diag(w**2)
    A[count : 2 * count, count : 2 * count] = -np.diag(2.0 * zeta * w)
    A[2 * count :, 2 * count :] = -np.diag(10.0 ** rng.uniform(-2.0, 3.0, lags))
    D = rng.integers(0, 2) * rng.normal(size=(2, 2))
    return System(A, rng.normal(size=(n, 2)), rng.normal(size=(2, n)), D, [("u", 2)], [("y", 2)])


@pytest.mark.parametrize("seed", range(6))
def test_the_peak_in_a_band_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = modes_and_lags(rng)
    low = 10.0 ** rng.uniform(-2.0, 2.0) if seed % 3 else 0.0
    high = low + 10.0 ** rng.uniform(-1.0, 3.0) if seed % 5 else np.inf
    expected = band_gain(*system.matrices, (low, high)).upper
    for found in (member_gain(system, np.zeros(0), (low, high)), DiskSearch(system, [], (low, high), 0).largest_gain()):
        assert low <= found.frequency <= high
        assert expected * (1.0 - CLOSE) <= found.gain <= expected * (1.0 + 1e-9)


def test_a_slow_resonance_far_below_the_fastest_pole_is_found() -> None:
    """The grid begins at the slowest pole, however fast the others are."""
    A = np.array([[0.0, 1.0, 0.0], [-1e-4, -2e-5, 0.0], [0.0, 0.0, -1e4]])
    system = System(A, [[0.0], [1.0], [1.0]], [[1.0, 0.0, 1.0]], [[0.0]], [("u", 1)], [("y", 1)])
    for band in ((1e-3, np.inf), (0.0, 1e6)):
        found = member_gain(system, np.zeros(0), band)
        assert found.frequency == pytest.approx(0.01, rel=1e-3) and found.gain == pytest.approx(5e6, rel=1e-3)
