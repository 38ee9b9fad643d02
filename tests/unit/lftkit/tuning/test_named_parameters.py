"""Parameters by name: fixed and bounded ones, controllers side by side, structures of the user."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.slow_cases import slow
from support.tuned_plants import STATIC, lag

from lftkit import Port, System
from lftkit.analysis.norms import hinf_norm
from lftkit.tuning import Decentralised, HinfGain, TuningOptions, controller, gain, pid, tune
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


@pytest.mark.parametrize("high", [-0.5, slow(10.0), slow(np.inf)])
def test_optimum_at_a_bound_is_reached_and_said(high: float) -> None:
    """The gain 1 / (1 - k) falls as k does: the lowest k is best."""
    structure = STATIC.with_bounds({"D[0,0]": (-3.0, high)})
    options = TuningOptions(starts=0)
    result = tune([lag()], [HinfGain("w", "z")], structure, initial=[[-0.6]], options=options)
    assert result.status == "converged"
    assert result.x[0] == pytest.approx(-3.0, abs=1e-4) and result.x[0] >= -3.0
    assert result.soft == pytest.approx(0.25, rel=1e-4)
    assert result.at_bounds == ("D[0,0]",)
    assert "D[0,0]" in result.advice
    assert result.values.shape == (1, 1) and result.requirement_names == ("HinfGain w -> z",)


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


class Lead:
    """k (s + z) / (s + p); the parameters are the logarithms of k, z and p."""

    inputs, outputs, order, size = (Port("seen", 1),), (Port("force", 1),), 1, 3

    def gain_matrix(self, x: np.ndarray) -> np.ndarray:
        k, z, p = np.exp(x)
        return np.array([[-p, 1.0], [k * (z - p), k]])

    def pullback(self, x: np.ndarray, G: np.ndarray) -> np.ndarray:
        k, z, p = np.exp(x)
        return np.array([k * (z - p) * G[1, 0] + k * G[1, 1], k * z * G[1, 0], -p * G[0, 0] - k * p * G[1, 0]])

    def start(self, rng: np.random.Generator) -> np.ndarray:
        return rng.standard_normal(3)


@pytest.mark.filterwarnings("ignore:overflow encountered in:RuntimeWarning")
@pytest.mark.parametrize("seed", range(2))
def test_an_optimum_at_infinity_ends_at_gains_that_are_numbers(seed: int) -> None:
    """The compliance of a free mass falls for ever with the gain."""
    structure: Any = Lead()
    ports: Any = [("push", 1), ("force", 1)], [("position", 1), ("seen", 1)]
    mass = System([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [-1, 0]], np.zeros((2, 2)), *ports)
    options = TuningOptions(starts=0, wall_limit=60.0)
    start = np.array([0.0, 0.0, 2.0]) + 0.1 * np.random.default_rng(seed).standard_normal(3)
    result = tune([mass], [HinfGain("push", "position")], structure, initial=[start], options=options)
    assert 0.0 < result.soft < 1e-4
    assert np.isfinite(structure.gain_matrix(result.x)).all()


EFFORT, STIFFEST, HEAVIEST = 0.4, 5.0, 4.0


def payload() -> System:
    """1 kg on a spring that is not in the model: base w, load f, spring force and actuator force on it."""
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0, 0, 0, 0], [0, 1, 1, 1]]
    C = [[1, 0], [0, 0], [-1, 0], [0, 1]]
    D = [[0, 0, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 0]]
    inputs = [("base", 1), ("load", 1), ("spring", 1), ("actuator", 1)]
    return System(A, B, C, D, inputs, [("position", 1), ("spring_force", 1), ("stretch", 1), ("velocity", 1)])


def value(k: float, d: float) -> float:
    """Largest of both goals with the spring k and the law -d, of the equation of motion."""
    A = np.array([[0.0, 1.0], [-k, -d]])
    compliance = hinf_norm(A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))).value
    felt = hinf_norm(A, np.array([[0.0], [k]]), np.array([[-k, 0.0]]), np.array([[k]])).value
    return max(compliance, EFFORT * felt)


@pytest.mark.further
def test_a_spring_and_a_law_are_tuned_together() -> None:
    """A stiff spring holds the load, a soft one passes less of the base's motion: the best of a scan of both."""
    parts = gain([("stretch", 1)], [("spring", 1)]), gain([("velocity", 1)], [("actuator", 1)])
    structure = Decentralised(parts).with_bounds(
        {"spring.D[0,0]": (0.1, STIFFEST), "actuator.D[0,0]": (-HEAVIEST, -0.1)}
    )
    goals = [HinfGain("load", "position"), HinfGain("base", "spring_force", bound=1.0 / EFFORT)]
    result = tune([payload()], goals, structure, initial=[[1.0, -1.0]], options=TuningOptions(starts=0))
    found = structure.values(result.x)
    k, d = found["spring.D[0,0]"], -found["actuator.D[0,0]"]
    assert result.soft == pytest.approx(value(k, d), rel=1e-4)
    scan = min(value(a, b) for a in np.linspace(0.5, 3.0, 26) for b in np.linspace(0.5, HEAVIEST, 15))
    assert result.soft <= scan * (1.0 + 1e-4) and result.soft > 0.9 * scan
    assert result.at_bounds == ("actuator.D[0,0]",)
