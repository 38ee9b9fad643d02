"""Laws of tuning on random small plants with undamped modes, integrators and unstable poles."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit.systems.system import System
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.structures.structures import state_space
from lftkit.tuning.tuner import tune

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
