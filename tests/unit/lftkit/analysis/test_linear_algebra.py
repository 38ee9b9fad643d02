"""Riccati and Lyapunov equations, products in twice the precision, closing over Delta, against exact arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from lftkit.analysis.compensated import fine_product, matrix_product, two_product, two_sum
from lftkit.analysis.eigenvectors import complex_columns, complex_rows, corrected_modes, modes
from lftkit.analysis.lft_response import LftResponse, feedback
from lftkit.analysis.riccati import RiccatiSettings, discrete_riccati, riccati, stein
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


def test_digits_that_the_doubling_loses_are_restored() -> None:
    """Here by too few doublings."""
    rng = np.random.default_rng(5)
    A, B, C = np.diag([0.97, 0.9, -0.3]), rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    X = discrete_riccati(A, B @ B.T, C.T @ C, RiccatiSettings(doublings=4))
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


NUMBERS = st.floats(-1e50, 1e50).filter(lambda x: x == 0.0 or abs(x) > 1e-50)


@given(NUMBERS, NUMBERS)
def test_rounding_errors_of_sums_and_products_are_exact(a: float, b: float) -> None:
    x, y = np.array([a]), np.array([b])
    total, error = two_sum(x, y)
    assert Fraction(total.item()) + Fraction(error.item()) == Fraction(a) + Fraction(b)
    product, error = two_product(x, y)
    assert product.item() == a * b
    assert Fraction(product.item()) + Fraction(error.item()) == Fraction(a) * Fraction(b)


@pytest.mark.parametrize("k", [1, 2, 7, 300])
def test_products_have_seven_and_fourteen_digits_more(k: int) -> None:
    rng = np.random.default_rng(k)
    A, X = rng.normal(size=(3, k)), rng.normal(size=(k, 2))
    high, low = matrix_product(A, X)
    for i in range(3):
        for j in range(2):
            exact = sum((Fraction(a) * Fraction(x) for a, x in zip(A[i].tolist(), X[:, j].tolist())), Fraction(0))
            error = abs(Fraction(high[i, j].item()) + Fraction(low[i, j].item()) - exact)
            assert error <= Fraction(k * 2.0**-70 * np.abs(A[i]).max() * np.abs(X[:, j]).max())
            parts, rest = fine_product(A, X)
            found = sum((Fraction(part[i, j].item()) for part in (*parts, rest)), Fraction(0))
            assert abs(found - exact) <= Fraction(k * 2.0**-92 * np.abs(A[i]).max() * np.abs(X[:, j]).max())


def spread(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs and real poles from 2^-6 to 2^13 rad/s in coordinates that mix them, without any rounding; the poles."""
    rng = np.random.default_rng(0)
    A, poles = np.zeros((3 * n, 3 * n)), []
    for i, w in enumerate(2.0 ** np.linspace(-6, 13, n).round()):
        A[3 * i : 3 * i + 2, 3 * i : 3 * i + 2] = [[-w / 1024, w], [-w, -w / 1024]]
        A[3 * i + 2, 3 * i + 2] = -1.25 * w
        poles += [w * (-1 / 1024 + 1j), w * (-1 / 1024 - 1j), -1.25 * w]
    lower = np.eye(3 * n)
    lower[:, 0] = 1.0
    upper = np.eye(3 * n)
    upper[-1] = rng.integers(-1, 2, 3 * n)
    upper[-1, -1] = 1.0
    T = lower @ upper.T
    inverse = np.linalg.inv(T).round()
    assert np.array_equal(T @ inverse, np.eye(3 * n))
    return T @ A @ inverse, np.array(poles)


