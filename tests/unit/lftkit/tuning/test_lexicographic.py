"""Lexicographic tuning: against problems of decoupled loops whose levels are known, and one whose loops compete."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from lftkit import System
from lftkit.tuning import (
    AffineStructure,
    ClosedLoopPoles,
    ControllerPoles,
    H2Gain,
    HinfGain,
    Passivity,
    RobustOptions,
    TuningOptions,
    TuningRequirement,
    TuningResult,
    WorstCaseOptions,
    certify,
    gain,
    state_space,
    tune,
    tune_discrete,
    tune_robust,
)

IN_ORDER = TuningOptions(starts=0, lexicographic=True)
EFFORTS = (0.5, 0.8)
LEVELS = (0.5, 0.2)
"""With u = k y on x' = -x + w + u the gain to x is 1 / (1 - k), that to u is -k / (1 - k): their sum is 1."""


def lags(count: int = 2, pole: float = -1.0, dt: float = 0.0) -> System:
    """Decoupled systems of order 1: w0, w1 ... and u to z0, z1 ..., e0, e1 ... (the commands) and y."""
    one, nothing = np.eye(count), np.zeros((count, count))
    D = np.block([[nothing, nothing], [nothing, one], [nothing, nothing]])
    inputs = [*((f"w{k}", 1) for k in range(count)), ("u", count)]
    outputs = [*((f"{name}{k}", 1) for name in "ze" for k in range(count)), ("y", count)]
    return System(pole * one, np.hstack([one, one]), np.vstack([one, nothing, one]), D, inputs, outputs, "lags", dt=dt)


def errors_and_efforts(efforts: Sequence[float] = EFFORTS) -> list[TuningRequirement]:
    return [
        *(HinfGain(f"w{k}", f"z{k}", name=f"z{k}") for k in range(len(efforts))),
        *(HinfGain(f"w{k}", f"e{k}", bound=b, hard=True, name=f"e{k}") for k, b in enumerate(efforts)),
    ]


def law(count: int = 2) -> AffineStructure:
    """A gain for each loop."""
    crossed = {(i, k): 0.0 for i in range(count) for k in range(count) if i != k}
    return gain([("y", count)], [("u", count)]).with_fixed(crossed)


def tuned(
    requirements: Sequence[TuningRequirement], options: TuningOptions = IN_ORDER, count: int = 2, start: float = -0.5
) -> TuningResult:
    return tune([lags(count)], requirements, law(count), initial=[[start] * count], options=options)


def reached(result: TuningResult, name: str) -> float:
    return float(result.values[result.requirement_names.index(name)].max())


@pytest.mark.further
@pytest.mark.parametrize("start", [pytest.param(-0.5, marks=pytest.mark.slow), -1.0])
def test_each_loop_has_its_own_level(start: float) -> None:
    """At -1 both loops start at the optimum of the first, at which no minimax descent has anything to lower."""
    found = tuned(errors_and_efforts(), start=start)
    assert [level.requirements for level in found.levels] == [("z0",), ("z1",)]
    assert [level.value for level in found.levels] == pytest.approx(LEVELS, rel=2e-3)
    for name, value in zip(("z0", "z1"), LEVELS):
        assert reached(found, name) == pytest.approx(value, rel=3e-3)
    assert found.status == "converged" and found.feasible and found.certificate is not None
    assert found.soft == pytest.approx(LEVELS[0], rel=3e-3)


@pytest.mark.further
def test_what_competes_with_a_held_requirement_stays() -> None:
    """One loop: its error is least where its effort is largest. The third requirement falls with the effort."""
    needs = [
        HinfGain("w0", "z0", bound=0.4, name="error"),
        HinfGain("w0", "e0", bound=0.6, name="effort"),
        HinfGain("w0", "e0", bound=1.2, name="half the effort"),
    ]
    found = tuned(needs, count=1)
    assert set(found.levels[0].requirements) == {"error", "effort"} and found.levels[0].value == pytest.approx(1.0)
    assert reached(found, "half the effort") == pytest.approx(0.5, rel=3e-3)


@pytest.mark.further
def test_values_up_to_those_that_count_as_met_are_left() -> None:
    found = tuned(errors_and_efforts(), replace(IN_ORDER, met=0.3, iterations=30))
    assert [level.requirements for level in found.levels] == [("z0",)]
    assert reached(found, "z1") <= 0.3 * 1.001


def test_a_target_ends_it() -> None:
    found = tuned(errors_and_efforts(), replace(IN_ORDER, target=0.7))
    assert found.status == "target" and found.levels == ()


