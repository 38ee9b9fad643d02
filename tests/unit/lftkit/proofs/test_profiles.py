"""Bounds over frequency agree with the bounds over the whole axis and with members; disk margins with a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg
from support.uncertain_examples import aligned_modes, de_gaston_safonov

from lftkit import RealParameter, System, dynamic, feedback, real, s, z
from lftkit.analysis.disk_margin import disk_gains, disk_phase
from lftkit.proofs import (
    check_proof,
    disk_margins,
    gain_profile,
    robust_stability,
    stability_profile,
    worst_case_disk_margin,
    worst_case_gain,
)


@pytest.mark.further
def test_the_profile_of_a_margin_has_its_peak_at_the_margin() -> None:
    """km = 3.41740 of de Gaston and Safonov."""
    system = de_gaston_safonov()
    crossing = robust_stability(system).frequency
    omega = crossing * np.array([0.5, 0.9, 0.97, 1.0, 1.03, 1.5])
    profile = stability_profile(system, omega, starts=4)
    assert np.all(profile.lower <= profile.upper * (1.0 + 1e-12))
    assert profile.upper.max() == profile.upper[3] == pytest.approx(1.0 / 3.41740, rel=2e-3)
    assert profile.lower.max() == pytest.approx(1.0 / 3.41740, rel=1e-4)
    best = int(np.argmax(profile.lower))
    poles = linalg.eigvals(system.at(profile.points[best], beyond_range=True).A)
    assert np.abs(poles - 1j * omega[best]).min() < 1e-7, "the member has a pole there"


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
