"""What the tuner prepares for plants of many states: few eigenvalue problems, and each once."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, state_space
from lftkit.tuning.gains import plant_responses
from lftkit.tuning.gains.prefeedback import prefeedback
from lftkit.tuning.nested_orders import lower_order
from lftkit.tuning.problem import Problem


def chain(masses: int) -> System:
    """Free chain of equal masses and springs without dampers: force and rate at one end, disturbance at the other."""
    stiffness = 2.0 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    stiffness[0, 0] = stiffness[-1, -1] = 1.0
    A = np.block([[np.zeros((masses, masses)), np.eye(masses)], [-stiffness, np.zeros((masses, masses))]])
    B = np.zeros((2 * masses, 2))
    B[-1, 0], B[masses, 1] = 1.0, 1.0
    C = np.zeros((2, 2 * masses))
    C[0, 0] = C[1, masses] = 1.0
    return System(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Eigenvalue problems that were solved."""
    counts: Counter[str] = Counter()

    def counted(name: str, function: Any) -> Any:
        def called(*arguments: Any, **named: Any) -> Any:
            counts[name] += 1
            return function(*arguments, **named)

        return called

    for name in ("eig", "eigvals"):
        monkeypatch.setattr(linalg, name, counted(name, getattr(linalg, name)))
    return counts


def test_feedback_before_the_tuning_takes_few_eigenvalue_problems(calls: Counter[str]) -> None:
    plant = chain(60)
    F = prefeedback(plant.A, plant.B[:, 1:], plant.C[1:], plant.D[1:, 1:])
    assert calls.total() < 20
    damped = linalg.eigvals(plant.A + plant.B[:, 1:] @ F @ plant.C[1:])
    rigid = np.abs(damped) < 1e-6  # the position, which the rate does not show
    assert np.count_nonzero(rigid) == 1
    assert np.abs(damped[~rigid].real).min() > 1e-6, "every pole is off the imaginary axis"


def test_responses_of_the_plant_are_made_once_for_all_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    original = plant_responses.prefeedback

    def counted(*given: Any) -> Any:
        made.append(1)
        return original(*given)

    monkeypatch.setattr(plant_responses, "prefeedback", counted)
    plant = chain(3)
    structure = state_space([("y", 1)], [("u", 1)], 2)
    problem = Problem([plant], [HinfGain("w", "z")], structure)
    lower = lower_order(structure)
    assert lower is not None
    smaller = problem.with_structure(lower)
    assert made == [1]
    x = -0.3 * np.ones(lower.size)
    alone = Problem([plant], [HinfGain("w", "z")], lower)
    assert smaller.evaluate(x).values.tolist() == alone.evaluate(x).values.tolist()
    problem.gains[0].add(np.array([0.123]))
    assert 0.123 not in smaller.gains[0].grid.omega
