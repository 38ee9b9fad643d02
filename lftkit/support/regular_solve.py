"""Linear equations that judge their own condition, so that nobody has to hear a warning of what is not used.

A matrix counts as singular where its condition is beyond a limit, and that of the matrix with rows and columns of equal
size, too: the units of signals and states do not matter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.arrays import FloatArray

LEAST = float(np.finfo(float).eps)
"""Reciprocal condition number below which a solution has no digit that is right."""


def lu_factors(M: FloatArray, rcond: float = LEAST) -> tuple[FloatArray, NDArray[np.int32]] | None:
    """LU factors of a square matrix as LAPACK has them; None where it is singular.

    Parameters
    ----------
    M : ndarray, shape (n, n)
    rcond : float
        Reciprocal condition number below which it counts as singular; 0: only where a pivot is zero.
    """
    lu, pivots, info = linalg.lapack.dgetrf(M)
    return None if info > 0 or _singular(M, lu, rcond) else (lu, pivots)


def regular_solve(M: FloatArray, right: FloatArray) -> FloatArray:
    """Solution X of ``M X = right``, shapes (n, n), (n, k).

    Raises
    ------
    LinAlgError
        The matrix is singular to working precision.

    Examples
    --------
    Units do not matter:

    >>> regular_solve(np.diag([1e-12, 1e12]), np.array([[1.0], [1.0]])).ravel().tolist()
    [1000000000000.0, 1e-12]
    >>> regular_solve(np.array([[1.0, 1.0], [1.0, 1.0 + 1e-16]]), np.ones((2, 1)))
    Traceback (most recent call last):
    ...
    numpy.linalg.LinAlgError: the matrix must be regular, got one that is singular to working precision
    """
    if not len(M):
        return np.zeros(right.shape)
    if not np.all(np.isfinite(M)) or (factors := lu_factors(M)) is None:
        raise linalg.LinAlgError("the matrix must be regular, got one that is singular to working precision")
    return np.asarray(linalg.lapack.dgetrs(*factors, right)[0])


def _singular(M: FloatArray, lu: FloatArray, rcond: float) -> bool:
    if not rcond or _reciprocal_condition(M, lu) >= rcond:
        return False
    scaled = M / np.abs(M).max(axis=1, keepdims=True)
    scaled = scaled / np.abs(scaled).max(axis=0)
    return _reciprocal_condition(scaled, linalg.lapack.dgetrf(scaled)[0]) < rcond


def _reciprocal_condition(M: FloatArray, lu: FloatArray) -> float:
    return float(linalg.lapack.dgecon(lu, np.abs(M).sum(axis=0).max())[0])
