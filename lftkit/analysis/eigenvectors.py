"""Eigenvectors of models whose poles spread over many decades, with the digits that the slow ones need.

Everything is kept in the real form: a pair ``x +- j y`` of eigenvectors takes the two columns x and y, as in LAPACK.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.analysis.compensated import fine_product, halves, matrix_product, two_sum
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.support.state_units import in_balanced_units

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Modes:
    """Eigenvalues and eigenvectors of a real matrix.

    Parameters
    ----------
    poles : ndarray, shape (n,), complex
        Conjugate pairs stand side by side, the one with the positive imaginary part first.
    vectors : ndarray, shape (n, n)
        Column k, and k + 1 of a pair, holds the real and the imaginary part of the eigenvector.
    low : ndarray, shape (n, n)
        What is to be added to `vectors`: digits beyond the working precision.
    factors : tuple
        LU factors of `vectors`.
    """

    poles: ComplexArray
    vectors: FloatArray
    low: FloatArray
    factors: tuple[FloatArray, NDArray[np.int32]]

    @cached_property
    def reciprocal_condition(self) -> float:
        """Estimate of the reciprocal condition number of the eigenvectors, 1-norm."""
        return float(linalg.lapack.dgecon(self.factors[0], np.abs(self.vectors).sum(axis=0).max())[0])

    def observed(self, C: FloatArray) -> FloatArray:
        """``C (vectors + low)``, shape (p, n), rounded once."""
        high, low = matrix_product(C, self.vectors)
        return high + (low + C @ self.low)

    def excited(self, B: FloatArray) -> FloatArray:
        """``(vectors + low)^-1 B``, shape (n, m), accurate to its own rounding."""
        first = linalg.lapack.dgetrs(*self.factors, B)[0]
        high, low = matrix_product(self.vectors, first)
        correction = linalg.lapack.dgetrs(*self.factors, (B - high) - (low + self.low @ first))[0]
        return np.asarray(first + correction)

    def resolvent(self, omega: float, right: FloatArray) -> FloatArray:
        """``(j omega - A)^-1 (x + j y)`` for x beside y in `right` (n, 2 m), in the same form."""
        m = right.shape[1] // 2
        excited = complex_rows(self.poles, self.excited(right))
        parts = (excited[:, :m] + 1j * excited[:, m:]) / (1j * omega - self.poles)[:, None]
        X = complex_columns(self.poles, self.vectors) @ parts
        return np.hstack([X.real, X.imag])


def modes(A: FloatArray) -> Modes:
    """Eigenvalues and eigenvectors of `A` (n, n) as the QR algorithm gives them, exact to the rounding of A.

    Raises
    ------
    ArithmeticError
        The QR algorithm did not converge (entries near overflow).
    """
    A = np.asfortranarray(A)  # the order of LAPACK
    n = len(A)
    work = int(linalg.lapack.dgeev_lwork(n, compute_vl=0)[0])
    real, imaginary, _, vectors, info = linalg.lapack.dgeev(A, compute_vl=0, lwork=work)
    if info:
        raise ArithmeticError(f"the eigenvalues of a matrix of order {n} did not converge")
    return Modes(real + 1j * imaginary, vectors, np.zeros_like(vectors), linalg.lapack.dgetrf(vectors)[:2])


def corrected_modes(
    A: FloatArray, eigen: Modes, converged: float = 1e-9, *, steps: int = 3, apart: float = 1e-6
) -> Modes:
    """The modes `eigen` of `A` with all digits that the matrix holds.

    With poles from 0.01 to 1e5 rad/s the slow ones of the QR algorithm keep six digits. Newton steps on all pairs at
    once, with residuals in twice the working precision, bring the others back; pairs closer than `apart` times
    their size are left as they are. They end after so many `steps`, or where the relative change of the eigenvectors is
    below `converged`; its square is the error that is left. Where the eigenvectors are no basis, `eigen` is returned.
    """
    if eigen.reciprocal_condition < EPS:
        return eigen
    A, best = np.asfortranarray(A), eigen
    for _ in range(steps):
        poles_step, vectors_step = _newton_step(A, best, apart)
        # a real pole stays real: an imaginary part of rounding would make half a pair of it
        poles_step = np.where(eigen.poles.imag == 0, poles_step.real, poles_step)
        change = float(np.abs(vectors_step).max(initial=0.0))  # the columns have the norm 1 (a pair: together)
        if not (np.isfinite(change) and change < 0.01):
            return eigen
        if change < converged:
            return replace(best, poles=best.poles + poles_step, low=vectors_step)
        best = replace(best, poles=best.poles + poles_step, vectors=best.vectors + vectors_step)
    return best


def finely_corrected(A: FloatArray, eigen: Modes, *, steps: int = 2, apart: float = 1e-6) -> Modes:
    """The corrected modes `eigen` of `A`, with residuals that have seven digits more.

    For poles whose decay is below the error of :func:`corrected_modes`, about 2^-75 times the norm of A and the
    condition of the eigenvectors.
    """
    A, best = np.asfortranarray(A), eigen
    for _ in range(steps):
        poles_step, vectors_step = _newton_step(A, best, apart, fine=True)
        poles_step = np.where(eigen.poles.imag == 0, poles_step.real, poles_step)
        change = float(np.abs(vectors_step).max(initial=0.0))
        if not (np.isfinite(change) and change < 0.01):
            return eigen
        vectors, low = two_sum(best.vectors, best.low + vectors_step)
        best = replace(best, poles=best.poles + poles_step, vectors=vectors, low=low)
    return best


def complex_columns(poles: ComplexArray, X: FloatArray) -> ComplexArray:
    """Columns in the real form (x, y) as ``x + j y`` and ``x - j y``; the right factor of a modal sum."""
    first = np.flatnonzero(poles.imag > 0)
    out = X.astype(complex)
    out[:, first] += 1j * X[:, first + 1]
    out[:, first + 1] = out[:, first].conj()
    return out


def complex_rows(poles: ComplexArray, Y: FloatArray) -> ComplexArray:
    """Rows of an inverse in the real form as those of the inverse of :func:`complex_columns`."""
    first = np.flatnonzero(poles.imag > 0)
    out = Y.astype(complex)
    out[first] = 0.5 * (Y[first] - 1j * Y[first + 1])
    out[first + 1] = out[first].conj()
    return out


def balanced(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same system with states in units that make the rows and columns of A alike.

    Metres beside microradians give eigenvectors a condition of 1e9; in these units it is 1e5. The units are powers of
    two, so nothing is rounded.
    """
    A, units = in_balanced_units(A)
    return A, B / units[:, None], C * units


