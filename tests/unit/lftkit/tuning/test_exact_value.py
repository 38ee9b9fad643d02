"""Exact largest value of small problems, starts from full-order controllers, and the stacks of small matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lftkit.analysis.batched_linalg import (
    determinants,
    largest_gains,
    leading_pairs,
    smooth_gains,
    smooth_slopes,
    solve,
)
from lftkit.systems.connection.filters import transfer
from lftkit.systems.system import System
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.full_order import reduced_starts
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import PLANTS
from lftkit.tuning.requirements import H2Gain, HinfGain
from lftkit.tuning.structures.structures import state_space
from lftkit.tuning.tuner import tune

U, Y = ("u", 2), ("y", 3)


def plant(seed: int, through: float = 0.0) -> System:
    """Stable plant of five states; `through` scales the direct path from the command to the measurement."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(5)
    D = 0.1 * rng.standard_normal((5, 4))
    D[2:, 2:] *= through
    return System(
        A, rng.standard_normal((5, 4)), rng.standard_normal((5, 5)), D, [("w", 2), U], [("z", 2), Y], f"plant {seed}"
    )


def complex_stack(*shape: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("through", [0.0, 1.0])
def test_value_is_the_largest_norm_and_the_gradient_its_derivative(through: float) -> None:
    needs = [HinfGain("w", "z", weight_out=transfer([1, 2], [1, 5], 2)), HinfGain("w", "y", bound=2.0)]
    structure = state_space([Y], [U], 1)
    problem = Problem([plant(0, through), plant(1, through)], needs, structure)
    x = 0.05 * np.random.default_rng(2).standard_normal(structure.size)
    x[0] = -1.0
    assert ExactValue.suits(problem) and problem.abscissa(x) < 0.0
    value, gradient = ExactValue(problem)(x)
    assert np.exp(value) == pytest.approx(problem.evaluate(x, gradients=False).values.max(), rel=1e-6)
    f = ExactValue(problem)
    differences = [(f(x + h)[0] - f(x - h)[0]) / 2e-6 for h in 1e-6 * np.eye(len(x))]
    assert gradient == pytest.approx(np.array(differences), abs=1e-6 * float(np.linalg.norm(gradient)) + 1e-8)


@pytest.mark.parametrize("name", ["AC3", "AC8", "HE1", "NN4", "NN17"])
def test_value_is_the_certified_norm_on_published_plants(name: str) -> None:
    model = PLANTS[name]()
    structure = state_space([model.outputs[1]], [model.inputs[1]], 2)
    problem = Problem([model], [HinfGain("w", "z")], structure)
    starts = [x for x in reduced_starts(problem) if problem.abscissa(x) < -1e-3]
    checked = 0
    for start in starts:
        for scale in (1.0, 0.99, 1.01):
            value, _ = ExactValue(problem)(scale * start)
            if np.isfinite(value):
                found = problem.evaluate(scale * start, gradients=False).values.max()
                assert np.exp(value) == pytest.approx(found, rel=1e-5)
                checked += 1
    x = np.zeros(structure.size)
    unstable = problem.abscissa(x) >= 0.0
    assert np.isfinite(ExactValue(problem)(x)[0]) is not unstable
    assert checked or unstable or not starts


@pytest.mark.parametrize("form", ["full", "modal", "tridiagonal"])
def test_full_order_controllers_stabilise_and_one_is_nearly_optimal(form: str) -> None:
    """With as many states as the plant nothing is reduced: the H-infinity one is near the optimum of AC4, 0.557291."""
    model = PLANTS["AC4"]()
    problem = Problem(
        [model], [HinfGain("w", "z")], state_space([model.outputs[1]], [model.inputs[1]], model.order, form=form)
    )
    found = reduced_starts(problem)
    assert found and all(problem.abscissa(x) < 0.0 for x in found)
    values = [problem.evaluate(x, gradients=False).values.max() for x in found]
    assert 0.557291 * (1 - 1e-6) <= min(values) <= 1.3 * 0.557291


def test_the_lqg_start_has_the_least_h2_norm() -> None:
    model = plant(0)
    D = model.D.copy()
    D[:2, :2] = 0.0
    model = replace(model, D=D)
    structure = state_space([Y], [U], model.order, feedthrough=False)
    problem = Problem([model], [H2Gain("w", "z")], structure)
    lqg = reduced_starts(problem)[0]
    best = problem.evaluate(lqg, gradients=False).values.max()
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = lqg * (1.0 + 0.1 * rng.standard_normal(len(lqg)))
        assert problem.evaluate(other, gradients=False).values.max() >= best * (1.0 - 1e-5)


@pytest.mark.slow
def test_many_starts_of_a_small_problem_give_the_same_bits_in_two_processes() -> None:
    model = PLANTS["AC17"]()
    structure = state_space([model.outputs[1]], [model.inputs[1]], 0)
    results = [
        tune([model], [HinfGain("w", "z")], structure, options=TuningOptions(starts=7, workers=workers))
        for workers in (1, 2)
    ]
    assert results[0].x.tobytes() == results[1].x.tobytes() and results[0].starts == results[1].starts
    assert str(results[0].status) == "converged"


def test_solutions_determinants_and_vectors_of_two_by_two_matrices() -> None:
    M, X, T = complex_stack(9, 2, 2), complex_stack(9, 2, 5), complex_stack(9, 2, 4)
    T[0, 1] = 0.0
    T[1] = 0.0
    T[2] = np.eye(2, 4)
    assert solve(M, X) == pytest.approx(np.linalg.solve(M, X), rel=1e-10)
    assert determinants(M) == pytest.approx(np.linalg.det(M), rel=1e-12)
    for wide in (T, T.conj().swapaxes(1, 2)):
        s, left, right = leading_pairs(wide)
        assert s == pytest.approx(np.linalg.svd(wide, compute_uv=False), rel=1e-12, abs=1e-7)
        assert wide @ right == pytest.approx(left * s[:, None, :], abs=1e-7)


@pytest.mark.parametrize("shape", [(3, 5), (6, 4)])
@pytest.mark.parametrize("power", [2.0, 40.0, 600.0])
def test_smooth_gains_bound_the_largest_and_have_the_stated_slopes(shape: tuple[int, int], power: float) -> None:
    T, step = complex_stack(4, *shape), complex_stack(4, *shape)[::-1]
    gains = smooth_gains(T, power)
    assert np.all(gains >= largest_gains(T) * (1 - 1e-12))
    assert np.all(gains <= largest_gains(T) * min(shape) ** (1.0 / power) * (1 + 1e-12))
    slope = (smooth_gains(T + 1e-6 * step, power) - smooth_gains(T - 1e-6 * step, power)) / 2e-6
    assert np.real(np.sum(smooth_slopes(T, power).conj() * step, axis=(1, 2))) == pytest.approx(slope, rel=1e-6)
