"""Crossings and margins of loops: those of python-control, poles at the edge, disks, and the ends of the axis."""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy import linalg

from lftkit import System, loop_margins, pade_delay, s, sensitivity_peaks, z
from lftkit.analysis.margins import disk_margin, sensitivity
from lftkit.proofs import disk_margins, worst_case_disk_margin


def loop(expression: Any) -> System:
    made: System = expression.system("u", "y")
    return made


def random_loop(seed: int, dt: float) -> System:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    A = rng.standard_normal((n, n))
    poles = linalg.eigvals(A)
    A = 0.95 * A / np.abs(poles).max() if dt else A - (poles.real.max() + 0.1) * np.eye(n)
    gain = 10.0 ** rng.uniform(-0.5, 1.0)
    B, C, D = gain * rng.standard_normal((n, 1)), rng.standard_normal((1, n)), rng.integers(0, 2) * np.ones((1, 1))
    return System(A, B, C, D, [("u", 1)], [("y", 1)], "random", dt)


def closed_poles(L: System, factor: complex) -> np.ndarray[Any, Any]:
    A, B, C, D = L.matrices
    found: np.ndarray[Any, Any] = linalg.eigvals(A - factor * B @ C / (1.0 + factor * D.item()))
    return found


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_crossings_are_those_of_python_control(seed: int, dt: float) -> None:
    L = random_loop(seed, dt)
    with np.errstate(all="ignore"):
        gains, phases, _, at_gains, at_phases, _ = control.stability_margins(control.tf(L.to_control()), returnall=True)
    last = math.pi / dt * (1.0 - 1e-9) if dt else math.inf
    found = loop_margins(L)
    inside = [g for omega, g in found.gain if 0.0 < omega < last]
    assert sorted(inside) == pytest.approx(sorted(g for g, w in zip(gains, at_gains) if 1e-9 < w < last), rel=1e-5)
    phase = [(omega, angle) for omega, angle in found.phase if 0.0 < omega < last]  # not those at the ends
    assert sorted(angle for _, angle in phase) == pytest.approx(sorted((phases + 180.0) % 360.0 - 180.0), abs=1e-3)
    assert [omega for omega, _ in phase] == pytest.approx(sorted(at_phases), rel=1e-5)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_each_crossing_makes_a_pole_on_the_edge_and_the_range_between_them_none(seed: int, dt: float) -> None:
    L = random_loop(seed, dt)
    found = loop_margins(L)
    for omega, factor in found.gain:
        if math.isfinite(omega):
            edge = np.exp(1j * omega * dt) if dt else 1j * omega
            assert np.abs(closed_poles(L, factor) - edge).min() < 1e-6 * max(1.0, abs(edge))
    last = math.pi / dt * (1.0 - 1e-9) if dt else math.inf
    phase, delays = ([one for one in points if 0.0 < one[0] < last] for points in (found.phase, found.delay))
    for omega, angle in phase:
        edge = np.exp(1j * omega * dt) if dt else 1j * omega
        assert np.abs(closed_poles(L, np.exp(-1j * np.radians(angle))) - edge).min() < 1e-6 * max(1.0, abs(edge))
    for (omega, angle), (_, delay) in zip(phase, delays, strict=True):
        assert math.remainder(omega * delay - math.radians(angle), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    poles = closed_poles(L, 1.0)
    assert found.stable == bool(np.all(np.abs(poles) < 1.0) if dt else np.all(poles.real < 0.0))
    if found.stable:
        low, high = found.gain_range
        for factor in np.geomspace(max(low, 1e-4) * 1.0001, min(high, 1e4) / 1.0001, 50):
            poles = closed_poles(L, factor)
            assert np.abs(poles).max() < 1.0 if dt else poles.real.max() < 0.0


def test_a_conditionally_stable_loop_has_margins_on_both_sides() -> None:
    L = loop(3 * (s + 2) ** 2 / s**3)  # s^3 + k (s + 2)^2: by Hurwitz 4 k^2 > 4 k
    found = loop_margins(L)
    assert found.stable
    assert found.gain_range == pytest.approx((1.0 / 3.0, math.inf))


def test_the_delay_margin_is_the_delay_that_destabilises() -> None:
    L = loop(2 / (s + 1))
    found = loop_margins(L)
    omega = math.sqrt(3.0)
    assert found.phase == ((pytest.approx(omega), pytest.approx(120.0)),)
    assert found.delay_margin == pytest.approx(math.radians(120.0) / omega)
    for factor, stable in ((0.99, True), (1.01, False)):
        delayed = L @ pade_delay(factor * found.delay_margin, 6)
        assert loop_margins(delayed).stable == stable


def delayed_poles(L: System, periods: int) -> np.ndarray[Any, Any]:
    """Poles of the loop with so many periods of delay, at least one, by its states and those of the delay."""
    A, B, C, D = L.matrices
    n, whole = len(A), np.zeros((len(A) + periods, len(A) + periods))
    whole[:n, :n], whole[:n, -1:] = A, -B
    whole[n, :n], whole[n, -1] = C, -D.item()
    for k in range(1, periods):
        whole[n + k, n + k - 1] = 1.0
    found: np.ndarray[Any, Any] = linalg.eigvals(whole)
    return found


@pytest.mark.parametrize("through", [0.0, 0.8, 3.0, -3.0])
def test_a_sampled_loop_bears_every_delay_below_its_margin(through: float) -> None:
    """Also one whose gain at the Nyquist frequency is above 1, which bears no delay, without a crossing of 1."""
    rng, seen = np.random.default_rng(11), 0
    while seen < 3:
        A = rng.standard_normal((2, 2))
        A *= rng.uniform(0.2, 1.2) / np.abs(linalg.eigvals(A)).max()
        B, C = rng.standard_normal((2, 1)), rng.standard_normal((1, 2))
        L = System(A, B, C, [[through]], [("u", 1)], [("y", 1)], "random", 0.1)
        found = loop_margins(L)
        if found.stable:
            seen += 1
            borne = [k for k in range(1, 12) if 0.1 * k < found.delay_margin * (1.0 - 1e-9)]
            assert all(np.abs(delayed_poles(L, k)).max() < 1.0 for k in borne)
            if abs(L.response([math.pi / 0.1]).item()) > 1.0:
                assert not borne and np.abs(delayed_poles(L, 1)).max() > 1.0


def test_a_loop_with_a_gain_above_one_at_infinity_bears_no_delay() -> None:
    """1 + D exp(-s T) has zeros with the real part log(D) / T."""
    found = loop_margins(loop(1.5 * (s + 2) / (s + 1)))
    assert found.stable and found.delay == ((math.inf, 0.0),) and found.phase_margin == math.inf
    assert loop_margins(loop(0.9 * (s + 2) / (s + 1))).delay_margin > 0.0


def test_ends_of_the_axis_count() -> None:
    assert loop_margins(loop(1 / (s + 1))).phase == ((0.0, 180.0),)  # 1 - 1 / (s + 1) has its pole at zero
    assert loop_margins(loop(1 / (s + 1))).delay_margin == math.inf
    assert loop_margins(loop(-0.5 / (s + 1))).gain == ((0.0, pytest.approx(2.0)),)
    assert loop_margins(loop((1 - 2 * s) / (s + 4))).gain == ((math.inf, pytest.approx(0.5)),)
    q = z(0.5)
    nyquist = loop_margins(loop(0.5 / (q + 0.5)))
    assert nyquist.gain == ((pytest.approx(2.0 * math.pi), pytest.approx(1.0)),)


def test_an_undamped_resonance_is_no_crossing() -> None:
    """The sign of the imaginary part changes through infinity there."""
    found = loop_margins(loop((s + 1) / (s**2 + 4) / (s + 3)))
    assert all(abs(omega - 2.0) > 1e-3 for omega, _ in found.gain)
    assert len(found.phase) == 2


def test_units_of_time_and_states_do_not_matter() -> None:
    slow = loop_margins(loop(25 / (s**3 + 10 * s**2 + 10 * s + 10)))
    t = 1e5 * s
    fast = loop_margins(loop(25 / (t**3 + 10 * t**2 + 10 * t + 10)))
    assert fast.gain[0][1] == pytest.approx(slow.gain[0][1], rel=1e-9)
    assert fast.phase_margin == pytest.approx(slow.phase_margin, rel=1e-9)
    assert fast.delay_margin == pytest.approx(1e5 * slow.delay_margin, rel=1e-9)


def test_a_high_gain_crosses_far_above_the_poles() -> None:
    found = loop_margins(loop(1e9 / (s + 1)))
    assert found.phase[0][0] == pytest.approx(1e9) and found.phase_margin == pytest.approx(90.0)


def test_what_is_no_loop_is_refused() -> None:
    many = System([[-1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], [("u", 2)], [("y", 1)])
    with pytest.raises(ValueError, match="must have one input and one output, got 2 and 1"):
        loop_margins(many)
    with pytest.raises(ValueError, match="must have as many inputs as outputs, got 2 and 1"):
        sensitivity_peaks(many)
    with pytest.raises(ValueError, match="the loop must be well posed"):
        sensitivity_peaks(loop((1 - s) / (s + 1)))
    assert not loop_margins(loop((1 - s) / (s + 1))).stable


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_peaks_are_those_of_both_sensitivities(dt: float) -> None:
    rng = np.random.default_rng(1)
    A = rng.standard_normal((4, 4))
    A = 0.5 * A / np.abs(linalg.eigvals(A)).max() if dt else A - (linalg.eigvals(A).real.max() + 1.0) * np.eye(4)
    B, C = 0.3 * rng.standard_normal((4, 2)), 0.3 * rng.standard_normal((2, 4))
    L = System(A, B, C, np.zeros((2, 2)), [("u", 2)], [("y", 2)], "two", dt)
    found = sensitivity_peaks(L)
    omega = np.linspace(0.0, math.pi / dt, 500) if dt else np.geomspace(1e-3, 1e3, 500)
    S = np.linalg.inv(np.eye(2) + L.response(omega))
    T = np.eye(2) - S
    for norm, response in ((found.sensitivity, S), (found.complementary, T)):
        assert norm.value == pytest.approx(np.linalg.norm(response, 2, axis=(1, 2)).max(), rel=1e-3)
    assert math.isinf(sensitivity_peaks(loop(100 / (s + 1) ** 3)).sensitivity.value), "the loop is unstable"
    assert np.allclose(System(*sensitivity(L), L.inputs, L.inputs, dt=dt).response(omega), S)


def test_python_control_systems_are_taken() -> None:
    assert loop_margins(control.tf([2.0], [1.0, 1.0])).phase_margin == pytest.approx(120.0)


LOOPS = [
    25 / (s**3 + 10 * s**2 + 10 * s + 10),
    3 / (s * (0.2 * s + 1)),
    2 * (1 - 0.1 * s) / ((s - 1) * (1 + 0.1 * s)),
    (s + 2) / (s**2 + 0.3 * s + 4),
]


@pytest.mark.parametrize("expression", LOOPS)
@pytest.mark.parametrize("skew", [-0.5, 0.0, 1.0])
def test_every_factor_in_the_disk_is_borne_and_one_at_its_edge_is_not(expression: Any, skew: float) -> None:
    L = loop(expression)
    found = disk_margin(L, skew)
    assert found.size > 0.0 and found.gain_db[1] == pytest.approx(20.0 * np.log10(found.gain[1]))
    rng = np.random.default_rng(0)
    z = np.sqrt(rng.uniform(size=400)) * np.exp(2j * np.pi * rng.uniform(size=400))
    a = min(found.size, 1.9 / (1.0 + abs(skew))) * 0.999
    for factor in (2.0 + (1.0 - skew) * a * z) / (2.0 - (1.0 + skew) * a * z):
        assert closed_poles(L, factor).real.max() < 0.0
    edge = closed_poles(L, found.factor)
    assert np.abs(edge - 1j * found.omega).min() < 1e-6 * max(1.0, found.omega)
    back = 2.0 * (found.factor - 1.0) / ((1.0 - skew) + (1.0 + skew) * found.factor)
    assert abs(back) == pytest.approx(found.size, rel=1e-5), "the edge of the disk"


def test_an_unstable_loop_has_none_and_several_channels_are_refused() -> None:
    assert disk_margin(loop(100 / (s + 1) ** 3)).size == 0.0
    many = System([[-1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], [("u", 2)], [("y", 1)])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="must have one input and one output, got 2 and 1"):
        disk_margin(many)


@pytest.mark.parametrize("skew", [1e7, -1e300, np.inf, np.nan])
def test_a_skew_that_leaves_no_digits_is_refused(skew: float) -> None:
    """For large skews the disk is a half plane; with 1e12 it had factors up to 3.4, of a loop that bears 1.919."""
    assert disk_margin(loop(LOOPS[0]), 1e6).gain[1] == pytest.approx(disk_margin(loop(LOOPS[0]), 1e5).gain[1], rel=1e-4)
    for margin in (disk_margin, disk_margins):
        with pytest.raises(ValueError, match=r"skew must be from -1e\+06 to 1e\+06"):
            margin(loop(LOOPS[0]), skew)
    with pytest.raises(ValueError, match="skew must be from"):
        worst_case_disk_margin(loop(LOOPS[0]), skew=skew)
