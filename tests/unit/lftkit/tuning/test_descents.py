"""Descents on known functions, from points that meet, violate or touch a limit; one verdict on stability."""

from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import pytest
from scipy import linalg, optimize
from support.slow_cases import slow
from support.tuned_plants import STATIC, lag, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import DescentOptions, DescentState, HinfGain, TuningOptions, descend, tune
from lftkit.tuning.descent.bundle_method import minimise
from lftkit.tuning.descent.grid_source import GridSource
from lftkit.tuning.descent.minimax.minimax import lower_point
from lftkit.tuning.descent.minimax.simplex_qp import simplex_minimum
from lftkit.tuning.descent.single_start import screen, tune_from
from lftkit.tuning.pieces import HARD_TARGET, OracleResult, Piece
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain
from lftkit.tuning.structures.structures import state_space


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


FEW_ITERATIONS = DescentOptions(iterations=5)
STATES = 160
"""Of a plant: above some hundred, eigenvalues alone and those with eigenvectors differ by rounding."""
SEEDS = [0, *(slow(seed) for seed in (1, 2, 3))]


def modes(seed: int) -> System:
    """Light modes in random coordinates, one force and one rate."""
    rng = np.random.default_rng(seed)
    A = linalg.block_diag(*([[0.0, w], [-w, -0.01 * w]] for w in np.geomspace(0.5, 300.0, STATES // 2)))
    Q: Any = linalg.qr(rng.standard_normal((STATES, STATES)))[0]
    b = rng.standard_normal((STATES, 1))
    B, C = Q.T @ np.hstack([b, b]), np.vstack([b.T, np.zeros((1, STATES)), b.T]) @ Q
    D = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    return tuned_plant(Q.T @ A @ Q, B, C, D)


def problem_at_the_limit(seed: int) -> tuple[Problem, np.ndarray]:
    """A problem and a controller: the limit is between the abscissae of the two ways to compute eigenvalues."""
    structure, x = STATIC, np.array([-1e-3])
    needs = [HinfGain("w", "z"), HinfGain("w", "effort", bound=50.0, hard=True)]
    plant = modes(seed)
    A: Any = Problem([plant], needs, structure).closed(0, structure.gain_matrix(x)).A
    with_vectors: Any = linalg.eig(A, left=True, right=True, check_finite=False)[0]
    limits = [values.real.max() for values in (linalg.eigvals(A, check_finite=False), with_vectors)]
    return Problem([plant], needs, structure, min_decay=-0.5 * float(sum(limits))), x


@pytest.mark.parametrize("seed", SEEDS)
def test_every_way_to_the_poles_has_the_same_abscissa(seed: int) -> None:
    """Of loops at the limit, of others, and of those beyond the limit of the gains; bit for bit."""
    problem, x = problem_at_the_limit(seed)
    problem.limit = 1e8
    for k in (x, -x, 1e3 * x, np.full(1, 1e9)):
        abscissa = problem.abscissa(k)
        slopes, plain = problem.evaluate(k), problem.evaluate(k, gradients=False)
        assert abscissa == problem.stability_pieces(k, 1.0)[0] == slopes.abscissa == plain.abscissa
        assert problem.stable(k) == bool(plain.poles) == bool(slopes.poles)
        assert all(margin < 0.0 for margin, _ in slopes.barriers)


@pytest.mark.further
@pytest.mark.parametrize("seed", SEEDS)
def test_a_start_at_the_limit_has_a_result(seed: int) -> None:
    """Where rounding decides, a start is stabilised or it is not; both are results."""
    problem, x = problem_at_the_limit(seed)
    for result in (screen(problem, x, 0, FEW_ITERATIONS), tune_from(problem, x, 0, FEW_ITERATIONS, 0.3)):
        assert not result.failure
        assert problem.stable(result.x) == bool(np.isfinite(result.soft))
        assert np.isfinite(result.soft) or result.status == "not_stabilised"


class Failing:
    """Gain whose computation fails for positive values."""

    inputs, outputs, order, size = STATIC.inputs, STATIC.outputs, 0, 1

    def __init__(self, error: type[Exception]) -> None:
        self._error = error

    def gain_matrix(self, x: np.ndarray) -> np.ndarray:
        if x[0] > 0.0:
            raise self._error("out of range")
        return x.reshape(1, 1)

    def pullback(self, x: np.ndarray, G: np.ndarray) -> np.ndarray:
        return G.ravel()

    def start(self, rng: np.random.Generator) -> np.ndarray:
        return -np.abs(rng.standard_normal(1))


NEEDS = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)]


@pytest.mark.parametrize(("error", "workers"), [(FloatingPointError, 1), slow(linalg.LinAlgError, 2)])
def test_a_start_whose_arithmetic_fails_is_counted_and_the_others_go_on(error: type[Exception], workers: int) -> None:
    structure: Any = Failing(error)
    options = TuningOptions(starts=0, workers=workers)
    result = tune([lag()], NEEDS, structure, initial=[[1.0], [-0.5]], options=options)
    assert result.soft == pytest.approx(0.2, rel=1e-3) and result.starts[0] == np.inf
    assert "1 of 2 starts failed" in result.advice and "out of range" in result.advice


@pytest.mark.parametrize("error", [TypeError, KeyError])
def test_mistakes_of_the_program_are_not_taken_for_arithmetic(error: type[Exception]) -> None:
    structure: Any = Failing(error)
    with pytest.raises(error):
        tune([lag()], NEEDS, structure, initial=[[1.0], [-0.5]], options=TuningOptions(starts=0))
