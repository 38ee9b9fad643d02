"""Units of states in which rows and columns of a matrix are alike."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray


def in_balanced_units(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A square matrix (n, n) with states in units in which its rows and columns are alike, and these units (n,).

    The units are powers of two: nothing is rounded. As ``scipy.linalg.matrix_balance``, which makes them integers on
    the way and warns of large ones.

    Examples
    --------
    >>> A, units = in_balanced_units(np.array([[1.0, 2.0**20], [2.0**-20, 1.0]]))
    >>> A.tolist(), (units[0] / units[1]).item() == 2.0**19
    ([[1.0, 2.0], [0.5, 1.0]], True)
    """
    if not len(A):
        return A, np.ones(0)
    balanced, _, _, units, _ = linalg.lapack.dgebal(A, scale=1, permute=0)
    return np.asarray(balanced), np.asarray(units)
