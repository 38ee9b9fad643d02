"""Prox-linear steps: linearisations against differences, known optima, hard requirements kept."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.system import System
from lftkit.tuning.descent.grid_source import GridWorkingSet
from lftkit.tuning.descent.prox_linear import prox_linear
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.descent.smooth_phase import smooth_phase
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.structures import gain, gain_sizes, state_space


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
    here, h = objective.linearised(x), 1e-6
    assert len(here.values) > 4 and here.hard.any() and not here.hard.all()
    for k, e in enumerate(np.eye(len(x))):
        more, less = objective.linearised(x + h * e), objective.linearised(x - h * e)
        assert len(more.values) == len(less.values) == len(here.values)
        differences = (more.values - less.values) / (2 * h)
        assert here.gradients[:, k] == pytest.approx(differences, rel=1e-5, abs=1e-6 * np.abs(here.gradients).max())


@pytest.mark.parametrize("start", [0.5, -0.5, -20.0])
def test_the_optimum_on_a_hard_requirement_is_reached_from_both_sides(start: float) -> None:
    problem = limited()
    x = np.array([start])
    objective = SmoothObjective(problem, x, problem.evaluate(x))
    found = prox_linear(GridWorkingSet(objective, 60, 1e-9), x)
    assert found.x == pytest.approx([-4.0], rel=2e-3)


def test_a_step_never_raises_the_value_and_keeps_what_is_met() -> None:
    problem, x = two_axes(0.0)
    objective = SmoothObjective(problem, x, problem.evaluate(x))
    soft, hard = objective.largest(x)
    weight = 1.0
    first = soft
    for _ in range(6):
        found = prox_linear(GridWorkingSet(objective, 1, 0.0), x, weight=weight)
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
