"""A spring of the plant is tuned with the controller: a static gain from its stretch to its force, beside the law."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.analysis.norms import hinf_norm
from lftkit.systems.system import System
from lftkit.tuning import Decentralised, HinfGain, TuningOptions, gain, tune

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
