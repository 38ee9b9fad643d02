"""Disk margins of several loops: closed forms, an oracle for two loops, factors that are borne and that are not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit import System, append, disk_margin, s
from lftkit.analysis.margins import sensitivity
from lftkit.proofs import check_proof, disk_margins
from lftkit.systems.sampled.bilinear import to_discrete

A_SPIN = 10.0


def satellite() -> System:
    """Spinning satellite (Seiler, Packard and Gahinet 2020; Zhou, Doyle and Glover 1996)."""
    G = [[1.0, A_SPIN], [-A_SPIN, 1.0]]
    return System([[0.0, A_SPIN], [-A_SPIN, 0.0]], np.eye(2), G, np.zeros((2, 2)), [("u", 2)], [("y", 2)])


def random(seed: int, channels: int = 2, states: int = 3) -> System:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A -= (linalg.eigvals(A).real.max() + 0.5) * np.eye(states)
    B, C = 0.4 * rng.standard_normal((states, channels)), 0.6 * rng.standard_normal((channels, states))
    return System(A, B, C, np.zeros((channels, channels)), [("u", channels)], [("y", channels)])


def of_two(L: System, skew: float) -> float:
    """Margin of two loops: mu of a 2 x 2 matrix for a diagonal is the largest spectral radius over one phase."""
    phases = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    S = System(*sensitivity(L), L.inputs, L.inputs)
    largest = 0.0
    for M in S.response([0.0, *np.geomspace(1e-3, 1e3, 600)]):
        shifted = M + 0.5 * (skew - 1.0) * np.eye(2)
        turned = shifted[None] * np.stack([np.ones_like(phases), phases], axis=1)[:, None, :]
        largest = max(largest, float(np.abs(np.linalg.eigvals(turned)).max()))
    return 1.0 / largest


def poles_with(L: System, factors: Any) -> Any:
    A, B, C, D = L.matrices
    assert not D.any()
    return linalg.eigvals(A - B @ np.diag(factors) @ C)


@pytest.mark.parametrize(("seed", "skew"), [(0, -0.5), (1, 0.0), (2, 1.0)])
def test_two_loops_have_the_margin_of_the_largest_spectral_radius(seed: int, skew: float) -> None:
    L = random(seed)
    found = disk_margins(L, skew)
    expected = of_two(L, skew)
    assert found.together.lower <= expected
    assert found.together.upper == pytest.approx(expected, rel=2e-2)
    assert found.together.lower >= 0.97 * found.together.upper
    assert check_proof(found.together.gain_bounds.proof).stable
    assert found.together.upper <= min(one.size for one in found.each)


@pytest.mark.parametrize("seed", range(3))
def test_every_factor_of_the_disks_is_borne(seed: int) -> None:
    L = random(seed, channels=3, states=4)
    found = disk_margins(L)
    rng = np.random.default_rng(seed)
    a = 0.999 * min(found.together.lower, 1.9)
    for _ in range(200):
        d = a * np.exp(2j * np.pi * rng.uniform(size=3))
        assert poles_with(L, (2.0 + d) / (2.0 - d)).real.max() < 0.0
    low, high = found.together.gain_margins
    for factors in np.meshgrid([low * 1.001, 1.0, min(high, 1e3) * 0.999], [low * 1.001, 1.0], [1.0]):
        for one in np.reshape(factors, -1):
            assert poles_with(L, [one, 1.0, low * 1.001]).real.max() < 0.0


def test_the_satellite_bears_each_loop_alone_and_not_both() -> None:
    """Loop by loop every gain is borne; with both a tenth is enough, as of S - T, whose entries are 1/2 and 10."""
    found = disk_margins(satellite())
    assert [one.size for one in found.each] == pytest.approx([2.0, 2.0])
    assert [one.gain for one in found.each] == [(pytest.approx(0.0, abs=1e-6), pytest.approx(math.inf))] * 2 or all(
        one.gain[1] > 1e6 for one in found.each
    )
    assert 0.0985 < found.together.lower <= found.together.upper < 0.1
    assert found.together.upper == pytest.approx(of_two(satellite(), 0.0), rel=1e-3)


def test_uncoupled_loops_have_their_own_margins() -> None:
    one, two = 25 / (s**3 + 10 * s**2 + 10 * s + 10), 3 / (s * (0.2 * s + 1))
    found = disk_margins(append(one.system("u1", "y1"), two.system("u2", "y2")))
    alone = [disk_margin(e.system("u", "y")) for e in (one, two)]
    assert [m.size for m in found.each] == pytest.approx([m.size for m in alone])
    assert [m.omega for m in found.each] == pytest.approx([m.omega for m in alone], rel=1e-3)
    assert found.together.upper == pytest.approx(min(m.size for m in alone), rel=1e-2)


def test_a_sampled_image_has_the_same_margins() -> None:
    L = random(1)
    image = System(*to_discrete(*L.matrices, 0.1), L.inputs, L.outputs, dt=0.1)
    first, second = disk_margins(L), disk_margins(image)
    assert [one.size for one in second.each] == pytest.approx([one.size for one in first.each], rel=1e-6)
    assert second.together.upper == pytest.approx(first.together.upper, rel=1e-2)


def test_an_unstable_loop_has_none_and_what_is_no_loop_is_refused() -> None:
    L = append((100 / (s + 1) ** 3).system("u1", "y1"), (1 / (s + 1)).system("u2", "y2"))
    found = disk_margins(L)
    assert found.together.lower == found.together.upper == 0.0
    assert found.together.gain_bounds.status == "unstable"
    with pytest.raises(ValueError, match="must have as many inputs as outputs"):
        disk_margins(System([[-1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], [("u", 2)], [("y", 1)]))
