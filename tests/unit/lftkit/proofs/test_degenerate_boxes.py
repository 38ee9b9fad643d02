"""Boxes beside the nominal values, parameters that see no state, states that nothing sees, expressions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.slow_cases import slow

from lftkit import Expression, RealParameter, System, complex_gain, discretise, dynamic, real, s
from lftkit.proofs import (
    BoundOptions,
    check_proof,
    robust_performance,
    robust_stability,
    worst_case_disk_margin,
    worst_case_gain,
)
from lftkit.proofs.state_space.disk_search import about

LONG = BoundOptions(wall_limit=3600.0)
ROUGH = replace(LONG, gap=0.3)
DISKS = [dynamic("e", bound=0.1), complex_gain("e", 0.0, 0.1)]


def unstable_lag(disk: Expression, dt: float = 0.0) -> System:
    """``1 / (s - 1 + k + e)`` with |e| up to 0.1, whose nominal member, at k = 0, is unstable."""
    system: System = (1 / (s - 1 + real("k", 0.0, -3.0, 3.0) + disk)).system("u", "y")
    return discretise(system, dt) if dt else system


@pytest.mark.parametrize(("disk", "dt"), [(DISKS[0], 0.0), (DISKS[1], 0.1), slow(DISKS[0], 0.1), slow(DISKS[1], 0.0)])
def test_a_stable_box_beside_the_nominal_value(disk: Expression, dt: float) -> None:
    """1 / (2 - 1 - 0.1) at k = 2."""
    for box in ((2.0, 3.0), (2.0, 2.0)):
        bounds = worst_case_gain(unstable_lag(disk, dt), {"k": box}, options=ROUGH)
        assert bounds.status == "closed" and bounds.lower == pytest.approx(1.0 / 0.9, rel=1e-6)
        assert bounds.point["k"] == pytest.approx(2.0)
        assert check_proof(bounds.proof).level == bounds.upper <= 1.3 * bounds.lower


BOXES = (1.05, 3.0), (1.05, 1.3), (0.9, 1.5)


@pytest.mark.parametrize(
    ("disk", "box"),
    [
        (DISKS[0], BOXES[0]),
        (DISKS[1], BOXES[2]),
        *(slow(DISKS[k], box) for k in (0, 1) for box in BOXES if box is not BOXES[2 * k]),
    ],
)
def test_an_unstable_member_of_such_a_box_is_inside(disk: Expression, box: tuple[float, float]) -> None:
    """All members with k + e below 1, here below 1.1 at some e."""
    bounds = worst_case_gain(unstable_lag(disk), {"k": box}, options=LONG)
    assert bounds.status == "unstable" and bounds.lower == np.inf and bounds.proof is None
    assert box[0] <= bounds.point["k"] <= min(box[1], 1.1)


def test_other_nominal_values_are_the_same_system() -> None:
    rng = np.random.default_rng(3)
    a, b = RealParameter("a", 0.0, -1.0, 1.0), RealParameter("b", 0.5, 0.0, 2.0)
    M = [0.4 * rng.standard_normal(shape) for shape in ((3, 3), (3, 4), (4, 3), (4, 4))]
    system = System(*M, (("u", 1),), (("y", 1),), channels=("a", "b", "a"), elements=(a, b))  # type: ignore[arg-type]
    moved = about(system, np.array([0.3, 1.25]))
    assert [p.nominal for p in moved.parameters] == [0.3, 1.25]
    for values in ({"a": 0.3, "b": 1.25}, {"a": -0.7, "b": 0.1}, {"a": 1.0, "b": 2.0}):
        same = [member.response([0.0, 0.7, 3.0]) for member in (system.at(values), moved.at(values))]
        np.testing.assert_allclose(same[0], same[1], rtol=1e-12)


@pytest.mark.parametrize("method", [None, "cells", "axis"])
def test_a_margin_asks_for_the_nominal_values_in_the_box(method: str | None) -> None:
    """Scaled about a value outside, the box of a proof would not contain the member that is shown to be stable."""
    system = (1 / (s + real("k", 2.0, 1.0, 3.0))).system("u", "y")
    for box in ((2.5, 3.0), (1.0, 1.5)):
        with pytest.raises(ValueError, match=r"^box must contain the nominal values, got another$"):
            robust_stability(system, {"k": box}, options=BoundOptions(method=method))
    at_its_end = robust_stability(system, {"k": (2.0, 3.0)}, options=replace(LONG, method=method))
    assert at_its_end.status == "closed" and check_proof(at_its_end.proof).stable


@pytest.mark.further
def test_bounds_take_expressions() -> None:
    lag = 1 / (s + real("k", 2.0, 1.0, 3.0))
    system = lag.system()
    calls: list[Any] = [worst_case_gain, robust_stability, lambda given: robust_performance(given, 2.0)]
    calls.append(worst_case_disk_margin)
    for bound in calls:
        assert bound(lag).lower == bound(system).lower > 0.0
        with pytest.raises(ValueError, match=r"^system must be a System, .* got str$"):
            bound("lag")


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


ZERO = [(0.0, "cells", driven, *ends) for driven in (False, True) for ends in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))]


@pytest.mark.parametrize(
    ("dt", "method", "driven", "into", "out"),
    [*ZERO, (0.0, "axis", False, 0.0, 1.0), (0.1, None, False, 0.0, 1.0)],
)
def test_gain_of_zero_is_proven_to_be_negligible(
    dt: float, method: str | None, driven: bool, into: float, out: float
) -> None:
    options = BoundOptions(method=method, max_tests=200)
    bounds = worst_case_gain(reducible(dt, driven, not driven, into, out), options=options)
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
