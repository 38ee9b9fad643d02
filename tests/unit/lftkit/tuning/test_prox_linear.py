"""Descents from points that meet, violate or touch a limit: known optima, looks that never rise, interruptions."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from scipy import optimize
from support.tuned_plants import STATIC, lag, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import DescentOptions, DescentState, descend
from lftkit.tuning.descent.grid_source import GridSource
from lftkit.tuning.descent.minimax.minimax import lower_point
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.structures.structures import state_space


def limited() -> Problem:
    """With u = k y the gain is 1 / (1 - k), the command's -k / (1 - k) is held at 0.8: the optimum is k = -4."""
    requirements = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)]
    return Problem([lag()], requirements, STATIC)


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
    options = DescentOptions(120, 1e-4, patience=1, retries=2, confirm=True)
    whole = descend(GridSource(problem), x, options, lambda _, point: seen.append(point.merit), states.append)
    assert len(states) > 2 and all(after <= before for before, after in itertools.pairwise(seen))
    assert seen[-1][1] < 0.9 * seen[0][1]
    for state in (states[1], states[-2]):
        kept = DescentState.from_mapping(json.loads(json.dumps(state.to_mapping())))
        again = descend(GridSource(problem), x, options, goes_on=kept)
        assert again.x.tobytes() == whole.x.tobytes() and again.status is whole.status


def test_an_unstable_start_is_refused() -> None:
    with pytest.raises(ValueError, match="start must have finite gains"):
        descend(GridSource(limited()), np.array([2.0]))


OPTIMUM = 0.0909


def washed_out() -> System:
    """y = z = s / (s + 0.1) (w + u) / (s + 1): a pole of the controller at 0 cancels the zero, and remains there."""
    C, D = [[1.0, -0.1], [0.0, 0.0], [1.0, -0.1]], [[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
    return tuned_plant([[-1.0, 0.0], [1.0, -0.1]], [[1.0, 1.0], [0.0, 0.0]], C, D)


def at_the_limit(seed: int) -> tuple[Problem, np.ndarray]:
    """A controller with a pole that the loop leaves 5e-12 rad/s from the limit, in random coordinates."""
    requirements = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.9, hard=True)]
    problem = Problem([washed_out()], requirements, state_space([("y", 1)], [("u", 1)], 2))
    T = np.random.default_rng(seed).standard_normal((2, 2))
    B, C = np.array([[0.3], [1.0]]), np.array([[-0.3, -1.0]])

    def start(pole: float) -> np.ndarray:
        A, inverse = np.diag([pole, -20.0]), np.linalg.inv(T)
        K = System(T @ A @ inverse, T @ B, C @ inverse, [[-0.2]], [("y", 1)], [("u", 1)])
        return np.asarray(problem.structure.parameters_of(K))

    goal = -problem.min_decay - 5e-12
    return problem, start(optimize.brentq(lambda p: problem.abscissa(start(p)) - goal, -1e-4, 0.0, xtol=1e-16))


@pytest.mark.parametrize("seed", [0, 3])
def test_a_pole_at_the_limit_does_not_end_the_descent(seed: int) -> None:
    problem, x = at_the_limit(seed)
    found = descend(GridSource(problem), x, DescentOptions(iterations=200, tolerance=1e-4)).point
    assert found.soft == pytest.approx(OPTIMUM, rel=1e-3) and found.hard <= 1.0
    assert found.found.abscissa < -problem.min_decay