@pytest.mark.further
@pytest.mark.parametrize(
    "second",
    [
        ClosedLoopPoles(min_decay=10.0, hard=False, name="second"),
        pytest.param(Passivity("w1", "z1", input_index=-0.5, name="second"), marks=pytest.mark.slow),
    ],
    ids=["poles", "passivity"],
)
def test_requirements_of_all_kinds_are_held(second: TuningRequirement) -> None:
    """The second one is critical, and stays at its level while the first falls to its own."""
    needs = [HinfGain("w0", "z0", bound=10.0, name="first"), *errors_and_efforts()[2:], second]
    found = tuned(needs)
    names = [name for level in found.levels for name in level.requirements]
    assert names[0].startswith("second") and names[-1] == "first" and found.feasible
    assert reached(found, names[0]) <= found.levels[0].value * (1.0 + 2.0 * IN_ORDER.hold)
    assert reached(found, "first") == pytest.approx(0.05, rel=5e-3)


@pytest.mark.further
def test_in_discrete_time() -> None:
    """x+ = x / 2 + w + u: the gain 1 / (1 - |1/2 + k|) is least, 1, at k = -1/2, with the gain 1/2 to the command."""
    plant = lags(pole=0.5, dt=0.1)
    needs = [HinfGain("w0", "z0", name="z0"), HinfGain("w1", "z1", bound=2.0, name="z1")]
    found = tune_discrete([plant], needs, law(), initial=[[0.1, 0.1]], options=IN_ORDER)
    assert [level.requirements for level in found.levels] == [("z0",), ("z1",)]
    assert (reached(found, "z0"), reached(found, "z1")) == pytest.approx((1.0, 0.5), rel=5e-3)
    assert found.controller.dt == 0.1 and found.status == "converged"


@pytest.mark.further
def test_over_a_box_of_parameters() -> None:
    """The slowest pole, -1/2, is the worst: 1 / (1/2 - k) with -k / (1/2 - k) of at most the efforts."""
    options = RobustOptions(tuning=replace(IN_ORDER, iterations=20), search=WorstCaseOptions(samples=0, climbs=1))
    needs, box = errors_and_efforts(), {"a": (0.5, 1.5)}
    found = tune_robust(
        lambda values: lags(pole=-values["a"]),
        box,
        needs,
        law(),
        active=[{"a": 1.0}, {"a": 0.5}],
        initial=[[-0.5, -0.5]],
        options=options,
    )
    worst = {case.requirement: case for case in found.worst}
    assert [level.requirements for level in found.levels] == [("z0",), ("z1",)]
    for name, effort in zip(("z0", "z1"), EFFORTS):
        assert worst[name].value == pytest.approx((1.0 - effort) / 0.5, rel=0.02)
        assert worst[name].parameters["a"] == pytest.approx(0.5)


@pytest.mark.parametrize("level", [0.4, 1.0, 1.7, 3.0])
def test_a_held_requirement_is_just_met_at_its_level(level: float) -> None:
    """Values of the same loop: those of the held one are in units of the level."""
    plant, K = lags(), System.static(-np.eye(2), [("y", 2)], [("u", 2)])
    for asked in (
        HinfGain("w0", "z0", bound=0.3),
        H2Gain("w0", "z0", bound=0.2),
        ClosedLoopPoles(min_decay=5.0, min_damping=0.9, max_frequency=3.0),
        ControllerPoles(min_decay=1.0),
        Passivity("w0", "z0", input_index=-0.5).requirements_on(plant)[0],
    ):
        law = System([[0.5]], [[1.0, 0.0]], [[1.0], [0.0]], -np.eye(2), [("y", 2)], [("u", 2)])
        controller = law if isinstance(asked, ControllerPoles) else K
        given, held = (certify([plant], controller, [one]).values.item() for one in (asked, asked.held(level)))
        assert held == pytest.approx(given / level, rel=1e-6) and asked.held(level).hard


def test_soft_poles_of_a_controller_that_has_to_be_unstable_are_a_level() -> None:
    """(s - 1) / (s (s - 2)) has one unstable pole between its zeros at 1 and infinity: no stable controller holds it.

    -(14 s - 1) / (s - 9) brings all poles of the loop to -1.
    """
    A, B, C = np.array([[2.0, 0.0], [1.0, 0.0]]), np.array([[1.0, 1.0], [0.0, 0.0]]), np.array([[1.0, -1.0]])
    inputs, outputs = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    plant = System(A, B, np.vstack([C, C]), np.zeros((2, 2)), inputs, outputs, "interlaced")
    structure = state_space([("y", 1)], [("u", 1)], 1)
    start = structure.parameters_of(System([[9.0]], [[1.0]], [[-125.0]], [[-14.0]], [("y", 1)], [("u", 1)]))
    needs = [HinfGain("w", "z", bound=100.0, name="gain"), ControllerPoles(min_decay=1.0, hard=False, name="own poles")]
    found = tune([plant], needs, structure, initial=[start], options=replace(IN_ORDER, iterations=20))
    assert found.certificate is not None and found.certificate.stable
    assert found.levels[0].requirements == ("own poles",) and found.levels[0].value > 2.0
    assert [name for level in found.levels for name in level.requirements] == ["own poles", "gain"]
