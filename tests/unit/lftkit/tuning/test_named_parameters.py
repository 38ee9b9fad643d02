"""Parameters by name: fixed ones, bounded ones, controllers side by side."""

from __future__ import annotations

import numpy as np
import pytest
from support.slow_cases import slow
from support.tuned_plants import STATIC, lag

from lftkit.systems.system import System
from lftkit.tuning import Decentralised, HinfGain, StableStateSpace, TuningOptions, controller, gain, pid, tune
from lftkit.tuning.structures.structures import AffineStructure, state_space


def frequency_response(K: System, omega: float) -> complex:
    return complex((K.C @ np.linalg.solve(1j * omega * np.eye(K.order) - K.A, K.B) + K.D).item())


def test_fixed_entry_of_the_filtered_derivative_holds_the_whole_derivative() -> None:
    """Entry (2, 1) is -Kd / filter: with it Kd is held, and what is left is an exact PI controller beside it."""
    fixed = pid("e", "u", derivative_filter=0.5).with_fixed({(2, 1): -4.0})
    assert fixed.names == ("Kp", "Ki")
    K = controller(fixed, [3.0, 7.0])
    for omega in (0.1, 2.0, 50.0):
        s = 1j * omega
        assert frequency_response(K, omega) == pytest.approx(3.0 + 7.0 / s + 2.0 * s / (0.5 * s + 1.0), rel=1e-12)


@pytest.mark.parametrize("fixed", [{"Kd": 0.25}, {(2, 1): -0.5}])
def test_fixed_parameter_leaves_the_others_free(fixed: dict[str | tuple[int, int], float]) -> None:
    whole = pid("e", "u", derivative_filter=0.5)
    K = whole.with_fixed(fixed).gain_matrix(np.array([3.0, 7.0]))
    assert pytest.approx(whole.gain_matrix(np.array([3.0, 7.0, 0.25]))) == K


def test_names_follow_the_parts_of_the_gain_matrix() -> None:
    structure = state_space([("y", 2)], [("u", 1)], 1)
    assert structure.names == ("A[0,0]", "B[0,0]", "B[0,1]", "C[0,0]", "D[0,0]", "D[0,1]")
    assert structure.values(np.arange(6.0))["D[0,0]"] == 4.0


def both() -> Decentralised:
    return Decentralised((gain([("y", 1)], [("a", 1)]), pid("y", "b", derivative_filter=0.1)))


def test_parts_with_a_common_measurement() -> None:
    structure = both()
    assert [p.name for p in structure.inputs] == ["y"]
    K = structure.gain_matrix(np.array([5.0, 3.0, 7.0, 0.2]))
    assert K.shape == (4, 3)
    assert K[2:, 2] == pytest.approx([5.0, 3.0 + 2.0])
    G = np.random.default_rng(0).standard_normal(K.shape)
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        slope = np.sum(G * (structure.gain_matrix(step) - structure.gain_matrix(-step))) / 2e-6
        assert structure.pullback(np.zeros(4), G)[k] == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize("fixed", [{"a.D[0,0]": -2.0}, {(2, 2): -2.0}])
def test_a_part_is_held_by_name_or_entry(fixed: dict[str | tuple[int, int], float]) -> None:
    structure = both().with_fixed(fixed)
    assert structure.names == ("b.Kp", "b.Ki", "b.Kd")
    assert structure.gain_matrix(np.zeros(3))[2, 2] == -2.0


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        ({"a.Kp": 1.0}, "parameter must be one of a.D[0,0], b.Kp, b.Ki, b.Kd, got 'a.Kp'"),
        ({(2, 0): 1.0}, "entry (2, 0) of the gain matrix is in no part of the structure"),
    ],
)
def test_what_no_part_has_is_refused(fixed: dict[str | tuple[int, int], float], message: str) -> None:
    with pytest.raises(ValueError) as refused:
        both().with_fixed(fixed)
    assert str(refused.value) == message


def test_part_that_can_hold_nothing_is_refused() -> None:
    structure = Decentralised((StableStateSpace((("y", 1),), (("u", 1),), 1),))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="parameters of u cannot be fixed or bounded, got a StableStateSpace"):
        structure.with_fixed({"u.x[0]": 1.0})


@pytest.mark.parametrize(("low", "high"), [(-3.0, -0.5), slow(-3.0, 10.0), slow(-3.0, np.inf)])
def test_optimum_at_a_bound_is_reached_and_said(low: float, high: float) -> None:
    """The gain 1 / (1 - k) falls as k does: the lowest k is best."""
    structure = STATIC.with_bounds({"D[0,0]": (low, high)})
    options = TuningOptions(starts=0)
    result = tune([lag()], [HinfGain("w", "z")], structure, initial=[[-0.6]], options=options)
    assert result.status == "converged"
    assert result.x[0] == pytest.approx(-3.0, abs=1e-4) and result.x[0] >= -3.0
    assert result.soft == pytest.approx(0.25, rel=1e-4)
    assert result.at_bounds == ("D[0,0]",)
    assert "D[0,0]" in result.advice
    assert result.values.shape == (1, 1) and result.requirement_names == ("HinfGain w -> z",)


def test_bounds_that_do_not_matter_change_nothing_in_the_optimum() -> None:
    needs = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)]
    structure = STATIC.with_bounds({"D[0,0]": (-30.0, 30.0)})
    result = tune([lag()], needs, structure, initial=[[0.0]], options=TuningOptions(starts=0))
    assert result.status == "converged" and result.at_bounds == ()
    assert result.x[0] == pytest.approx(-4.0, rel=1e-3)


def test_fixed_parameters_leave_the_bounds_of_the_others() -> None:
    structure: AffineStructure = pid("e", "u", derivative_filter=1.0).with_bounds({"Kp": (0, 1), "Kd": (2, 3)})
    fixed = structure.with_fixed({"Ki": 0.0})
    assert fixed.bounds is not None
    assert fixed.bounds.lower.tolist() == [0.0, 2.0] and fixed.bounds.upper.tolist() == [1.0, 3.0]


def test_without_need_of_less_gain_the_run_says_that_parameters_have_no_bound() -> None:
    """1 / (1 - k) falls for ever."""
    options = TuningOptions(starts=0, parameter_limit=1e7)
    result = tune([lag()], [HinfGain("w", "z")], STATIC, initial=[[0.0]], options=options)
    assert result.status == "unbounded"
    assert 1e5 < np.abs(result.x).max() <= 1e7
    assert result.at_bounds == ("D[0,0]",)
