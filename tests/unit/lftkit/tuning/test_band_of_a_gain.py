"""Gains of which a band of frequencies counts: norm, tuner, certificate and worst case see nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from support.tuned_plants import STATIC, lag, tuned_plant

from lftkit.analysis.norms import band_gain, hinf_norm
from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, WorstCaseOptions, tune, worst_case

BAND = (2.0, 10.0)


@pytest.mark.parametrize("seed", range(4))
def test_gain_of_a_band_is_that_of_a_fine_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(1, 9)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-3, 0)) * np.eye(n)
    B, C, D = rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)) * (seed % 2)
    low = 10.0 ** rng.uniform(-2, 1)
    band = (low, np.inf if seed % 3 == 0 else low * 10.0 ** rng.uniform(0.1, 2))
    found = band_gain(A, B, C, D, band)
    top = band[1] if np.isfinite(band[1]) else 1e4 * low
    grid = np.unique(np.concatenate([np.geomspace(low, top, 4000), np.abs(np.linalg.eigvals(A))]))
    grid = grid[(grid >= band[0]) & (grid <= band[1])]
    gains = [np.linalg.norm(D + C @ np.linalg.solve(1j * w * np.eye(n) - A, B), 2) for w in grid]
    assert max(gains) <= found.upper and found.value >= max(gains) * (1.0 - 1e-6)
    assert found.value <= found.upper <= found.value * (1.0 + 2e-6) and band[0] <= found.omega <= band[1]
    assert found.value <= hinf_norm(A, B, C, D).upper


def test_the_tuner_lowers_the_gain_in_the_band_and_certifies_it() -> None:
    """With u = k y the gain is 1 / (s + 1 - k) and the command's -k / (s + 1 - k), held at 0.8 from 2 rad/s on."""
    goals = [HinfGain("w", "z", band=BAND), HinfGain("w", "effort", bound=0.8, hard=True, band=(2.0, np.inf))]
    result = tune([lag()], goals, STATIC, initial=[[-0.5]], options=TuningOptions(starts=0))
    # k^2 = 0.64 (4 + (1 - k)^2): the positive root of 0.36 q^2 - 1.28 q - 3.2 with q = -k
    q = (1.28 + np.sqrt(1.28**2 + 4 * 0.36 * 3.2)) / 0.72
    assert result.status == "converged" and -result.x[0] == pytest.approx(q, rel=2e-3)
    assert result.soft == pytest.approx(1.0 / np.hypot(2.0, 1.0 + q), rel=2e-3)
    assert result.certificate is not None and result.peak_frequencies[0, 0] == 2.0
    assert result.certificate.upper[0, 0] < 1.0 / (1.0 + q), "the gain at frequency zero is larger, and does not count"


def test_the_worst_case_is_that_of_the_band() -> None:
    """A resonance that the parameter moves through the band: worst where it is inside, not where it is highest."""

    def build(p: dict[str, float]) -> System:
        k = p["k"]
        return tuned_plant([[0, 1], [-k, -0.02 * k]], [[0, 0], [1, 1]], [[1, 0], [1, 0]])

    none = System.static([[0.0]], [("y", 1)], [("u", 1)])
    options = WorstCaseOptions(samples=60, climbs=3, iterations=30)
    (found,) = worst_case(build, {"k": (0.5, 30.0)}, none, [HinfGain("w", "z", band=BAND)], options=options)
    (whole,) = worst_case(build, {"k": (0.5, 30.0)}, none, [HinfGain("w", "z")], options=options)
    assert whole.parameters["k"] == pytest.approx(0.5) and whole.omega < 1.0
    k, w = np.meshgrid(np.linspace(3.9, 4.5, 601), np.linspace(2.0, 2.2, 41))
    scan = float((1.0 / np.abs(k - w * w + 0.02j * k * w)).max())
    assert found.value == pytest.approx(scan, rel=2e-2) and 2.0 <= found.omega <= 2.1
