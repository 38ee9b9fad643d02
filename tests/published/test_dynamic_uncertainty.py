"""Printed answers of the Robust Control Toolbox's manual for loops with dynamics that are not modelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lftkit import dynamic, feedback, hinf_norm, real, s
from lftkit.proofs import BoundOptions, check_proof, robust_stability, worst_case_gain

LONG = BoundOptions(wall_limit=3600.0)


def test_the_margin_of_a_loop_with_a_stiffness_and_dynamics() -> None:
    """Page of robstab: 1.5960 to 1.5993, critical at 4.8627 rad/s (the margin is flat there)."""
    k, delta = real("k", 10, percent=40), dynamic("delta")
    plant = (18 / (s**2 + 1.8 * s + k) * (1 + 0.5 * delta)).system("u", "y")
    law = (2.3 + 3 / s + 0.38 * s / (0.001 * s + 1)).system("e", "u")
    loop = feedback(plant @ law)
    margin = robust_stability(loop, options=replace(LONG, gap=0.01))
    assert margin.status == "closed" and margin.lower < 1.5993 and margin.upper == pytest.approx(1.5993, abs=1e-4)
    assert margin.frequency == pytest.approx(4.8627, rel=5e-3)
    assert check_proof(margin.proof).stable
    poles = loop.at(margin.point, beyond_range=True).poles()
    assert np.abs(poles - 1j * margin.frequency).min() < 1e-6


def test_the_worst_sensitivity_of_an_integrator_with_additive_dynamics() -> None:
    """Page of wcgain: 5.1036 to 5.1140; the search here finds a member with 5.1042."""
    delta = dynamic("delta", bound=0.4)
    law = 2 - 0.04 * s / (0.02 * s + 1)
    sensitivity = (1 / (1 + (1 / s + delta) * law)).system("r", "e")
    worst = worst_case_gain(sensitivity, options=replace(LONG, gap=0.01))
    assert worst.status == "closed" and 5.1036 <= worst.lower <= 5.1140 and worst.upper <= 1.01 * worst.lower
    assert check_proof(worst.proof).level == worst.upper
    assert hinf_norm(*sensitivity.at(worst.point).matrices).value == pytest.approx(worst.lower, rel=1e-6)
