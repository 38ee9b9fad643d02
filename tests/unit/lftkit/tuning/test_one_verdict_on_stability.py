"""All phases of a start judge stability alike, and a start whose arithmetic fails does not end the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.slow_cases import slow
from support.tuned_plants import STATIC, lag, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import DescentOptions, HinfGain, TuningOptions, tune
from lftkit.tuning.descent.single_start import screen, tune_from
from lftkit.tuning.problem import Problem

LIMITS = DescentOptions(iterations=5)
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
    for result in (screen(problem, x, 0, LIMITS), tune_from(problem, x, 0, LIMITS, 0.3)):
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
