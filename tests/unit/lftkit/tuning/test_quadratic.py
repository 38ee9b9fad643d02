"""The quadratic program on the simplex against its optimality conditions, and the descent on known functions."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.tuning.descent.bundle_method import minimise
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.minimax.simplex_qp import simplex_minimum
from lftkit.tuning.pieces import HARD_TARGET, OracleResult, Piece


@pytest.mark.parametrize(("pieces", "size"), [(2, 1), (5, 3), (50, 10), (100, 150)])
def test_primal_and_dual_values_agree(pieces: int, size: int) -> None:
    rng = np.random.default_rng(pieces)
    G, a = rng.normal(size=(pieces, size)), -0.1 * rng.uniform(size=pieces)
    lam, value = simplex_minimum(G @ G.T, a)
    d = -G.T @ lam
    primal = (a + G @ d).max() + 0.5 * d @ d
    assert lam.min() >= 0 and lam.sum() == pytest.approx(1.0, abs=1e-12)
    assert primal == pytest.approx(-value, abs=1e-8)


def piece(value: float, gradient: list[float], number: int, hard: bool = False) -> Piece:
    return Piece(value, np.array(gradient), hard, number, 0, 0.0)


def rosenbrock(x: np.ndarray) -> OracleResult:
    """8 |x1^2 - x2| + (1 - x1)^2 (Lewis and Overton 2013): minimum 0 at (1, 1), on a curved kink."""
    r, s = x[0] ** 2 - x[1], (1 - x[0]) ** 2
    pieces = [
        piece(8 * sign * r + s, [16 * sign * x[0] - 2 * (1 - x[0]), -8 * sign], k) for k, sign in enumerate((1, -1))
    ]
    return OracleResult(max(p.value for p in pieces), -np.inf, tuple(pieces))


def constrained(x: np.ndarray) -> OracleResult:
    """The same with sqrt(2) |x1| <= 1 and 2 x2 <= 1 (Curtis, Mitchell and Overton 2017): 0.08578643762690495."""
    free = rosenbrock(x)
    root = np.sqrt(2.0)
    hard = [piece(root * abs(x[0]), [root * np.sign(x[0]), 0.0], 5, True), piece(2 * x[1], [0.0, 2.0], 6, True)]
    return OracleResult(free.objective, max(p.value for p in hard) - HARD_TARGET, (*free.pieces, *hard))


def test_descends_a_curved_kink() -> None:
    found = minimise(rosenbrock, np.array([-1.0, 1.5]), DescentOptions(), np.random.default_rng(0))
    assert found.x == pytest.approx([1.0, 1.0], abs=1e-3)
    assert found.result.objective < 1e-5


@pytest.mark.parametrize("start", [[-1.0, 1.5], [0.1, 0.1], [3.0, 3.0]])
def test_constrained_minimum_from_infeasible_and_feasible_starts(start: list[float]) -> None:
    found = minimise(constrained, np.array(start), DescentOptions(), np.random.default_rng(0))
    assert found.result.constraint <= 1e-7
    assert found.result.objective == pytest.approx((1 - HARD_TARGET * np.sqrt(0.5)) ** 2, abs=1e-6)


def test_largest_of_many_squares() -> None:
    def maxq(x: np.ndarray) -> OracleResult:
        eye = np.eye(len(x))
        pieces = tuple(piece(x[i] ** 2, list(2 * x[i] * eye[i]), i) for i in range(len(x)))
        return OracleResult(max(p.value for p in pieces), -np.inf, pieces)

    found = minimise(maxq, np.arange(1.0, 21.0), DescentOptions(), np.random.default_rng(0))
    assert found.result.objective < 1e-6


@pytest.mark.parametrize("scale", [1.0, 1e9, 1e300])
def test_slopes_of_any_sizes_overflow_nothing(scale: float) -> None:
    """One slope is zero and the others are steep; RuntimeWarnings of lftkit are errors in the tests."""
    H = np.diag([0.0, scale, 2.0 * scale])
    weights, value = simplex_minimum(H, np.zeros(3))
    assert np.all(np.isfinite(weights)) and weights[0] == pytest.approx(1.0, abs=1e-4)
    assert value == pytest.approx(0.0, abs=1e-6 * scale)
