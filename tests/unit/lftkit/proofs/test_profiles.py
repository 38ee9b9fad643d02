"""Bounds over frequency and disk margins: against members, grids, closed forms and brackets."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.uncertain_examples import aligned_modes

from lftkit import RealParameter, System, append, dynamic, feedback, real, s, z
from lftkit.analysis.margins import disk_gains, disk_phase, sensitivity
from lftkit.analysis.norms import band_gain
from lftkit.proofs import (
    check_proof,
    disk_margins,
    gain_profile,
    stability_profile,
    worst_case_disk_margin,
    worst_case_gain,
)
from lftkit.proofs.state_space.disk_search import DiskSearch
from lftkit.proofs.state_space.search import member_gain
from lftkit.systems.sampled.bilinear import to_discrete


def test_the_profile_of_a_gain_is_reached_and_bounded() -> None:
    system = aligned_modes(2, damping=0.05)
    omega = np.array([0.5, 0.95, 1.3, 1.5, 3.0])
    profile = gain_profile(system, omega)
    assert np.all(profile.lower <= profile.upper) and np.all(profile.upper <= 1.35 * profile.lower)
    for w, gain, point in zip(omega, profile.lower, profile.points):
        member = system.at(point)
        response = member.C @ np.linalg.solve(1j * w * np.eye(member.order) - member.A, member.B.astype(complex))
        assert abs(complex(response[0, 0])) == pytest.approx(gain, rel=1e-9)
    bounds = worst_case_gain(system)
    at_peak = gain_profile(system, [bounds.frequency])
    assert bounds.lower * (1.0 - 1e-6) <= at_peak.upper[0] and at_peak.lower[0] <= bounds.upper
    rng = np.random.default_rng(0)
    for values in system.sample_values(rng, 200):
        member = system.at(values)
        for w, upper in zip(omega, profile.upper):
            assert abs(member.C @ np.linalg.solve(1j * w * np.eye(4) - member.A, member.B)) <= upper


def test_a_discrete_system_is_taken_on_the_circle() -> None:
    """x+ = p x + u, p in [0, 0.6]: gain 1 / |exp(j w dt) - p|."""
    dt = 0.1
    system = (1 / (z(dt) - real("p", 0.3, 0.0, 0.6))).system("u", "y")
    omega = np.array([0.0, 10.0, np.pi / 0.1])
    profile = gain_profile(system, omega)
    grid = np.linspace(0.0, 0.6, 2001)
    exact = [(1.0 / np.abs(np.exp(1j * w * dt) - grid)).max() for w in omega]
    np.testing.assert_allclose(profile.lower, exact, rtol=1e-6)
    np.testing.assert_allclose(profile.upper, exact, rtol=2e-3)
    stable = stability_profile(system, omega[:1])  # z = 1 is reached at p = 1: 0.7 / 0.3 times the box
    assert stable.upper[0] == pytest.approx(0.3 / 0.7, rel=2e-3)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_dynamics_beside_a_parameter(dt: float) -> None:
    """k (1 + delta) / (s + 1) or k (1 + delta) / (z - 0.5), k in [1, 3] and a gain of delta of at most a half."""
    k, delta = real("k", 2.0, 1.0, 3.0), dynamic("delta", bound=0.5)
    lag = z(dt) - 0.5 if dt else s + 1
    system = (k / lag * (1 + delta)).system("u", "y")
    omega = np.array([0.0, 1.0, 20.0])
    response = np.abs(np.exp(1j * omega * dt) - 0.5 if dt else 1j * omega + 1.0)
    profile = gain_profile(system, omega)
    np.testing.assert_allclose(profile.lower, 3.0 * 1.5 / response, rtol=1e-6)
    np.testing.assert_allclose(profile.upper, 3.0 * 1.5 / response, rtol=2e-3)
    nominal = (lag / (lag + 2)) if not dt else (lag / (lag + 0.2))
    loop = feedback(((2.0 if not dt else 0.2) / lag * (1 + delta)).system("e", "y"))
    at = stability_profile(loop, omega)  # the gain of the complementary sensitivity, by the bound of delta
    T = (1 - nominal).system("r", "y")
    exact = 0.5 * np.abs(T.response(omega)[:, 0, 0])
    np.testing.assert_allclose(at.lower, exact, rtol=1e-6)
    np.testing.assert_allclose(at.upper, exact, rtol=2e-3)


def test_a_pole_at_a_frequency_is_an_error() -> None:
    system = System(
        [[0.0]], [[1.0]], [[1.0]], [[0.0]], (), (), channels=("p",), elements=(RealParameter("p", 0.0, -1.0, 1.0),)
    )
    with pytest.raises(ValueError, match="no pole"):
        stability_profile(system, [0.0])


def third_order_loop() -> System:
    """``k / (s + 1)^3`` with k in [1, 3], nominal 2."""
    A = np.array([[-1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    B, C = np.array([[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    k = RealParameter("k", 2.0, 1.0, 3.0)
    D = np.array([[0.0, 1.0], [0.0, 0.0]])
    return System(A, B, C, D, [("u", 1)], [("y", 1)], channels=("k",), elements=(k,))


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0])
def test_the_disk_margin_is_that_of_the_largest_gain(skew: float) -> None:
    found = worst_case_disk_margin(third_order_loop(), skew=skew)
    s = 1j * np.geomspace(1e-2, 1e2, 20001)
    margin = min(1.0 / np.abs(1.0 / (1.0 + k / (s + 1.0) ** 3) + 0.5 * (skew - 1.0)).max() for k in (1.0, 2.0, 3.0))
    assert found.lower <= margin * (1.0 + 1e-6) and margin <= found.upper * (1.0 + 1e-6) <= 1.051 * found.lower
    assert found.gain_bounds.point["k"] == pytest.approx(3.0)
    assert check_proof(found.gain_bounds.proof).stable
    low, high = found.gain_margins
    assert low < 1.0 < high <= 8.0 / 3.0, "the loop of gain 8 is unstable"
    crossing = math.sqrt(3.0 ** (2.0 / 3.0) - 1.0)  # |L| = 1 for k = 3
    assert 0.0 < found.phase_margin <= math.degrees(math.pi - 3.0 * math.atan(crossing))


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_the_disk_margin_is_the_same_in_all_units_of_the_loop(unit: float) -> None:
    """``(1.4 s + 1) / (J s^2)`` with J in [0.5, 1.5], its command in units of ``1 / unit``."""
    J = RealParameter("J", 1.0, 0.5, 1.5)
    A, B, C = [[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [-1.0, 1.0 / unit]], [[0.0, 0.0], [unit, 1.4 * unit]]
    D = [[-1.0, 1.0 / unit], [0.0, 0.0]]
    found = worst_case_disk_margin(System(A, B, C, D, [("u", 1)], [("y", 1)], channels=("J",), elements=(J,)))
    w = np.geomspace(1e-2, 1e2, 20001)
    response = (1.0 + 1.4j * w) / (-1.5 * w**2)
    assert found.upper == pytest.approx(1.0 / np.abs(1.0 / (1.0 + response) - 0.5).max(), rel=1e-6)
    assert found.upper <= 1.05 * found.lower


@pytest.mark.parametrize("skew", [-3.0, -1.0, 0.0, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("size", [0.2, 0.9, 1.5, 2.5, 8.0])
def test_the_phase_of_a_disk_is_where_the_unit_circle_leaves_it(skew: float, size: float) -> None:
    angle = np.linspace(0.0, np.pi, 200001)
    factor = np.exp(1j * angle)
    outside = 2.0 * np.abs(factor - 1.0) >= size * np.abs((1.0 - skew) + (1.0 + skew) * factor)
    leaves = angle[np.argmax(outside)] if outside.any() else np.pi
    assert disk_phase(size, skew) == pytest.approx(np.degrees(leaves), abs=2e-3)


@pytest.mark.parametrize("skew", [-1.0, -0.5, 0.0, 0.7, 1.0])
def test_margins_of_a_disk_are_its_ends(skew: float) -> None:
    for margin in (0.1, 0.5, 0.9):
        d = margin * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400001))
        factor = (2.0 + (1.0 - skew) * d) / (2.0 - (1.0 + skew) * d)
        low, high = disk_gains(margin, skew)
        assert factor.real.min() == pytest.approx(low, abs=1e-8)
        assert factor.real.max() == pytest.approx(high, abs=1e-8)
        nearest = factor[np.abs(np.abs(factor) - 1.0) < 1e-4]
        assert np.degrees(np.abs(np.angle(nearest)).max()) == pytest.approx(disk_phase(margin, skew), abs=0.06)


def test_disk_margins_are_the_same_in_all_units_of_the_channels() -> None:
    """1 + L was called singular at infinite frequency where a channel was in a small unit."""
    units = np.diag([1e-9, 1e9])
    D = np.array([[0.2, 0.1], [-0.1, 0.3]])
    found = []
    for T in (np.eye(2), units):
        L = System(-np.eye(2), T, np.linalg.inv(T), np.linalg.inv(T) @ D @ T, [("u", 2)], [("y", 2)])
        found.append([one.size for one in disk_margins(L).each])
    assert found[1] == pytest.approx(found[0], rel=1e-9)


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
