"""Linear algebra on stacks of small matrices.

The one module of the library that uses ``numpy.linalg``: its routines run over a stack (N, p, p) inside LAPACK
loops written in C, which ``scipy.linalg`` does in Python only. At a thousand frequencies that is a factor of a hundred.
"""

from __future__ import annotations

import numpy as np
from numpy.linalg import det as _det
from numpy.linalg import eigh as _eigh
from numpy.linalg import eigvals as _eigvals
from numpy.linalg import eigvalsh as _eigvalsh
from numpy.linalg import solve as _solve
from numpy.linalg import svd as _svd
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def solve(M: ComplexArray, X: ComplexArray) -> ComplexArray:
    """Solutions of ``M[i] Y[i] = X[i]``, shapes (N, k, k) and (N, k, m)."""
    if M.shape[1] == 1:
        return np.asarray(X / M)
    return np.asarray(_solve(M, X))


def determinants(M: ComplexArray) -> ComplexArray:
    """Determinant of each matrix of the stack `M` (N, k, k)."""
    return np.asarray(_det(M), dtype=complex)


def eigenvalues(M: ComplexArray) -> ComplexArray:
    """Eigenvalues of each matrix of the stack `M` (N, k, k): shape (N, k)."""
    return np.asarray(_eigvals(M), dtype=complex)


def largest_gains(T: ComplexArray) -> FloatArray:
    """Largest singular value of each matrix of the stack `T` (N, p, m).

    Examples
    --------
    >>> largest_gains(np.array([[[3.0, 0.0], [0.0, 4.0j]]])).tolist()
    [4.0]
    """
    if T.shape[1] == 0 or T.shape[2] == 0:
        return np.zeros(len(T))
    if min(T.shape[1:]) == 1:
        return np.asarray(np.sqrt(np.sum(np.abs(T) ** 2, axis=(1, 2))))
    gram = _small_gram(T)
    if gram.shape[1] == 2:
        half = 0.5 * (gram[:, 0, 0] - gram[:, 1, 1]).real
        middle = 0.5 * (gram[:, 0, 0] + gram[:, 1, 1]).real
        return np.asarray(np.sqrt(middle + np.hypot(half, np.abs(gram[:, 0, 1]))))
    return np.asarray(np.sqrt(np.maximum(_eigvalsh(gram)[:, -1], 0.0)))


def singular_values(T: ComplexArray) -> FloatArray:
    """All singular values of each matrix of the stack `T` (N, p, m), largest first: shape (N, min(p, m))."""
    return np.asarray(_svd(T, compute_uv=False))


def singular_triples(T: ComplexArray) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """U (N, p, k), singular values (N, k) and Vh (N, k, m) of each matrix of the stack `T` (N, p, m), k = min(p, m)."""
    U, values, Vh = _svd(T, full_matrices=False)
    return np.asarray(U), np.asarray(values), np.asarray(Vh)


def gains_above(T: ComplexArray, fraction: float) -> FloatArray:
    """Largest singular values of the stack `T`, exact wherever they exceed `fraction` of the largest of all.

    Elsewhere the Frobenius norm, an upper bound that is itself below that level, stands in: most frequencies
    are far from any peak and need no decomposition.
    """
    bound = np.sqrt(np.sum(T.real**2 + T.imag**2, axis=(1, 2)))
    if min(T.shape[1:]) <= 1 or len(T) == 0:
        return np.asarray(bound)
    floor = largest_gains(T[[int(np.argmax(bound))]])[0]
    floor = max(floor, float(bound.max()) / np.sqrt(min(T.shape[1:]))) * fraction
    near = bound >= floor
    bound[near] = largest_gains(T[near])
    return np.asarray(bound)


def leading_pairs(T: ComplexArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """All singular values (descending) and vectors of a stack of a few matrices: s (N, r), U (N, p, r), V (N, m, r)."""
    wide = T.shape[1] <= T.shape[2]
    gram = T @ T.conj().swapaxes(1, 2) if wide else T.conj().swapaxes(1, 2) @ T
    values, vectors = _eigh(gram)
    s = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    first = vectors[:, :, ::-1]
    other = (T.conj().swapaxes(1, 2) if wide else T) @ first / np.maximum(s, 1e-300)[:, None, :]
    return s, (first if wide else other), (other if wide else first)


def _small_gram(T: ComplexArray) -> ComplexArray:
    if T.shape[1] > T.shape[2]:
        return np.asarray(T.conj().swapaxes(1, 2) @ T)
    return np.asarray(T @ T.conj().swapaxes(1, 2))
