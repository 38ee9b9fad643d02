"""Structures of the user: one whose parameters are logarithms, and a spring of the plant beside the law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import Port, System
from lftkit.analysis.norms import hinf_norm
from lftkit.tuning import Decentralised, HinfGain, TuningOptions, gain, tune


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
