"""Search on the exact value: a narrow valley of fast controller poles and large gains that cancel."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.tuning import HinfGain, state_space
from lftkit.tuning.descent.direct_search import direct_polish, direct_restarts
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.metric import Metric
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.quasi_newton import quasi_newton
from lftkit.tuning.descent.starts import Start
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import published_plant

REACHED = 0.0496  # AC7 with one state; the infimum is near 0.04954, as the pole goes to infinity: a differentiator


@pytest.fixture(scope="module")
def problem() -> Problem:
    plant = published_plant("AC7")
    return Problem([plant], [HinfGain("w", "z")], state_space([plant.outputs[1]], [plant.inputs[1]], 1))


def differentiator(speed: float) -> np.ndarray:
    """Rows A B, C D of a controller with s / (s + speed) from the first measurement: 5.9 for speed 100."""
    return np.array([-speed, 0.3 * speed, 0.0, -0.3 * speed, 0.096 * speed, 0.06])


@pytest.mark.slow
def test_perturbed_restarts_follow_the_valley(problem: Problem) -> None:
    x = differentiator(100.0)
    first = float(np.exp(ExactValue(problem)(x)[0]))
    found = [direct_restarts(problem, Start(seed, x), DescentOptions(), 0.3) for seed in range(3)]
    assert first > 5.0 and all(run.soft < REACHED for run in found)


def test_the_metric_finds_the_way_that_the_parameters_hide(problem: Problem) -> None:
    """The same BFGS in the parameters as they are ends above."""
    x, same = differentiator(100.0), np.eye(6)
    plain = quasi_newton(ExactValue(problem), x, Metric(same, same), steps=1000, tolerance=1e-7)
    assert np.exp(plain.value) > 1.02 * REACHED
    assert direct_polish(problem, Start(0, x), DescentOptions(), 0.3).soft < REACHED


def test_restarts_never_raise_the_value_and_repeat_their_bits(problem: Problem) -> None:
    x = differentiator(1000.0)
    first, second = (direct_restarts(problem, Start(4, x), DescentOptions(), 0.3) for _ in range(2))
    np.testing.assert_array_equal(first.x, second.x)
    again = direct_restarts(problem, Start(5, first.x), DescentOptions(), 0.3)
    assert again.soft <= first.soft
