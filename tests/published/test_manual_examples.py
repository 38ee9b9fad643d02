"""Printed answers of the manuals of the Control System Toolbox and the Robust Control Toolbox, by their pages.

Loops with dynamics that are not modelled have their own file, the two-mass benchmark is in ``test_robustness_bounds``.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from lftkit import System, dynamic, hinf_norm, real, s, z
from lftkit.proofs import BoundOptions, check_proof, robust_performance, robust_stability, worst_case_gain

LONG = BoundOptions(wall_limit=3600.0)


def third_order_on_samples() -> System:
    """Example of the page of norm: sample time 0.1 s."""
    q = z(0.1)
    num, den = q**3 - 2.841 * q**2 + 2.875 * q - 1.004, q**3 - 2.417 * q**2 + 2.003 * q - 0.5488
    return (num / den).system("u", "y")


def test_the_peak_of_a_discrete_system() -> None:
    """Page of norm: 2.5488 at 3.0844 rad/s, with a tolerance of 1 %: the gain there; the largest is 0.9 % higher."""
    system = third_order_on_samples()
    assert abs(system.response([3.0844])[0]).item() == pytest.approx(2.5488, abs=6e-5)
    peak = hinf_norm(*system.matrices, dt=system.dt)
    assert 2.5488 <= peak.value <= peak.upper <= 1.01 * 2.5488
    assert abs(system.response([peak.omega])[0]).item() == pytest.approx(peak.value, rel=1e-6)


def test_a_margin_that_is_discontinuous_over_frequency() -> None:
    """Getting reliable estimates of robustness margins: 1 at 1 rad/s, which a grid of frequencies misses."""
    c = real("c", 1, percent=100)
    margin = robust_stability((1 / (s**2 + c * s + 1)).system("force", "position"), options=replace(LONG, gap=0.01))
    assert margin.status == "closed" and margin.lower <= 1.0
    assert margin.upper == pytest.approx(1.0, abs=1e-6) and margin.frequency == pytest.approx(1.0, abs=1e-6)
    assert margin.lower > 0.99 and check_proof(margin.proof).stable


def sensitivity(factor: float) -> System:
    """Example of the page of robgain with its uncertainty scaled."""
    k, delta = real("k", 10, percent=40 * factor), dynamic("delta", bound=factor)
    loop = 18 / (s**2 + 1.8 * s + k) * (1 + 0.5 * delta) * (2.3 + 3 / s + 0.38 * s / (0.001 * s + 1))
    return (1 / (1 + loop)).system("r", "e")


@pytest.mark.slow
def test_the_level_of_a_sensitivity_is_between_the_printed_margins() -> None:
    """Page of robgain: the peak gain stays below 1.5 up to a factor between 0.7821 and 0.7837, at 7.8566 rad/s."""
    below = worst_case_gain(sensitivity(0.7821), options=replace(LONG, gap=0.001))
    assert below.upper < 1.5 and check_proof(below.proof).level == below.upper
    above = worst_case_gain(sensitivity(0.7837), options=replace(LONG, gap=0.001))
    assert above.lower >= 1.5 and above.frequency == pytest.approx(7.8566, rel=0.03)
    member = sensitivity(0.7837).at(above.point)
    assert hinf_norm(*member.matrices).value >= 1.5


@pytest.mark.slow
def test_the_printed_margin_of_a_level_is_found() -> None:
    """The same page by one call."""
    margin = robust_performance(sensitivity(1.0), level=1.5, options=replace(LONG, gap=0.02))
    assert margin.status == "closed" and margin.upper == pytest.approx(0.7837, abs=1e-4)
    assert margin.frequency == pytest.approx(7.8566, rel=0.03)
    assert margin.lower >= margin.upper / 1.02 and check_proof(margin.proof).level == 1.5
