"""Prox-linear steps and the descent made of them: slopes against differences, known optima, hard requirements kept."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from lftkit.systems.system import System
from lftkit.tuning import DescentOptions, DescentState, descend
from lftkit.tuning.descent.grid_source import GridSource
from lftkit.tuning.descent.minimax.minimax import lower_point
from lftkit.tuning.descent.minimax.prox_linear import prox_linear
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.descent.smooth_phase import smooth_phase
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.structures.structures import gain, gain_sizes, state_space


def lag() -> System:
    """1 / (s + 1) with a disturbance on its input, the command a second output."""
    return System(
        [[-1]],
        [[1, 1]],
        [[1], [0], [1]],
        [[0, 0], [0, 1], [0, 0]],
        [("w", 1), ("u", 1)],
        [("z", 1), ("effort", 1), ("y", 1)],
    )


def limited() -> Problem:
    """With u = k y the gain is 1 / (1 - k), the command's -k / (1 - k) is held at 0.8: the optimum is k = -4."""
    requirements = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)]
    return Problem([lag()], requirements, gain([("y", 1)], [("u", 1)]))


def two_axes(delay: float) -> tuple[Problem, np.ndarray]:
    rng = np.random.default_rng(3)
    A = np.diag([-1.0, -2.0, -0.5, -3.0]) + 0.3 * rng.standard_normal((4, 4))
    inputs, outputs = [("w", 2), ("u", 2)], [("z", 2), ("y", 2)]
    D = np.zeros((4, 4))
    D[:2, 2:] = 0.1 * np.eye(2)
    model = System(A, rng.standard_normal((4, 4)), rng.standard_normal((4, 4)), D, inputs, outputs)
    requirements = [
        HinfGain("w", "z", name="peak"),
        H2Gain("w", "z", bound=2.0, name="rms"),
        HinfGain("w", "z", bound=3.0, hard=True, name="bound"),
        ClosedLoopPoles(min_decay=0.05),
    ]
    structure = state_space([("y", 2)], [("u", 2)], 1, feedthrough=False)
    K = System([[-1.0]], [[0.2, 0.1]], [[0.3], [-0.2]], np.zeros((2, 2)), [("y", 2)], [("u", 2)])
    return Problem([model], requirements, structure, loop_delay=delay), structure.parameters_of(K)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_linearised_values_have_the_slopes_of_their_differences(delay: float) -> None:
    problem, x = two_axes(delay)
    objective = SmoothObjective(problem, x, problem.evaluate(x))
    (values, gradients, hard), h = objective.linearised(x), 1e-6
    assert len(values) > 4 and hard.any() and not hard.all()
    for k, e in enumerate(np.eye(len(x))):
        more, less = objective.linearised(x + h * e)[0], objective.linearised(x - h * e)[0]
        assert len(more) == len(less) == len(values)
        differences = (more - less) / (2 * h)
        assert gradients[:, k] == pytest.approx(differences, rel=1e-5, abs=1e-6 * np.abs(gradients).max())


@pytest.mark.parametrize("start", [0.5, -0.5, -20.0])
def test_the_optimum_on_a_hard_requirement_is_reached_from_both_sides(start: float) -> None:
    problem = limited()
    x = np.array([start])
    objective = SmoothObjective(problem, x, problem.evaluate(x))
    objective.steps, objective.slow = 60, 1e-9
    found = prox_linear(objective, x)
    assert found.x == pytest.approx([-4.0], rel=2e-3)


def test_a_step_never_raises_the_value_and_keeps_what_is_met() -> None:
    problem, x = two_axes(0.0)
    objective = SmoothObjective(problem, x, problem.evaluate(x))
    objective.steps, objective.slow = 1, 0.0
    soft, hard = objective.largest(x)
    weight = 1.0
    first = soft
    for _ in range(6):
        found = prox_linear(objective, x, weight=weight)
        x, weight = found.x, found.weight
        new_soft, new_hard = objective.largest(x)
        assert new_soft <= soft + max(hard, 0.0) and new_hard <= max(hard, 0.0)
        soft, hard = new_soft, new_hard
    assert soft < first - 0.01


def test_the_smooth_phase_ends_at_the_optimum_of_a_finite_maximum() -> None:
    found = smooth_phase(limited(), np.array([-0.5]), 400, np.inf, 0.0)
    assert found.point.feasible and found.point.soft == pytest.approx(0.2, rel=2e-3)


def test_sizes_of_entries_scale_with_the_controller_and_zero_parts_have_none() -> None:
    rng = np.random.default_rng(0)
    K = rng.standard_normal((5, 4))
    units = (np.diag([10.0, 0.1]), np.diag([5.0]))
    sizes = gain_sizes(K, 3)
    scaled = K.copy()
    scaled[3:] = units[0] @ scaled[3:]
    scaled[:, 3:] = scaled[:, 3:] @ units[1]
    assert gain_sizes(scaled, 3)[3:, :3] == pytest.approx(units[0] @ sizes[3:, :3])
    assert gain_sizes(scaled, 3)[:3, 3:] == pytest.approx(sizes[:3, 3:] @ units[1])
    assert gain_sizes(scaled, 3)[3:, 3:] == pytest.approx(units[0] @ sizes[3:, 3:] @ units[1])
    no_output = K.copy()
    no_output[3:] = 0.0
    assert np.isinf(gain_sizes(no_output, 3)[3:]).all() and np.isfinite(gain_sizes(no_output, 3)[:3]).all()
    assert np.isinf(gain_sizes(np.zeros((2, 2)), 0)).all()


OPTIONS = DescentOptions(600, 1e-5, patience=2, retries=3, confirm=True)


@pytest.mark.parametrize("start", [-0.5, -20.0])
def test_the_optimum_on_a_hard_requirement_is_reached_and_confirmed(start: float) -> None:
    """From points that meet and that violate it."""
    found = descend(GridSource(limited()), np.array([start]), OPTIONS)
    assert found.status == "converged" and found.point.feasible
    assert found.x == pytest.approx([-4.0], rel=1e-3)
    assert lower_point(GridSource(limited()), found.point) is None


def test_looks_never_rise_and_an_interrupted_descent_goes_on_with_the_same_bits() -> None:
    (problem, x), seen = two_axes(0.0), []
    states: list[DescentState] = []
    options = DescentOptions(120, 1e-4, patience=1, retries=2)
    whole = descend(GridSource(problem), x, options, lambda _, point: seen.append(point.merit), states.append)
    assert len(states) > 2 and all(after <= before for before, after in itertools.pairwise(seen))
    assert seen[-1][1] < 0.9 * seen[0][1]
    kept = DescentState.from_mapping(json.loads(json.dumps(states[1].to_mapping())))
    again = descend(GridSource(problem), x, options, goes_on=kept)
    assert again.x.tobytes() == whole.x.tobytes() and again.status is whole.status


def test_an_unstable_start_is_refused() -> None:
    with pytest.raises(ValueError, match="start must have finite gains"):
        descend(GridSource(limited()), np.array([2.0]))
