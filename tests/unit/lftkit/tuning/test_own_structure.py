"""A structure of the user whose parameters are logarithms: gains of any size within small parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import Port, System
from lftkit.tuning import HinfGain, TuningOptions, tune


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
@pytest.mark.parametrize("seed", range(4))
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