def _newton_step(A: FloatArray, modes: Modes, distance: float, fine: bool = False) -> tuple[ComplexArray, FloatArray]:
    """Corrections of the eigenvalues (n,) and of the eigenvectors (n, n), the latter in the real form.

    Eigenvectors of eigenvalues that are closer than `distance`, relative to their size, are left as they are.
    """
    poles, W = modes.poles, modes.vectors
    n = len(poles)
    first = np.flatnonzero(poles.imag > 0)
    heads = np.flatnonzero(poles.imag >= 0)  # one column for each pair
    residual = _fine_residual(A, modes) if fine else eigenvector_residual(A, modes)
    off = linalg.lapack.dgetrs(*modes.factors, residual)[0]
    columns = off[:, heads] + 1j * np.where(poles.imag[heads] > 0, off[:, _partners(poles)[heads]], 0.0)
    x, y = columns[first], columns[first + 1]
    columns[first], columns[first + 1] = 0.5 * (x - 1j * y), 0.5 * (x + 1j * y)
    size = np.abs(poles)
    gap = poles[heads] - poles[:, None]
    apart = np.abs(gap) > distance * np.maximum(size[heads], size[:, None])
    turn = np.where(apart, columns / np.where(apart, gap, 1.0), 0.0)
    shift = np.zeros(n, dtype=complex)
    shift[heads] = columns[heads, np.arange(len(heads))]
    shift[first[poles.imag[first] <= distance * size[first]]] = 0.0  # a pair must stay one
    shift[first + 1] = shift[first].conj()
    x, y = turn[first], turn[first + 1]
    turn[first], turn[first + 1] = x + y, 1j * (x - y)
    step = np.empty_like(W)
    step[:, heads] = W @ np.asfortranarray(turn.real)
    second = poles.imag[heads] > 0
    step[:, first + 1] = W @ np.asfortranarray(turn.imag[:, second])
    return shift, step


def eigenvector_residual(A: FloatArray, modes: Modes) -> FloatArray:
    """``A W - W L`` for the eigenvectors W (without `low`) and the poles L, in the real form, rounded once."""
    W, poles, partner = modes.vectors, modes.poles, _partners(modes.poles)
    total, low = matrix_product(A, W)
    first, second = halves(W)
    for factor, X1, X2 in ((-poles.real, first, second), (poles.imag, first[:, partner], second[:, partner])):
        factor1, factor2 = halves(factor)
        total, error = two_sum(total, X1 * factor1)
        low += error
        low += X1 * factor2
        low += X2 * factor
    return total + low


def _partners(poles: ComplexArray) -> IntArray:
    """Place of the conjugate of each pole (n,), of a real one its own."""
    return np.asarray(np.arange(len(poles)) + (poles.imag > 0) - (poles.imag < 0))


def _fine_residual(A: FloatArray, modes: Modes) -> FloatArray:
    """As :func:`eigenvector_residual` for the eigenvectors with what is to be added to them, with seven digits more."""
    poles, W, low, partner = modes.poles, modes.vectors, modes.low, _partners(modes.poles)
    parts, rest = fine_product(A, W)
    rest = rest + A @ low - low * poles.real + low[:, partner] * poles.imag
    for factor, X in ((-poles.real, W), (poles.imag, W[:, partner])):
        (first, second), (one, two) = halves(X), halves(factor)
        parts += [first * one, first * two, second * one, second * two]
    total = np.zeros_like(W)
    for part in parts:
        total, error = two_sum(total, part)
        rest = rest + error
    return total + rest


def modal(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles, B and C in coordinates in which A is diagonal: ``C (s I - A)^-1 B = (c / (s - poles)) @ b``.

    Returns
    -------
    poles : ndarray, complex, shape (n,)
    b, c : ndarray, complex, shapes (n, m) and (p, n)
    """
    if not len(A):
        return np.zeros(0, complex), np.asarray(B, dtype=complex), np.asarray(C, dtype=complex)
    eigen = corrected_modes(np.asarray(A), modes(np.asarray(A)))
    b = complex_rows(eigen.poles, eigen.excited(np.asarray(B)))
    return eigen.poles, b, complex_columns(eigen.poles, eigen.observed(np.asarray(C)))
