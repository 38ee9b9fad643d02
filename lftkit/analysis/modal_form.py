"""A linear system in coordinates in which its poles are apart: blocks of two rows for pairs, one row for real poles.

``x = basis q`` and, for a pair ``s +- i w``, ``q1' = s q1 + w q2``, ``q2' = -w q1 + s q2``. Poles whose eigenvectors
are nearly parallel (a free body is a double zero; two equal modes that act on each other) have no such coordinates:
they share one block, in an orthonormal basis of their invariant subspace. The eigenvectors are those of the balanced
matrix, with digits beyond the working precision (:mod:`lftkit.analysis.eigenvectors`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS, Modes, corrected_modes, modes
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.support.state_units import in_balanced_units


@dataclass(frozen=True)
class ModalForm:
    """Coordinates of a matrix A (n, n): m pairs, r real poles, a block of order d; ``n = 2 m + r + d``.

    The coordinates stand in this order: the first of each pair, the second of each pair, the real poles, the block.

    Parameters
    ----------
    pairs : ndarray, shape (m,), complex
        Poles with positive imaginary part, by rising size.
    real : ndarray, shape (r,)
    block : ndarray, shape (d, d)
        ``q' = block q`` of the last coordinates.
    units : ndarray, shape (n,)
        Of the states, powers of two.
    vectors : Modes
        ``x = units (vectors + low) q``; its poles are not used.

    Examples
    --------
    A light mode beside a free mass, of which only the mass needs a block:

    >>> A = linalg.block_diag([[0.0, 1.0], [-4.0, -0.01]], [[0.0, 1.0], [0.0, 0.0]])
    >>> form = ModalForm.of(A)
    >>> form.pairs.round(3).tolist(), form.real.size, len(form.block)
    ([(-0.005+2j)], 0, 2)
    """

    pairs: ComplexArray
    real: FloatArray
    block: FloatArray
    units: FloatArray
    vectors: Modes

    @classmethod
    def of(cls, A: FloatArray, *, parallel: float = 1e5, converged: float = 1e-7, condition: float = 1e8) -> ModalForm:
        """Modal form of `A`.

        Parameters
        ----------
        A : ndarray, shape (n, n)
        parallel : float
            Condition number of a pole, of its left and right eigenvectors, above which it is kept in the block.
        converged : float
            Relative change of the eigenvectors by the last Newton step; the error that is left is its square.
        condition : float
            Of all coordinates together, in balanced units; above it, the block holds the whole matrix.

        Raises
        ------
        ArithmeticError
            The QR algorithm did not converge (entries near overflow).
        """
        A = np.asarray(A, dtype=float)
        a, units = in_balanced_units(A)
        if not len(A):
            return cls.whole(a, units)
        eigen = corrected_modes(a, modes(a), converged)
        # Poles, pairs together, whose left and right eigenvectors are nearly orthogonal
        n = len(eigen.poles)
        if eigen.reciprocal_condition < EPS:
            U, values, Vt = linalg.svd(eigen.vectors)  # parallel columns are those of the null space
            inverse = (Vt.T / np.maximum(values, EPS * values[0])) @ U.T
        else:
            inverse = linalg.lapack.dgetrs(*eigen.factors, np.eye(n))[0]
        size = np.asarray(linalg.norm(eigen.vectors, axis=0) * linalg.norm(inverse, axis=1))
        first = np.flatnonzero(eigen.poles.imag > 0)
        size[first] = size[first + 1] = np.maximum(size[first], size[first + 1])
        blocked = np.asarray(~(size < parallel))
        if not blocked.any():
            form = cls._of_vectors(units, eigen, ~blocked, np.zeros((0, 0)), np.zeros((n, 0)))
            return cls.whole(a, units) if eigen.reciprocal_condition * condition < 1.0 else form
        inside, outside = eigen.poles[blocked], eigen.poles[~blocked]

        def chosen(real: float, imaginary: float) -> bool:
            pole = complex(real, imaginary)
            return bool(np.abs(inside - pole).min() < np.abs(outside - pole).min(initial=np.inf))

        T, Q, count = linalg.schur(a, output="real", sort=chosen)
        if count != blocked.sum():
            return cls.whole(a, units)
        form = cls._of_vectors(units, eigen, ~blocked, T[:count, :count], Q[:, :count])
        return form if form.vectors.reciprocal_condition * condition >= 1.0 else cls.whole(a, units)

    @classmethod
    def _of_vectors(
        cls, units: FloatArray, eigen: Modes, kept: BoolArray, block: FloatArray, added: FloatArray
    ) -> ModalForm:
        """Coordinates of the poles that are `kept`, by their size, and of `block` in the basis `added` (n, d)."""

        def rising(which: BoolArray) -> IntArray:
            place = np.flatnonzero(which & kept)
            return np.asarray(place[np.lexsort((place, np.abs(eigen.poles[place])))])

        heads, real = rising(eigen.poles.imag > 0), rising(eigen.poles.imag == 0)
        # Some of the columns, and further ones behind them (n, d)
        order = np.concatenate([heads, heads + 1, real])
        vectors = np.hstack([eigen.vectors[:, order], added])
        low = np.hstack([eigen.low[:, order], np.zeros_like(added)])
        poles = np.concatenate([eigen.poles[order], np.zeros(vectors.shape[1] - len(order))])
        basis = Modes(poles, vectors, low, linalg.lapack.dgetrf(vectors)[:2])
        return cls(eigen.poles[heads], eigen.poles[real].real, block, units, basis)

    @classmethod
    def whole(cls, A: FloatArray, units: FloatArray | None = None) -> ModalForm:
        """The states themselves, in these units, as coordinates: one block."""
        a, eye = np.asarray(A, dtype=float), np.eye(len(A))
        basis = Modes(np.zeros(len(a), complex), eye, np.zeros_like(eye), (eye, np.arange(len(a), dtype=np.int32)))
        return cls(np.zeros(0, complex), np.zeros(0), a, np.ones(len(a)) if units is None else units, basis)

    @property
    def order(self) -> int:
        """Number of coordinates."""
        return len(self.units)

    @property
    def plain(self) -> int:
        """Number of coordinates before the block."""
        return 2 * len(self.pairs) + len(self.real)

    @property
    def matrix(self) -> FloatArray:
        """``q' = matrix q``, shape (n, n)."""
        m, plain = len(self.pairs), self.plain
        out = np.zeros((self.order, self.order))
        first, real = np.arange(m), np.arange(2 * m, plain)
        out[first, first] = out[m + first, m + first] = self.pairs.real
        out[first, m + first], out[m + first, first] = self.pairs.imag, -self.pairs.imag
        out[real, real] = self.real
        out[plain:, plain:] = self.block
        return out

    @property
    def basis(self) -> FloatArray:
        """``x = basis q``, shape (n, n)."""
        return np.asarray(self.units[:, None] * (self.vectors.vectors + self.vectors.low))

    def observed(self, C: FloatArray) -> FloatArray:
        """``C basis``, shape (p, n), rounded once."""
        C = np.asarray(C, dtype=float)
        return self.vectors.observed(C * self.units) if self.order else C

    def excited(self, B: FloatArray) -> FloatArray:
        """``basis^-1 B``, shape (n, k) for `B` (n, k), accurate to its own rounding."""
        B = np.asarray(B, dtype=float)
        return self.vectors.excited(B / self.units[:, None]) if self.order and B.size else B

    def resolvent(self, s: ComplexArray, forcing: ComplexArray) -> ComplexArray:
        """``(s_k - L)^-1 forcing_k`` for the columns of `forcing` (n, K) in these coordinates: shape (n, K)."""
        m, plain = len(self.pairs), self.plain
        out = np.empty_like(forcing)
        pole = self.pairs[:, None]
        away = s - pole.real
        scale = 1.0 / ((s - pole) * (s - pole.conj()))
        first, second = forcing[:m], forcing[m : 2 * m]
        out[:m] = scale * (away * first + pole.imag * second)
        out[m : 2 * m] = scale * (away * second - pole.imag * first)
        out[2 * m : plain] = forcing[2 * m : plain] / (s - self.real[:, None])
        eye = np.eye(len(self.block))
        for k, value in enumerate(s if len(eye) else ()):
            out[plain:, k] = linalg.solve(value * eye - self.block, forcing[plain:, k])
        return out

    def distances(self, s: ComplexArray) -> FloatArray:
        """Distance of each value (K,) from the nearest pole: shape (K,); infinite without poles."""
        poles = np.concatenate([self.pairs, self.pairs.conj(), self.real, linalg.eigvals(self.block)])
        return np.asarray(np.abs(np.asarray(s) - poles[:, None]).min(axis=0, initial=np.inf))
