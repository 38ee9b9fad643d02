"""Solutions of the Riccati equation: they stabilise, also where nothing drives it, or there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit.analysis.riccati import discrete_riccati, riccati, stein
from lftkit.proofs import full_block, mu


def test_the_solution_solves_and_stabilises() -> None:
    rng = np.random.default_rng(0)
    A, B, Q, R = rng.standard_normal((4, 4)), rng.standard_normal((4, 2)), np.eye(4), 2.0 * np.eye(2)
    X = riccati(A, B, Q, R)
    assert X is not None
    F = -linalg.solve(R, B.T @ X)
    assert np.abs(A.T @ X + X @ A + Q - F.T @ R @ F).max() < 1e-9 * np.abs(X).max()
    assert linalg.eigvals(A + B @ F).real.max() < 0.0


def test_an_equation_whose_eigenvalues_are_not_reordered_is_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solver of LAPACK fails so on single equations, which ones depends on rounding."""
    solve = linalg.solve_continuous_are

    def failing(*matrices: Any, balanced: bool = True, **further: Any) -> Any:
        if balanced:
            raise ValueError("Reordering of (A, B) failed")
        return solve(*matrices, balanced=balanced, **further)

    one = np.eye(2)
    monkeypatch.setattr(linalg, "solve_continuous_are", failing)
    X = riccati(one, one, 0.0 * one, one)
    assert X is not None and np.allclose(X, 2.0 * one)


def test_without_weight_a_stable_system_is_left_alone_and_an_unstable_one_is_mirrored() -> None:
    """x' = x + u with a weight on u alone: X = 2, and the pole goes to -1."""
    one = np.eye(2)
    X = riccati(-one, one, 0.0 * one, one)
    assert X is not None and not X.any()
    X = riccati(one, one, 0.0 * one, one)
    assert X is not None and np.allclose(X, 2.0 * one)


def test_a_mode_on_the_axis_that_nothing_moves_has_none() -> None:
    zero = np.zeros((1, 1))
    assert riccati(zero, zero, np.eye(1), np.eye(1)) is None


def test_bounds_of_mu_where_a_block_is_not_reached() -> None:
    """A block whose signals are zero leaves the norm of the other one."""
    M = np.zeros((4, 5))
    M[2:, 3:] = [[3.0, 0.0], [0.0, 1.0]]
    found = mu(M, [full_block(3, 2), full_block(2)])
    assert abs(found.lower - 3.0) < 1e-6 and 3.0 <= found.upper < 3.001


@pytest.mark.parametrize("slowest", [0.5, 1.0 - 1e-7])
def test_the_discrete_equations_are_solved_with_slow_modes(slowest: float) -> None:
    """By their residuals, and by scipy where its solution has the precision."""
    rng = np.random.default_rng(5)
    A = np.diag([slowest, 0.9, -0.3]) + np.triu(0.1 * rng.normal(size=(3, 3)), 1)
    B, C = rng.normal(size=(3, 1)), rng.normal(size=(2, 3))
    X, P = discrete_riccati(A, B @ B.T, C.T @ C), stein(A, B @ B.T)
    solution = A.T @ X @ linalg.solve(np.eye(3) + B @ B.T @ X, A) + C.T @ C
    assert np.abs(X - solution).max() < 1e-12 * np.abs(X).max()
    assert np.abs(A @ P @ A.T + B @ B.T - P).max() < 1e-12 * np.abs(P).max()
    assert np.allclose(X, linalg.solve_discrete_are(A, B, C.T @ C, np.eye(1)), rtol=1e-8)


def test_digits_that_the_doubling_loses_are_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here by too few doublings."""
    monkeypatch.setattr("lftkit.analysis.riccati.DOUBLINGS", 4)
    rng = np.random.default_rng(5)
    A, B, C = np.diag([0.97, 0.9, -0.3]), rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    X = discrete_riccati(A, B @ B.T, C.T @ C)
    assert np.allclose(X, linalg.solve_discrete_are(A, B, C.T @ C, np.eye(3)), rtol=1e-9)


def test_a_discrete_equation_without_a_solution_is_not_solved() -> None:
    with pytest.raises(ArithmeticError, match="no bounded solution"):
        discrete_riccati(np.array([[2.0]]), np.zeros((1, 1)), np.ones((1, 1)))
    with pytest.raises(ArithmeticError, match="no bounded solution"):
        stein(np.array([[2.0]]), np.ones((1, 1)))


@pytest.mark.parametrize("zeta", [0.1, 0.3, 0.5])
def test_there_is_no_solution_just_below_the_norm_of_an_oscillator(zeta: float) -> None:
    """The bounded real lemma: one exactly above ``1 / (2 zeta sqrt(1 - zeta^2))``; once also 1e-7 below it."""
    A, B, Q = np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]]), np.array([[0.0], [1.0]]), np.diag([1.0, 0.0])
    norm = 0.5 / (zeta * np.sqrt(1.0 - zeta**2))
    above = [riccati(A, B, Q, np.array([[-((part * norm) ** 2)]])) for part in (1.0 + 1e-6, 1.0 - 1e-7, 1.0 - 1e-6)]
    assert [one is not None for one in above] == [True, False, False]
