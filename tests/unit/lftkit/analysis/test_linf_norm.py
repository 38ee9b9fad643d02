"""The largest gain on the axis: with poles on both sides, and beside the H-infinity norm, which is infinite there."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg
from support.slow_cases import slow

from lftkit import System, hinf_norm, linf_norm


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_it_is_the_largest_gain_on_the_axis(seed: int, dt: float | None) -> None:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    if dt:
        A = 1.4 * A / np.abs(linalg.eigvals(A)).max()
    system = A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), rng.standard_normal((3, 2))
    found = linf_norm(*system, dt=dt)
    grid = np.linspace(0.0, math.pi / dt, 4000) if dt else np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4000)])
    G = System(*system, [("u", 2)], [("y", 3)], dt=dt or 0.0)
    gains = [linalg.norm(response, 2) for response in G.response(grid)]
    assert max(gains) <= found.upper
    assert found.value <= found.upper <= found.value * (1.0 + 1e-6)
    assert found.value == pytest.approx(linalg.norm(G.response([found.omega])[0], 2), rel=1e-9)
    assert hinf_norm(*system, dt=dt).value == math.inf


def test_of_a_stable_system_it_is_the_h_infinity_norm() -> None:
    system = [[0.0, 1.0], [-1.0, -0.02]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    assert linf_norm(*system).value == pytest.approx(hinf_norm(*system).value, rel=1e-7)


def test_mirrored_poles_keep_the_gain() -> None:
    """1 / (s - a) and 1 / (s + a) have one gain at every frequency."""
    for a in (-3.0, 3.0):
        assert linf_norm([[a]], [[1.0]], [[1.0]], [[0.0]]).value == pytest.approx(1.0 / 3.0)


def test_a_pole_on_the_axis_has_no_finite_gain() -> None:
    assert linf_norm([[0.0]], [[1.0]], [[1.0]], [[0.0]]).value == math.inf
    assert linf_norm([[0.0, 2.0], [-2.0, 0.0]], np.eye(2), np.eye(2), np.zeros((2, 2))).value == math.inf
    for pole in (1.0, -1.0):
        assert linf_norm([[pole]], [[1.0]], [[1.0]], [[0.0]], dt=0.1).value == math.inf


def test_a_gain_without_states() -> None:
    assert linf_norm([], [], [], [[3.0, 4.0]]).value == pytest.approx(5.0)
