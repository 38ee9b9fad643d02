"""Gradient sampling of the tuner's benchmark is a fair rival: it minimises where a gradient method stops."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from support.scripts import script

sampling = script(Path(__file__).parents[3] / "benchmarks" / "gradient_sampling.py")


def test_the_shortest_combination_of_gradients() -> None:
    """The foot of the perpendicular on a segment, zero inside of a hull, a vertex."""
    assert sampling.shortest_combination(np.array([[1.0, 1.0], [1.0, -1.0], [3.0, 0.0]])) == pytest.approx([1.0, 0.0])
    assert sampling.shortest_combination(np.array([[2.0, 0.0], [-1.0, 0.0]])) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert sampling.shortest_combination(np.array([[1e6, 0.0], [2e6, 1e6]])) == pytest.approx([1e6, 0.0])


def test_a_curved_valley_with_a_kink_is_followed_to_its_end() -> None:
    """|x| + 10 |y - x^2| from (1, 2)."""

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        side = 10.0 * np.sign(x[1] - x[0] ** 2)
        value = abs(x[0]) + 10.0 * abs(x[1] - x[0] ** 2)
        return float(value), np.array([np.sign(x[0]) - 2.0 * x[0] * side, side])

    found = sampling.by_sampling(function, np.array([1.0, 2.0]), time.monotonic() + 3600.0)
    assert function(found)[0] < 1e-5
