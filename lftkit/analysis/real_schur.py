"""A real matrix in quasi-triangular form: its eigenvalues, and solutions with it at many points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.support.state_units import in_balanced_units


@dataclass(frozen=True)
class RealSchur:
    """``A = U basis form basis' U^-1`` with the diagonal U of `units`, which balance A as for its eigenvalues.

    Parameters
    ----------
    form : ndarray, shape (n, n)
        Quasi-triangular: 1 x 1 and 2 x 2 blocks on the diagonal, zeros below.
    basis : ndarray, shape (n, n)
        Orthogonal.
    units : ndarray, shape (n,)
        Powers of two.
    eigenvalues : ndarray, shape (n,), complex
    """

    form: FloatArray
    basis: FloatArray
    units: FloatArray
    eigenvalues: ComplexArray

    @classmethod
    def of(cls, A: FloatArray) -> RealSchur:
        """Schur form of `A` (n, n).

        Raises
        ------
        ArithmeticError
            The QR algorithm did not converge (entries near overflow).
        """
        A, units = in_balanced_units(A)
        work = int(linalg.lapack.dgees(_any, A, lwork=-1)[-2][0])
        form, _, real, imaginary, basis, _, info = linalg.lapack.dgees(_any, A, lwork=work)
        if info:
            raise ArithmeticError(f"the eigenvalues of a matrix of order {len(A)} did not converge")
        return cls(form, basis, units, real + 1j * imaginary)

    def solve(self, points: ComplexArray, forcing: ComplexArray) -> ComplexArray:
        """``(z_k - A)^-1 forcing_k`` for the columns of `forcing` (n, K) at `points` (K,): shape (n, K).

        All points together are one Sylvester equation ``X R - A X = F``, R with a block of two for each point.

        Examples
        --------
        >>> schur = RealSchur.of(np.array([[0.5, 1.0], [0.0, 0.25]]))
        >>> schur.solve(np.array([1j]), np.array([[1.0], [1.0]], complex)).round(3)
        array([[-1.059-0.235j],
               [-0.235-0.941j]])
        """
        count = len(points)
        if not count:
            return np.zeros_like(forcing)
        turn = np.zeros((2 * count, 2 * count), order="F")
        first = 2 * np.arange(count)
        turn[first, first] = turn[first + 1, first + 1] = points.real
        turn[first, first + 1], turn[first + 1, first] = points.imag, -points.imag
        columns = np.empty((len(self.form), 2 * count))
        columns[:, first], columns[:, first + 1] = forcing.real, forcing.imag
        solution, scale, _ = linalg.lapack.dtrsyl(
            self.form, turn, -(self.basis.T @ (columns / self.units[:, None])), isgn=-1
        )
        solution = self.units[:, None] * (self.basis @ solution) / scale
        return np.asarray(solution[:, first] + 1j * solution[:, first + 1])


def _any(real: float, imaginary: float) -> bool:  # LAPACK asks for it though nothing is sorted
    return False
