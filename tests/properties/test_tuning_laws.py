"""Laws of norms, loops and tuning on random systems, also with undamped modes, integrators and unstable poles."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit.analysis.frequency_response import direct_response
from lftkit.analysis.norms import h2_norm, hinf_norm, spectral_abscissa
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.delay import pade_delay
from lftkit.systems.system import System
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain
from lftkit.tuning.structures.structures import controller, state_space
from lftkit.tuning.tuner import tune

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


BLOCKS = {
    "undamped mode": lambda w: np.array([[0.0, w], [-w, 0.0]]),
    "double integrator": lambda w: np.array([[0.0, 1.0], [0.0, 0.0]]),
    "integrator": lambda w: np.zeros((1, 1)),
    "unstable pole": lambda w: np.array([[w]]),
    "lightly damped mode": lambda w: np.array([[0.0, w], [-w, -1e-5 * w]]),
    "unstable mode": lambda w: np.array([[0.1 * w, w], [-w, 0.1 * w]]),
    "lag": lambda w: np.array([[-w]]),
}


def plant(seed: int, kinds: list[str], feedthrough: bool) -> System:
    rng = np.random.default_rng(seed)
    A = sl.block_diag(*(BLOCKS[kind](10.0 ** rng.uniform(-1, 1)) for kind in kinds))
    n = len(A)
    D = np.zeros((4, 3))
    D[2:, :1] = 0.1 * rng.normal(size=(2, 1))
    D[1, 1:] = rng.normal(size=2)
    D[0, 0] = rng.normal() * feedthrough
    return System(A, rng.normal(size=(n, 3)), rng.normal(size=(4, n)), D, [("w", 1), ("u", 2)], [("z", 2), ("y", 2)])


PLANTS = (
    st.integers(0, 10_000),
    st.lists(st.sampled_from(sorted(BLOCKS)), min_size=1, max_size=3),
    st.integers(0, 1),
    st.booleans(),
)


def check_tuning(seed: int, kinds: list[str], order: int, feedthrough: bool, target: float = -np.inf) -> None:
    system = plant(seed, kinds, feedthrough)
    structure = state_space([("y", 2)], [("u", 2)], order)
    options = TuningOptions(starts=1, seed=seed, iterations=12, target=target)
    result = tune([system], [HinfGain("w", "z")], structure, options=options)
    if result.certificate is None:
        assert result.soft == np.inf and result.status in ("not_stabilised", "out_of_time")
        return
    assert result.certificate.stable
    if result.status == "converged":
        assert result.certificate.values.max() >= result.soft * (1 - 1e-3)
        assert result.certificate.upper.max() <= result.soft * (1 + 1e-3)


def test_a_start_with_a_pole_of_the_loop_at_a_frequency_of_the_grid() -> None:
    check_tuning(8158, ["unstable pole", "integrator"], 1, False, target=1e6)


@pytest.mark.slow
@settings(max_examples=30)
@given(*PLANTS)
def test_no_exception_on_many_plants(seed: int, kinds: list[str], order: int, feedthrough: bool) -> None:
    check_tuning(seed, kinds, order, feedthrough)