def error_of_poles(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest relative distance of an exact pole from the nearest one found."""
    return float(np.max(np.abs(found - exact[:, None]).min(axis=1) / np.abs(exact)))


def test_corrected_poles_are_exact_over_six_decades() -> None:
    A, exact = spread(5)
    assert error_of_poles(modes(A).poles, exact) > 1e-13
    assert error_of_poles(corrected_modes(A, modes(A)).poles, exact) < 4e-16
    found = corrected_modes(A, modes(A))
    poles, V = found.poles, complex_columns(found.poles, found.vectors + found.low)
    assert np.abs(A @ V - V * poles).max() < 1e-15 * np.abs(A).max()


def test_inverse_rows_belong_to_the_columns() -> None:
    A = np.random.default_rng(1).normal(size=(9, 9))
    found = corrected_modes(A, modes(A))
    V, inverse = complex_columns(found.poles, found.vectors), complex_rows(found.poles, found.excited(np.eye(len(A))))
    np.testing.assert_allclose(inverse @ V, np.eye(len(A)), atol=1e-12)
    np.testing.assert_allclose(V * found.poles @ inverse, A, atol=1e-12)
    np.testing.assert_allclose(complex_columns(found.poles, found.observed(np.eye(len(A)))), V, atol=1e-12)


def test_equal_poles_keep_their_vectors() -> None:
    """No correction divides by the distance of equal eigenvalues."""
    A = -2.0 * np.eye(3)
    found = corrected_modes(A, modes(A))
    poles, V = found.poles, complex_columns(found.poles, found.vectors + found.low)
    assert poles.tolist() == [-2.0, -2.0, -2.0] and np.array_equal(V, np.eye(3))


def test_pairs_next_to_the_real_axis_stay_pairs() -> None:
    """A double real pole: rounding makes it a pair or two real poles; no correction may mix the two forms."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        T = np.eye(6) + 0.3 * rng.normal(size=(6, 6))
        A = T @ np.diag([-1.0, -1.0, -2.0, -2.0, -50.0, -3.0]) @ np.linalg.inv(T)
        A[0, 1] += 1e-13 * rng.normal()
        found = corrected_modes(A, modes(A))
        first = np.flatnonzero(found.poles.imag > 0)
        assert np.array_equal(found.poles[first + 1], found.poles[first].conj())
        assert np.count_nonzero(found.poles.imag < 0) == len(first)
        np.testing.assert_allclose(np.sort(found.poles.real), [-50, -3, -2, -2, -1, -1], rtol=1e-6)


Q, P, M = 6, 3, 4
MANY = 40  # diagonals from which on repeated channels are closed at once
REPEATED = np.array([True, False, True, True, False, False])


def random(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def lft(rng: np.random.Generator, count: int | None = None) -> LftResponse:
    lead = () if count is None else (count,)
    return LftResponse.of(0.3 * random(rng, *lead, Q + P, Q + M), Q)


def all_signals(own: LftResponse, delta: np.ndarray) -> np.ndarray:
    """Outputs by inputs from one equation for (z, w): ``z - M w = T21 d``, ``w - Delta z = 0``; Delta (w, z) dense."""
    w, z = delta.shape
    equations = np.block([[np.eye(z), -own.M], [-delta, np.eye(w)]])
    signals = np.linalg.solve(equations, np.vstack([own.T21, np.zeros((w, own.T21.shape[1]))]))
    return own.T11 + own.T12 @ signals[z:]


def diagonals(rng: np.random.Generator, count: int) -> np.ndarray:
    """Complex entries, those of the repeated channels equal."""
    found = random(rng, count, Q)
    found[:, REPEATED] = found[:, :1]
    return found


@pytest.mark.parametrize("count", [1, 5, MANY + 3])
@pytest.mark.parametrize("repeated", [None, REPEATED])
def test_the_closed_response_solves_all_signals(count: int, repeated: np.ndarray | None) -> None:
    rng = np.random.default_rng(count)
    own, delta = lft(rng), diagonals(rng, count)
    for found, entries in zip(own.closed(delta, repeated), delta):
        np.testing.assert_allclose(found, all_signals(own, np.diag(entries)), rtol=1e-9, atol=1e-11)


def test_each_frequency_can_have_a_delta_of_its_own() -> None:
    rng = np.random.default_rng(0)
    own, delta = lft(rng, 7), diagonals(rng, 7)
    for k, found in enumerate(own.closed(delta)):
        np.testing.assert_allclose(found, own[k].closed(delta[k : k + 1])[0], rtol=1e-12)


def test_parts_of_inputs_and_outputs_are_parts_of_the_response() -> None:
    rng = np.random.default_rng(2)
    own, delta, rows, columns = lft(rng), diagonals(rng, 3), slice(1, 3), slice(0, 2)
    np.testing.assert_allclose(own.part(rows, columns).closed(delta), own.closed(delta)[:, rows, columns], rtol=1e-12)


@pytest.mark.parametrize("shape", [(Q, Q), (2, Q), (Q, 4)])
def test_a_real_matrix_is_closed_at_all_frequencies(shape: tuple[int, int]) -> None:
    """Square and not: (outputs of Delta, inputs of Delta)."""
    rng, (w, z) = np.random.default_rng(3), shape
    own = LftResponse(random(rng, 5, z, w), random(rng, 5, P, w), random(rng, 5, z, M), random(rng, 5, P, M))
    delta = 0.2 * rng.standard_normal(shape)
    for k, found in enumerate(own.closed_with_matrix(delta)):
        np.testing.assert_allclose(found, all_signals(own[k], delta), rtol=1e-9, atol=1e-11)


def test_slopes_are_difference_quotients() -> None:
    rng, step = np.random.default_rng(5), 1e-6
    own, delta = lft(rng, 4), diagonals(rng, 4)
    found = own.gain_slopes(delta)
    np.testing.assert_allclose(found.values, np.linalg.svd(own.closed(delta), compute_uv=False), rtol=1e-12)
    closed = own.closed(delta)
    for k in range(4):
        assert found.left[k] @ closed[k] @ found.right[k] == pytest.approx(found.values[k, 0])
    for channel in range(Q):
        for turn in (1.0, 1j):
            change = np.zeros(Q, complex)
            change[channel] = step * turn
            gains = [np.linalg.norm(own.closed(delta + sign * change), 2, axis=(1, 2)) for sign in (1.0, -1.0)]
            expected = (gains[0] - gains[1]) / (2.0 * step)
            np.testing.assert_allclose((found.slopes[:, channel] * turn).real, expected, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("balanced", [False, True])
def test_feedback_satisfies_its_equation(balanced: bool) -> None:
    rng = np.random.default_rng(6)
    gain, entering = random(rng, 5, 3, 3), random(rng, 5, 3, 2)
    found = feedback(gain, entering, balanced=balanced)
    np.testing.assert_allclose(found, gain @ found + entering, rtol=1e-10)


def test_balanced_rows_keep_the_digits_of_small_commands() -> None:
    """Angles of 1e-9 beside forces of 1e3, each from the other: in equal units the solution is known."""
    rng = np.random.default_rng(7)
    gain, entering, units = random(rng, 1, 2, 2), random(rng, 1, 2, 1), np.array([1e-9, 1e3])
    expected = units[:, None] * np.linalg.solve(np.eye(2) - gain[0], entering[0])
    scaled = gain * units[:, None] / units
    found = feedback(scaled, units[:, None] * entering, balanced=True)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
