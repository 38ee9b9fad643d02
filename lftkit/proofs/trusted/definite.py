"""Positive definiteness of a matrix whose entries are known with an error, whatever LAPACK returns.

Any R will do: with ``A = R R* + shift I + E`` the matrix A is positive definite if the norm of E is below `shift`. R is
about the Cholesky factor of ``A - shift I`` and nobody trusts it: E is computed from it, with a bound of all rounding.
The condition is written so that a number which is not finite refuses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.polynomials import TINY, UNIT

if TYPE_CHECKING:
    from lftkit.arrays import ComplexArray, FloatArray

INFLATE = 1.0 + 1e-6  # covers the rounding of the bounds themselves


def positive(matrix: ComplexArray | FloatArray, rest: FloatArray, factor: float = 1.0) -> bool:
    """Whether the Hermitian part, less anything whose entries are below `rest`, is certainly positive definite.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    rest : ndarray, shape (n, n)
        Bounds of the errors of its entries.
    factor : float
        At least 1: what remains after this many times the bound of everything that can be wrong was subtracted is
        positive definite, too, up to that bound.

    Examples
    --------
    >>> positive(np.eye(2), np.full((2, 2), 0.4)), positive(np.eye(2), np.full((2, 2), 0.5))
    (True, False)
    >>> positive(np.diag([1.0, np.nan]), np.zeros((2, 2))), positive(np.diag([1.0, np.inf]), np.zeros((2, 2)))
    (False, False)
    """
    n = len(matrix)
    if not n:
        return True
    with np.errstate(all="ignore"):
        middle: Any = 0.5 * matrix + 0.5 * matrix.conj().T
        size, own = float(np.abs(np.diag(middle)).sum()), 8.0 * (n + 8) * UNIT
        off = float(np.maximum(rest, rest.T).sum(axis=1).max())
        shift = factor * INFLATE * (2.0 * own * size + off)
        lowered = middle - shift * np.eye(n)
        R = (linalg.lapack.zpotrf if np.iscomplexobj(middle) else linalg.lapack.dpotrf)(lowered, lower=1)[0]
        left = float(np.abs(lowered - R @ R.conj().T).sum(axis=1).max())
        wrong = left + own * float((np.abs(R) ** 2).sum()) + 4.0 * UNIT * (size + shift) + off
        return bool(INFLATE * wrong + TINY < shift)
