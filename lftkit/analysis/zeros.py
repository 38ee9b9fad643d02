"""Finite zeros of a square system."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray


def zeros_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> ComplexArray:
    """Points at which the system matrix ``[A - s, B; C, D]`` loses rank; none of a system that is not square.

    Zeros at infinity may be among them as large numbers: rounding makes them finite.

    Parameters
    ----------
    A, B, C, D : ndarray, shapes (n, n), (n, m), (m, n), (m, m)

    Returns
    -------
    ndarray, complex
        [rad/s], or of a sampled system in the z-plane.

    Examples
    --------
    ``(s - 2) / (s + 1)``:

    >>> zeros_of(np.array([[-1.0]]), np.array([[1.0]]), np.array([[-3.0]]), np.array([[1.0]])).round(9).tolist()
    [(2+0j)]
    """
    n, (outputs, inputs) = len(A), np.shape(D)
    if outputs != inputs:
        return np.zeros(0, complex)
    unit = np.zeros((n + inputs, n + inputs))
    unit[:n, :n] = np.eye(n)
    values = np.asarray(linalg.eigvals(np.block([[A, B], [C, D]]), unit), dtype=complex)
    return np.asarray(values[np.isfinite(values)])
