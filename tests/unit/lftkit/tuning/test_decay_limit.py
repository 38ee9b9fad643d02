"""Descents with a pole at the limit of stability: followed poles, points that are brought back, known optimum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from lftkit.systems.system import System
from lftkit.tuning import DescentOptions, descend
from lftkit.tuning.descent.decay_limit import DecayLimit
from lftkit.tuning.descent.grid_source import GridSource
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.structures.structures import state_space

OPTIMUM = 0.0909


def washed_out() -> System:
    """y = z = s / (s + 0.1) (w + u) / (s + 1): a pole of the controller at 0 cancels the zero, and remains there."""
    return System(
        [[-1.0, 0.0], [1.0, -0.1]],
        [[1.0, 1.0], [0.0, 0.0]],
        [[1.0, -0.1], [0.0, 0.0], [1.0, -0.1]],
        [[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]],
        [("w", 1), ("u", 1)],
        [("z", 1), ("effort", 1), ("y", 1)],
    )


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


def test_followed_poles_have_the_slopes_of_their_differences() -> None:
    problem, x = at_the_limit(0)
    limit = DecayLimit(problem, x)
    slow = min(limit.poles, key=lambda pole: abs(pole.value))
    assert slow.value.real == pytest.approx(-1e-6, rel=1e-4)
    for k, e in enumerate(np.eye(len(x))):
        h = 1e-9
        difference = (problem.abscissa(x + h * e) - problem.abscissa(x - h * e)) / (2.0 * h)
        assert slow.gradient[k] == pytest.approx(difference, rel=1e-3, abs=1e-5)
    moved = x + 1e-4 * np.random.default_rng(1).standard_normal(len(x))
    limit.move_to(moved)
    followed = min(limit.poles, key=lambda pole: abs(pole.value))
    assert followed.value.real == pytest.approx(problem.abscissa(moved), rel=1e-6)


def test_a_point_beyond_the_limit_is_brought_back_by_the_least_change() -> None:
    problem, x = at_the_limit(0)
    limit = DecayLimit(problem, x)
    trial = x + 0.01 * np.linalg.norm(x) * np.random.default_rng(5).standard_normal(len(x)) / np.sqrt(len(x))
    if problem.abscissa(trial) < -problem.min_decay:
        trial = 2.0 * x - trial
    assert problem.abscissa(trial) > 1e-4
    back = limit.restored(trial, 5e-12, np.asarray)
    assert back is not None and problem.abscissa(back) < -problem.min_decay
    slow = min(limit.poles, key=lambda pole: abs(pole.value))
    shortest = (problem.abscissa(trial) + problem.min_decay) / np.linalg.norm(slow.gradient)
    assert np.linalg.norm(back - trial) < 1.3 * shortest


def test_a_step_on_which_the_poles_are_lost_is_not_brought_back() -> None:
    problem, x = at_the_limit(0)
    limit = DecayLimit(problem, x)
    assert limit.restored(x + 100.0 * np.abs(x).max() * np.ones(len(x)), 5e-12, np.asarray) is None
