"""Balanced truncation: the error is within its bound, and what cannot be truncated is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from lftkit.analysis.norms import hinf_norm
from lftkit.reduction.balancing import balanced_truncation
from lftkit.systems.system import System

ORDER = 6


def stable(seed: int) -> System:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((ORDER, ORDER))
    A -= (linalg.eigvals(A).real.max() + 0.5) * np.eye(ORDER)
    B, C, D = rng.standard_normal((ORDER, 2)), rng.standard_normal((3, ORDER)), rng.standard_normal((3, 2))
    return System(A, B, C, D, [("u", 2)], [("y", 3)], "stable")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", range(ORDER + 1))
def test_the_error_is_at_most_twice_the_sum_of_what_is_left_out(seed: int, order: int) -> None:
    given = stable(seed)
    P = linalg.solve_continuous_lyapunov(given.A, -given.B @ given.B.T)
    Q = linalg.solve_continuous_lyapunov(given.A.T, -given.C.T @ given.C)
    hankel = np.sort(np.sqrt(np.abs(linalg.eigvals(P @ Q))))[::-1]
    found = balanced_truncation(given, order)
    assert found.order == order and np.array_equal(found.D, given.D)
    if order:
        assert linalg.eigvals(found.A).real.max() < 0.0
    n = ORDER + order
    A = linalg.block_diag(given.A, found.A).reshape(n, n)
    error = A, np.vstack([given.B, found.B]), np.hstack([given.C, -found.C]), np.zeros((3, 2))
    assert hinf_norm(*error).value <= 2.0 * hankel[order:].sum() + 1e-9 * hankel[0]


def test_what_cannot_be_truncated_is_refused() -> None:
    given = stable(0)
    with pytest.raises(ValueError, match="order must be between 0 and 6, got 7"):
        balanced_truncation(given, 7)
    with pytest.raises(ValueError, match="must be stable with 2 states"):
        balanced_truncation(System(np.eye(6), given.B, given.C, given.D, [("u", 2)], [("y", 3)]), 2)
    blind = System(given.A, given.B, np.zeros((3, 6)), given.D, [("u", 2)], [("y", 3)])
    with pytest.raises(ValueError, match="reached and seen"):
        balanced_truncation(blind, 1)
