"""Feasibility comes first: feasible points are never left, and `infeasible` is said after looking for one."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.system import System
from lftkit.tuning.descent.grid_source import Point, point_at
from lftkit.tuning.descent.smooth_phase import smooth_phase
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, HinfGain
from lftkit.tuning.structures.structures import gain
from lftkit.tuning.tuner import tune

STATIC = gain([("y", 1)], [("u", 1)])


def lag(pole: float) -> System:
    """1 / (s - pole) with the disturbance at its input; outputs: state, command, measurement."""
    D = [[0, 0], [0, 1], [0, 0]]
    C = [[1.0], [0.0], [1.0]]
    return System([[pole]], [[1, 1]], C, D, [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)])


def problem(effort: float) -> Problem:
    """With u = -k y: the soft gain 1 / (k + 1/2) falls for ever, the effort k / (k + 1/2) must stay below a bound."""
    needs = [HinfGain("w", "z"), HinfGain("w", "effort", bound=effort, hard=True)]
    return Problem([lag(-0.5)], needs, STATIC)


@pytest.mark.parametrize("gain_before", [0.1, 2.0, 4.49, 4.51, 50.0, 1e4])
def test_smooth_phase_ends_feasible_and_no_higher_than_it_began(gain_before: float) -> None:
    """The effort is at most 0.9 up to k = 4.5."""
    p = problem(0.9)
    first = point_at(p, np.array([-gain_before]))
    found = smooth_phase(p, first.x, 400, np.inf, -np.inf).point
    assert found.feasible and found.hard <= 1.0 + 1e-6
    assert not first.better_than(found)
    assert -found.x.item() == pytest.approx(4.5, rel=0.03)


def test_points_are_compared_by_feasibility_before_value() -> None:
    found = point_at(problem(0.9), np.array([-1.0])).found

    def point(soft: float, hard: float) -> Point:
        return Point(np.zeros(1), found, soft, hard)

    assert point(10.0, 1.0).better_than(point(1e-9, 1.001))
    assert not point(1e-9, 1.001).better_than(point(10.0, 1.0))
    assert point(9.0, 1.1).better_than(point(1.0, 1.2)), "of two infeasible ones the smaller violation"
    assert point(1.0, 0.99).better_than(point(1.1, 0.5)), "of two feasible ones the lower soft value"
    assert not point(np.inf, np.inf).feasible and point(-np.inf, 0.5).feasible
    assert not point(0.9995, 1.0).better_than(point(1.0, 1.0), 1e-3)


@pytest.mark.parametrize("gain_before", [8e4, 1e-3])
def test_feasible_gain_is_found_from_far_infeasible_starts(gain_before: float) -> None:
    """All feasible gains are between 4 (soft made hard) and 4.5."""
    needs = [
        HinfGain("w", "z", bound=1.0 / 4.5, hard=True, name="attenuation"),
        HinfGain("w", "effort", bound=0.9, hard=True),
        HinfGain("w", "z", name="soft"),
    ]
    options = TuningOptions(starts=0)
    result = tune([lag(-0.5)], needs, STATIC, initial=[[-gain_before]], options=options)
    assert result.feasible and result.status == "converged"
    assert -result.controller.D.item() == pytest.approx(4.5, rel=2e-3)


def test_infeasible_has_the_least_violation_whatever_the_start() -> None:
    """Effort k / (k + 1/2) at most 0.5 contradicts 1 / (k + 1/2) at most 0.5: equal violations at k = 1, of 4 / 3."""
    needs = [
        HinfGain("w", "z", bound=0.5, hard=True, name="attenuation"),
        HinfGain("w", "effort", bound=0.5, hard=True),
        HinfGain("w", "z", name="soft"),
    ]
    for start in (-0.01, -1e3):
        result = tune([lag(-0.5)], needs, STATIC, initial=[[start]], options=TuningOptions(starts=0))
        assert result.status == "infeasible" and not result.feasible
        assert result.hard == pytest.approx(4.0 / 3.0, rel=1e-3)
        assert result.soft == pytest.approx(2.0 / 3.0, rel=5e-3)


@pytest.mark.parametrize("start", [0.5, pytest.param(-1e3, marks=pytest.mark.slow)])
def test_value_that_does_not_depend_on_the_parameters_is_infeasible(start: float) -> None:
    """The sum of the poles is -0.2 whatever the gain is: no decay of 10 rad/s."""
    plant = System(
        [[0, 1], [-1, -0.2]],
        [[0, 0], [1, 1]],
        [[1, 0], [0, 0], [1, 0]],
        [[0, 0], [0, 1], [0, 0]],
        [("w", 1), ("u", 1)],
        [("z", 2), ("y", 1)],
    )
    needs = [HinfGain("w", "z"), ClosedLoopPoles(min_decay=10.0)]
    result = tune([plant], needs, STATIC, initial=[[start]], options=TuningOptions(starts=0))
    assert result.status == "infeasible"
    assert result.hard == pytest.approx(2.0 - 0.1 / 10.0, rel=1e-9)
