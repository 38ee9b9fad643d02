"""Bounds of systems with parameters that see no state, or states that no parameter, input or output sees."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import RealParameter, System
from lftkit.proofs import BoundOptions, check_proof, worst_case_gain

P = RealParameter("p", 0.5, 0.2, 0.8)
STATES = {0.0: [[-0.9, 2.0, 0.3], [-2.0, -0.9, 0.1], [0.0, 0.4, -1.3]], 0.1: np.diag([0.6, -0.4, 0.1]).tolist()}


def reducible(dt: float, driven: bool, seen: bool, into: float, out: float) -> System:
    """y = out (p - 1/2) into u, with states that the channel drives or sees, not both, and no one else."""
    rng = np.random.default_rng(3)
    B, C = np.zeros((3, 2)), np.zeros((2, 3))
    B[:, 0], C[0] = driven * rng.standard_normal(3), seen * rng.standard_normal(3)
    ports = [("u", 1)], [("y", 1)]
    return System(STATES[dt], B, C, [[0.0, into], [out, 0.0]], *ports, channels=("p",), elements=(P,), dt=dt)


@pytest.mark.parametrize(("driven", "seen"), [(False, False), (True, False), (False, True)])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_gain_that_no_state_has_a_part_in_is_proven(dt: float, driven: bool, seen: bool) -> None:
    """The states took the multipliers of the frequency to infinity, in a direction without effect."""
    bounds = worst_case_gain(reducible(dt, driven, seen, 1.0, 1.0), options=BoundOptions(max_tests=200))
    assert bounds.status == "closed"
    assert bounds.lower == pytest.approx(0.3, rel=1e-6) and bounds.upper <= 1.05 * 0.3
    assert check_proof(bounds.proof).level == bounds.upper


ZERO = [("cells", driven, *ends) for driven in (False, True) for ends in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))]


@pytest.mark.parametrize(("method", "driven", "into", "out"), [*ZERO, ("axis", False, 0.0, 1.0)])
def test_gain_of_zero_is_proven_to_be_negligible(method: str, driven: bool, into: float, out: float) -> None:
    bounds = worst_case_gain(reducible(0.0, driven, not driven, into, out), options=BoundOptions(method=method))
    assert bounds.status == "closed"
    assert bounds.lower == 0.0 and bounds.upper <= 1e-8
    assert check_proof(bounds.proof).level == bounds.upper


def test_a_proof_with_an_occurrence_without_influence_is_accepted() -> None:
    """y = u / (s + 1 - p); p occurs again without effect, with an entry of D of 1e-28 beside 1 that was refused."""
    p = RealParameter("p", 0.0, -0.5, 0.5)
    B, C, D = [[1.0, 0.0, 1.0]], [[1.0], [1.0], [1.0]], np.zeros((3, 3))
    lag = System([[-1.0]], B, C, D, [("u", 1)], [("y", 1)], channels=("p", "p"), elements=(p,))
    bounds = worst_case_gain(lag, options=BoundOptions(method="axis"))
    assert bounds.lower == pytest.approx(2.0, rel=1e-6) and check_proof(bounds.proof).level == bounds.upper


@pytest.mark.parametrize("method", ["cells", "axis"])
@pytest.mark.parametrize(("value", "unit"), [(0.0, 1.0), (-1e6, 1e6)])
def test_a_parameter_with_one_value_changes_no_gain(method: str, value: float, unit: float) -> None:
    """y = u / (s + 1 - p) with p in [-1/2, 1/2] beside a parameter, strong in its unit, that is constant."""
    p, constant = RealParameter("p", 0.0, -0.5, 0.5), RealParameter("c", value, value, value)
    B, C, D = [[1.0, unit, 1.0]], [[1.0], [1.0], [1.0]], [[0.0, 0.0, 0.0], [0.0, 0.3 * unit, 0.1], [0.0, 0.2, 0.0]]
    lag = System([[-1.0]], B, C, D, [("u", 1)], [("y", 1)], channels=("p", "c"), elements=(p, constant))
    bounds = worst_case_gain(lag, options=BoundOptions(method=method))
    assert bounds.lower == pytest.approx(2.0, rel=1e-6) and bounds.upper <= 2.1
    checked: Any = check_proof(bounds.proof)
    assert checked.box["c"] == (value, value)


def test_gain_of_zero_is_proven_in_discrete_time() -> None:
    bounds = worst_case_gain(reducible(0.1, False, True, 0.0, 1.0), options=BoundOptions(max_tests=200))
    assert bounds.status == "closed" and bounds.lower == 0.0 and bounds.upper <= 1e-8
    assert check_proof(bounds.proof).level == bounds.upper


@pytest.mark.parametrize("method", ["cells", "axis"])
@pytest.mark.parametrize(("out", "into"), [(1e-12, 1.0), (1e-12, 1e3), (1e-3, 1e-9), (1e9, 1.0), (1e9, 1e-9)])
def test_a_gap_is_closed_in_all_units_of_input_and_output(method: str, out: float, into: float) -> None:
    """The gain k / (s + 1) from N to rad was called closed a thousand times above the worst member."""
    k = RealParameter("k", 1.0, 0.5, 1.5)
    B, C, D = [[into, into]], [[0.0], [out]], [[0.0, 1.0], [0.0, 0.0]]
    lag = System([[-1.0]], B, C, D, [("u", 1)], [("y", 1)], channels=("k",), elements=(k,))
    bounds = worst_case_gain(lag, options=BoundOptions(method=method))
    assert bounds.status == "closed"
    assert bounds.lower == pytest.approx(1.5 * into * out, rel=1e-6) and bounds.upper <= 1.05 * bounds.lower
    assert check_proof(bounds.proof).level == bounds.upper
