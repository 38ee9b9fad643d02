"""Products in twice the working precision against exact fractions; corrected eigenvectors."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lftkit.analysis.compensated import fine_product, matrix_product, two_product, two_sum
from lftkit.analysis.eigenvectors import complex_columns, complex_rows, corrected_modes, eigenpairs, modes

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
    poles, V = eigenpairs(A)
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
    poles, V = eigenpairs(-2.0 * np.eye(3))
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
