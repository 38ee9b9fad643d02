"""Lower bounds of tuning problems: nothing is below them, something is just above, and another route agrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.full_order_bound import full_order_bound
from scipy.linalg import solve_continuous_are as care
from scipy.signal import tf2ss

from lftkit import System
from lftkit.arrays import FloatArray
from lftkit.synthesis.working_plant import gain_out_of_reach
from lftkit.tuning import (
    H2Gain,
    HinfGain,
    TuningOptions,
    TuningStatus,
    gain,
    lower_bound,
    state_space,
    tune,
)
from lftkit.tuning.full_order import reduced_starts
from lftkit.tuning.gains.loop import extended_plant
from lftkit.tuning.lower_bound import full_order_bounds
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import PLANTS

PORTS = [("w", 1), ("u", 1)], [("z", 2), ("y", 1)]
FINE = TuningOptions(starts=1, gap=1e-5)


def random_plant(seed: int, *, through: bool = True) -> System:
    """States 1 to 5, several ports, all direct paths that the bounds need and, as the seed has it, others."""
    rng = np.random.default_rng(seed)
    n, w, z, u, y = (int(k) for k in rng.integers([1, 2, 2, 1, 1], [6, 4, 4, 3, 3]))
    w, z = max(w, y), max(z, u)
    D = rng.standard_normal((z + y, w + u))
    D[:z, :w] *= through and rng.integers(2)
    D[z:, w:] *= 0.3 * rng.integers(2)
    matrices = rng.standard_normal((n, n)), rng.standard_normal((n, w + u)), rng.standard_normal((z + y, n)), D
    return System(*matrices, [("w", w), ("u", u)], [("z", z), ("y", y)])


def problem_of(plant: System, kind: type[HinfGain] | type[H2Gain], order: int) -> Problem:
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], order, feedthrough=kind is HinfGain)
    return Problem([plant], [kind("w", "z")], structure)


@pytest.mark.further
def test_the_hinf_bound_is_that_of_another_route_and_is_reached() -> None:
    """By the existence conditions of a textbook on a Schur form, and by a controller of full order; most have one."""
    found = 0
    for seed in range(8):
        plant = random_plant(seed)
        problem = problem_of(plant, HinfGain, plant.order)
        bound = full_order_bounds(problem)[0, 0]
        if not np.isfinite(bound):
            continue
        found += 1
        other = full_order_bound(plant)
        assert 0.997 * other - 1e-6 < bound < (1.0 + 1e-4) * other + 1e-6, seed
        values = [problem.evaluate(x, gradients=False).values[0, 0] for x in reduced_starts(problem)]
        assert bound <= min(values) * (1.0 + 1e-9) and min(values) < 1.02 * bound + 1e-2, seed
    assert found > 6


@pytest.mark.parametrize("seed", range(6))
def test_the_h2_bound_is_the_separation_principle(seed: int) -> None:
    """Cost of state feedback plus that of the estimator; nothing that a descent finds is below it."""
    plant = random_plant(seed, through=False)
    n, u = plant.order, plant.input_indices(["u"])
    w, z, y = plant.input_indices(["w"]), plant.output_indices(["z"]), plant.output_indices(["y"])
    A, B1, B2, C1, C2 = plant.A, plant.B[:, w], plant.B[:, u], plant.C[z], plant.C[y]
    D12, D21 = plant.D[np.ix_(z, u)], plant.D[np.ix_(y, w)]
    bound = full_order_bounds(problem_of(plant, H2Gain, n))[0, 0]
    X = care(A, B2, C1.T @ C1, D12.T @ D12, s=C1.T @ D12)
    Y = care(A.T, C2.T, B1 @ B1.T, D21 @ D21.T, s=B1 @ D21.T)
    F = -np.linalg.solve(D12.T @ D12, B2.T @ X + D12.T @ C1)
    cost = np.trace(B1.T @ X @ B1) + np.trace(D12 @ F @ Y @ F.T @ D12.T)
    assert bound == pytest.approx(np.sqrt(cost), rel=2e-6) and bound <= np.sqrt(cost)


def coprime_problem() -> tuple[System, float]:
    """Robust stabilisation of normalised coprime factors, and its optimum from two Riccati equations."""
    A, B, C, _ = tf2ss([20.0], np.polymul([10.0, 1.0], [0.05, 1.0]))
    X, Z = care(A, B, C.T @ C, np.eye(1)), care(A.T, C.T, B @ B.T, np.eye(1))
    O: FloatArray = np.zeros((2, 1))
    D = np.array([[1, 0, 0], [0, 0, 1], [1, 0, 0.0]])
    ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    plant = System(A, np.hstack([O, B, B]), np.vstack([C, 0 * C, C]), D, *ports)
    return plant, float(np.sqrt(1 + np.linalg.eigvals(X @ Z).real.max()))


def test_a_run_ends_near_the_bound_and_says_so() -> None:
    plant, optimum = coprime_problem()
    problem, options = problem_of(plant, HinfGain, 2), TuningOptions(starts=0, gap=0.01)
    result = tune(
        [plant], problem.requirements, problem.structure, initial=reduced_starts(problem)[:1], options=options
    )
    assert result.status is TuningStatus.CONVERGED and "any controller of any order" in result.advice
    assert result.lower_bound == pytest.approx(optimum, rel=1e-5) and result.lower_bound <= optimum
    assert optimum <= result.soft < 1.01 * optimum and result.gap == pytest.approx(result.soft / optimum - 1, abs=1e-5)


@pytest.mark.further
def test_a_hard_limit_below_the_bound_is_infeasible_and_said_so() -> None:
    plant, optimum = coprime_problem()
    asked = [HinfGain("w", "z", bound=0.9 * optimum, hard=True), HinfGain("w", "y")]
    few = TuningOptions(starts=1, iterations=10)
    result = tune([plant], asked, gain([("y", 1)], [("u", 1)]), options=few)
    assert result.status is TuningStatus.INFEASIBLE and result.advice.startswith("no controller of any order")
    assert f"{1 / 0.9:.4g} times its bound" in result.advice
    reachable = [HinfGain("w", "z", bound=1.2 * optimum, hard=True), HinfGain("w", "y")]
    result = tune([plant], reachable, state_space([("y", 1)], [("u", 1)], 2), options=replace(few, target=1e6))
    assert result.feasible


def test_no_bound_where_it_would_not_be_one() -> None:
    """A command without weight, a measurement without noise, a band of frequencies, a delay."""
    free = System([[-1]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    law = gain([("y", 1)], [("u", 1)])
    assert full_order_bounds(Problem([free], [HinfGain("w", "z")], law))[0, 0] == -np.inf
    ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    noisy = System([[-1]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], *ports)
    for more, kept in (({}, True), ({"loop_delay": 0.1}, False)):
        found = full_order_bounds(Problem([noisy], [HinfGain("w", "z")], law, **more))[0, 0]  # type: ignore[arg-type]
        assert np.isfinite(found) == kept
    banded = Problem([noisy], [HinfGain("w", "z", band=(0.1, 2.0))], law)
    assert full_order_bounds(banded)[0, 0] == -np.inf


def test_a_level_that_a_loop_is_below_is_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding may end the search for the lowest level too early; the loop of a controller refutes it."""
    problem = problem_of(random_plant(3), HinfGain, 0)
    least = float(full_order_bounds(problem)[0, 0])
    level = 4.0 * least
    monkeypatch.setattr(lower_bound, "lowest_level", lambda plant: (level, (1.0 + 2e-6) * level))
    assert least > 0.0 and full_order_bounds(problem)[0, 0] == -np.inf


def test_a_gap_below_the_accuracy_of_the_certificate_is_no_target() -> None:
    """Once: ``target``, which was not given, at a value of half the gap; a lexicographic tuning ended there."""
    plant = System([[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 0.5], [1, 0]], *PORTS)
    result = tune([plant], [HinfGain("w", "z")], state_space([("y", 1)], [("u", 1)], 1), options=FINE)
    assert result.status is TuningStatus.CONVERGED and "local minimum" in result.advice
    assert 0.0 <= result.gap < 1e-5


def test_a_plant_without_noise_has_the_bound_of_full_order_synthesis() -> None:
    """COMPleib's AC16, nothing of it weighted; once the bound of single points, 0.6 % lower, and a search of 33 s."""
    plant = PLANTS["AC16"]()
    law = state_space(plant.outputs[1:], plant.inputs[1:], 1)
    reach = gain_out_of_reach(extended_plant(plant, ("y",), ("u",), 0, HinfGain("w", "z")))
    result = tune([plant], [HinfGain("w", "z")], law, options=TuningOptions(starts=8))
    assert result.status is TuningStatus.CONVERGED and reach < 0.996 * result.lower_bound
    assert result.lower_bound <= result.soft <= 1.001 * result.lower_bound and len(result.starts) < 8
