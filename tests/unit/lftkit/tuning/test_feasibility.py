"""Feasibility comes first: least violations, hard requirements alone, nothing free, values that count as met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.tuned_plants import STATIC, first_order, lag, tuned_plant

from lftkit import System
from lftkit.tuning import HinfGain, TuningOptions, TuningResult, gain, tune, tune_discrete, tune_robust
from lftkit.tuning.requirements import ClosedLoopPoles
from lftkit.tuning.structures.structures import AffineStructure, pid

GIVEN = TuningOptions(starts=0)
GAIN = HinfGain("w", "z")


def limits(attenuation: float, effort: float) -> list[HinfGain]:
    return [
        HinfGain("w", "z", bound=attenuation, hard=True, name="attenuation"),
        HinfGain("w", "effort", bound=effort, hard=True),
        HinfGain("w", "z", name="soft"),
    ]


@pytest.mark.further
@pytest.mark.parametrize("gain_before", [8e4, 1e-3])
def test_feasible_gain_is_found_from_far_infeasible_starts(gain_before: float) -> None:
    """All feasible gains are between 4 (soft made hard) and 4.5."""
    result = tune([lag(-0.5)], limits(1.0 / 4.5, 0.9), STATIC, initial=[[-gain_before]], options=GIVEN)
    assert result.feasible and result.status == "converged"
    assert -result.controller.D.item() == pytest.approx(4.5, rel=2e-3)


@pytest.mark.further
def test_infeasible_has_the_least_violation() -> None:
    """Effort k / (k + 1/2) at most 0.5 contradicts 1 / (k + 1/2) at most 0.5: equal violations at k = 1, of 4 / 3."""
    result = tune([lag(-0.5)], limits(0.5, 0.5), STATIC, initial=[[-1e3]], options=GIVEN)
    assert result.status == "infeasible" and not result.feasible and "hard requirement" in result.advice
    assert result.hard == pytest.approx(4.0 / 3.0, rel=1e-3)
    assert result.soft == pytest.approx(2.0 / 3.0, rel=5e-3)


@pytest.mark.further
@pytest.mark.parametrize("start", [0.5, pytest.param(-1e3, marks=pytest.mark.slow)])
def test_value_that_does_not_depend_on_the_parameters_is_infeasible(start: float) -> None:
    """The sum of the poles is -0.2 whatever the gain is: no decay of 10 rad/s."""
    D = [[0, 0], [0, 1], [0, 0]]
    plant = tuned_plant([[0, 1], [-1, -0.2]], [[0, 0], [1, 1]], [[1, 0], [0, 0], [1, 0]], D)
    needs = [HinfGain("w", ("z", "effort")), ClosedLoopPoles(min_decay=10.0)]
    result = tune([plant], needs, STATIC, initial=[[start]], options=GIVEN)
    assert result.status == "infeasible"
    assert result.hard == pytest.approx(2.0 - 0.1 / 10.0, rel=1e-9)


FEW = TuningOptions(starts=2)
OSCILLATOR = System([[0, 1], [-1, -0.2]], [[0], [1]], [[1, 0]], [[0]], [("u", 1)], [("y", 1)])
LAG = System([[-1]], [[1]], [[1]], [[0]], [("u", 1)], [("y", 1)])
PID = pid("y", "u", derivative_filter=0.05)


@pytest.mark.parametrize(
    ("model", "asked", "structure"),
    [
        (OSCILLATOR, [ClosedLoopPoles(min_decay=0.01)], PID),
        (OSCILLATOR, [ClosedLoopPoles(min_decay=0.4, min_damping=0.5)], PID),
        (LAG, [ClosedLoopPoles(max_frequency=10.0)], STATIC),
        (LAG, [ClosedLoopPoles(min_decay=2.0, max_frequency=2.1)], STATIC),
        (LAG, [HinfGain("u", "y", bound=0.9, hard=True)], STATIC),
    ],
)
def test_hard_requirements_alone(model: System, asked: Sequence[Any], structure: AffineStructure) -> None:
    """The first feasible point is the end: two models, of which the second is the first."""
    result = tune([model, model], asked, structure, options=FEW)
    assert str(result.status) == "converged" and result.advice.startswith("every hard requirement is met")
    assert result.soft == -np.inf and result.hard <= 1.0 and result.feasible and result.starts == (-np.inf,)
    assert result.certificate is not None and np.all(result.certificate.upper <= 1.0)
    assert result.stationarity == 0.0


@pytest.mark.further
def test_hard_requirements_alone_that_nothing_meets() -> None:
    """``s + 1 - k`` has its pole at k - 1: not faster than 3 and slower than 2 rad/s at once."""
    asked = [ClosedLoopPoles(3.0, max_frequency=2.0)]
    result = tune([LAG], asked, STATIC, initial=[[-0.5]], options=GIVEN)
    assert str(result.status) == "infeasible" and result.hard > 1.0


def test_hard_requirements_alone_over_a_box_and_in_discrete_time() -> None:
    asked = [ClosedLoopPoles(min_decay=1.0)]
    robust = tune_robust(lambda v: first_order(v["a"]), {"a": (0.5, 1.5)}, asked, STATIC)
    assert str(robust.status) == "converged" and robust.controller.D.item() <= -2.5 + 1e-6
    sampled = tune_discrete([first_order(0.99, 0.1)], asked, STATIC, options=FEW)
    assert str(sampled.status) == "converged" and abs(0.99 + sampled.controller.D.item()) <= np.exp(-0.1)


def held(kp: float) -> AffineStructure:
    return pid("y", "u", derivative_filter=0.1).with_fixed({"Kp": kp, "Ki": -1.0, "Kd": 0.0})


def test_a_structure_without_free_parameters() -> None:
    """``1 / (s - 1 + 5 + 1 / s)`` has its peak at 1 rad/s, of 1/4; with Kp = 5 the loop is unstable."""
    options, plant = TuningOptions(starts=1), first_order(1.0)
    for asked, status in (
        (GAIN, "converged"),
        (HinfGain("w", "z", hard=True), "converged"),
        (HinfGain("w", "z", bound=0.01, hard=True), "infeasible"),
    ):
        result = tune([plant], [asked], held(-5.0), options=options)
        assert str(result.status) == status and result.advice.startswith("the structure has no free parameter")
        assert max(result.soft, result.hard) == pytest.approx(0.25 / asked.bound, rel=1e-6)
        assert result.certificate is not None and result.certificate.upper.item() >= 0.25 / asked.bound
        unstable = tune([plant], [asked], held(5.0), options=options)
        assert str(unstable.status) == "not_stabilised" and unstable.certificate is None and unstable.abscissa > 0.0


def test_a_structure_without_free_parameters_over_a_box() -> None:
    """``1 / (s - a + 5 + 1 / s)``: 1 / (5 - a) at most."""
    result = tune_robust(lambda v: first_order(v["a"]), {"a": (0.5, 1.5)}, [GAIN], held(-5.0))
    assert str(result.status) == "converged" and result.soft == pytest.approx(1.0 / 3.5, rel=1e-6)
    assert result.worst[0].parameters["a"] == pytest.approx(1.5)
    box = {"a": (4.0, 6.0)}
    result = tune_robust(lambda v: first_order(v["a"]), box, [GAIN], held(-5.5), active=[{"a": 4.0}])
    assert str(result.status) == "not_stabilised"


@pytest.mark.parametrize(("k", "status"), [(-0.5, "converged"), (2.0, "not_stabilised")])
def test_a_discrete_structure_without_free_parameters(k: float, status: str) -> None:
    """x+ = 0.5 x + w + k x."""
    structure = gain([("y", 1)], [("u", 1)]).with_fixed({(0, 0): k})
    result = tune_discrete([first_order(0.5, 0.1)], [GAIN], structure)
    assert str(result.status) == status and result.controller.D.item() == k and result.controller.dt == 0.1
    assert result.soft == (pytest.approx(1.0) if k < 0 else np.inf)


EFFORT = TuningOptions(starts=0)


def tuned(*more: HinfGain, met: float, options: TuningOptions = EFFORT) -> TuningResult:
    """A lag with u = k y: its gain 1 / (1 - k) comes down to zero as k falls for ever; the command's is k / (k - 1)."""
    C, D = [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]]
    plant = System([[-1]], [[1, 1]], C, D, [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)], "lag")
    structure = gain([("y", 1)], [("u", 1)])
    options = replace(options, met=met)
    return tune([plant], [HinfGain("w", "z"), *more], structure, initial=[[-0.5]], options=options)


@pytest.mark.parametrize("met", [0.3, 1e-3])
def test_an_infimum_of_zero_is_converged_where_less_counts_as_met(met: float) -> None:
    found = tuned(met=met)
    assert found.status == "converged" and found.stationarity == 0.0 and "counts as met" in found.advice
    assert found.certificate is not None and found.certificate.upper.max() <= met
    assert float(found.controller.D[0, 0]) <= 1.0 - 1.0 / met


def test_a_minimum_above_it_is_converged_by_its_first_order_condition() -> None:
    """The effort held at 0.8 leaves 0.2 as the smallest gain."""
    limit = HinfGain("w", "effort", bound=0.8, hard=True)
    found = tuned(limit, met=0.1)
    assert found.status == "converged" and found.soft == pytest.approx(0.2, rel=2e-3)
    assert "random directions" in found.advice and 0.0 < found.stationarity < 1e-3


def test_hard_requirements_count_with_their_own_limit() -> None:
    """A hard value of 0.99 is above what counts as met, and kept."""
    limit = HinfGain("w", "effort", bound=0.96, hard=True)
    found = tuned(limit, met=0.05)
    assert found.status == "converged" and found.soft <= 0.05 < 0.98 < found.hard <= 1.0
