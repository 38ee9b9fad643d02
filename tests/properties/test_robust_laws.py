"""Laws of norms, loops and tuning on random systems."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit.analysis.frequency_response import direct_response
from lftkit.analysis.norms import h2_norm, hinf_norm, spectral_abscissa
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.delay import pade_delay
from lftkit.systems.system import System
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain
from lftkit.tuning.structures.structures import controller, state_space

SEEDS = st.integers(0, 10_000)


def random_system(seed: int, n: int, m: int, p: int, feedthrough: bool = True) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-3, 0)) * np.eye(n)
    D = rng.normal(size=(p, m)) * feedthrough
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), D


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.integers(1, 7))
def test_norms_in_other_units_of_time(seed: int, n: int) -> None:
    """Other laws of the norm are in ``tests/unit/lftkit/analysis/test_norm_laws.py``."""
    A, B, C, D = random_system(seed, n, 2, 2, feedthrough=False)
    first, faster = hinf_norm(A, B, C, D), hinf_norm(100 * A, 100 * B, C, D)
    assert abs(faster.value - first.value) <= 1e-6 * first.value
    assert abs(h2_norm(100 * A, 100 * B, C, D) - 10 * h2_norm(A, B, C, D)) <= 1e-8 * h2_norm(A, B, C, D) * 10


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.integers(1, 4), st.integers(0, 3))
def test_closed_loop_is_the_fractional_transformation(seed: int, n: int, order: int) -> None:
    """close_loop against P11 + P12 K (I - P22 K)^-1 P21 at a few frequencies, and LoopGains against both."""
    A, B, C, D = random_system(seed, n, 4, 5)
    plant = System(A, B, C, 0.3 * D, [("w", 2), ("u", 2)], [("z", 3), ("y", 2)])
    structure = state_space([("y", 2)], [("u", 2)], order)
    K = controller(structure, 0.2 * structure.start(np.random.default_rng(seed)))
    loop = close_loop(plant, K, ["w"], ["z"])
    for w in (0.0, 0.3, 2.0):
        P, Kw = direct_response(*plant.matrices, w), direct_response(*K.matrices, w)
        inner = np.linalg.solve(np.eye(2) - P[3:, 2:] @ Kw, P[3:, :2])
        expected = P[:3, :2] + P[:3, 2:] @ Kw @ inner
        assert np.abs(direct_response(*loop.matrices, w) - expected).max() <= 1e-8 * (1 + np.abs(expected).max())


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.integers(2, 6), st.integers(0, 3))
def test_tuning_values_are_the_norms_of_the_assembled_loop(seed: int, n: int, order: int) -> None:
    A, B, C, D = random_system(seed, n, 4, 5)
    D[:, :2] = 0.0
    plant = System(A, B, C, 0.2 * D, [("w", 2), ("u", 2)], [("z", 3), ("y", 2)])
    structure = state_space([("y", 2)], [("u", 2)], order)
    x = 0.05 * structure.start(np.random.default_rng(seed))
    K = structure.gain_matrix(x)
    K[:order, :order] -= np.eye(order)
    x = structure.parameters_of(
        System(K[:order, :order], K[:order, order:], K[order:, :order], K[order:, order:], [("y", 2)], [("u", 2)])
    )
    problem = Problem([plant], [HinfGain("w", "z"), H2Gain("w", "z")], structure)
    found = problem.evaluate(x)
    loop = close_loop(plant, controller(structure, x), ["w"], ["z"])
    if spectral_abscissa(loop.A) >= 0:
        assert np.isinf(found.values).all()
        return
    norm = hinf_norm(*loop.matrices, rtol=1e-8)
    assert abs(found.values[0, 0] - norm.value) <= 1e-6 * norm.value
    expected = h2_norm(loop.A, loop.B, loop.C, np.zeros_like(loop.D))
    assert abs(found.values[1, 0] - expected) <= 1e-8 * expected


@settings(max_examples=8, deadline=None)
@given(st.floats(1e-4, 10.0), st.integers(2, 8))
def test_pade_is_all_pass_and_early_it_is_the_delay(delay: float, order: int) -> None:
    model = pade_delay(delay, order)
    for turn in (0.1, 0.5, 1.0, 5.0):
        response = direct_response(*model.matrices, turn / delay).item()
        assert abs(abs(response) - 1.0) <= 1e-8
        if turn <= 1.0 and order >= 3:
            assert abs(response - np.exp(-1j * turn)) <= 1e-4
    assert spectral_abscissa(model.A) < 0
