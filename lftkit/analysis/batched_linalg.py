"""Linear algebra on stacks of small matrices.

The one module of the library that uses ``numpy.linalg``: its routines run over a stack (N, p, p) inside LAPACK
loops written in C, which ``scipy.linalg`` does in Python only. At a thousand frequencies that is a factor of a hundred.
"""

from __future__ import annotations

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray


def solve(M: ComplexArray, X: ComplexArray) -> ComplexArray:
    """Solutions of ``M[i] Y[i] = X[i]``, shapes (N, k, k) and (N, k, m)."""
    if M.shape[1] == 1:
        return np.asarray(X / M)
    if M.shape[1] == 2:
        a, b, c, d = M[:, 0, :1], M[:, 0, 1:], M[:, 1, :1], M[:, 1, 1:]
        Y = np.empty((len(M), 2, X.shape[2]), dtype=complex)
        determinant = a * d - b * c
        Y[:, 0] = (d * X[:, 0] - b * X[:, 1]) / determinant
        Y[:, 1] = (a * X[:, 1] - c * X[:, 0]) / determinant
        return Y
    return np.asarray(np.linalg.solve(M, X))


def inverses(M: ComplexArray) -> ComplexArray:
    """Inverse of each matrix of the stack `M` (N, k, k)."""
    return np.asarray(np.linalg.inv(M))


def determinants(M: ComplexArray) -> ComplexArray:
    """Determinant of each matrix of the stack `M` (N, k, k)."""
    if M.shape[1] == 2:
        return np.asarray(M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0], dtype=complex)
    return np.asarray(np.linalg.det(M), dtype=complex)


def eigenvalues(M: ComplexArray) -> ComplexArray:
    """Eigenvalues of each matrix of the stack `M` (N, k, k): shape (N, k)."""
    return np.asarray(np.linalg.eigvals(M), dtype=complex)


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
    return np.asarray(np.sqrt(largest_eigenvalues(_small_gram(T))))


def largest_eigenvalues(M: ComplexArray) -> FloatArray:
    """Largest eigenvalue, 0 at least, of each Hermitian matrix of the stack `M` (N, k, k)."""
    k = M.shape[1]
    if k == 0:
        return np.zeros(len(M))
    if k == 1:
        return np.asarray(np.maximum(M[:, 0, 0].real, 0.0))
    if k == 2:
        half, middle = 0.5 * (M[:, 0, 0] - M[:, 1, 1]).real, 0.5 * (M[:, 0, 0] + M[:, 1, 1]).real
        return np.asarray(np.maximum(middle + np.hypot(half, np.abs(M[:, 0, 1])), 0.0))
    return np.asarray(np.maximum(np.linalg.eigvalsh(M)[:, -1], 0.0))


def singular_values(T: ComplexArray) -> FloatArray:
    """All singular values of each matrix of the stack `T` (N, p, m), largest first: shape (N, min(p, m))."""
    return np.asarray(np.linalg.svd(T, compute_uv=False))


def singular_triples(T: ComplexArray) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """U (N, p, k), singular values (N, k) and Vh (N, k, m) of each matrix of the stack `T` (N, p, m), k = min(p, m)."""
    U, values, Vh = np.linalg.svd(T, full_matrices=False)
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
    wide, adjoint = T.shape[1] <= T.shape[2], T.conj().swapaxes(1, 2)
    gram = T @ adjoint if wide else adjoint @ T
    values, vectors = _eigh_of_two(gram) if gram.shape[1] == 2 else np.linalg.eigh(gram)
    s = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    first = vectors[:, :, ::-1]
    other = (adjoint if wide else T) @ first / np.maximum(s, 1e-300)[:, None, :]
    return s, (first if wide else other), (other if wide else first)


def smooth_gains(T: ComplexArray, power: float) -> FloatArray:
    """Largest singular value of each matrix of the stack `T`, or of more than two a norm of them that is smooth.

    The norm is that of the power ``2q`` with q the smallest power of two for which ``2q`` is at least `power`. It is at
    most ``k^(1 / 2q)`` times the largest of k singular values.

    Examples
    --------
    >>> T = np.diag([3.0, 2.0, 1.0])[None].astype(complex)
    >>> round(smooth_gains(T, 2.0).item() ** 2, 9), largest_gains(T).tolist()
    (14.0, [3.0])
    """
    if power == np.inf or min(T.shape[1:]) <= 2 or len(T) == 0:
        return largest_gains(T)
    gram = _small_gram(T)
    log, q = np.zeros(len(gram)), 1
    while True:
        trace = np.maximum(np.trace(gram, axis1=1, axis2=2).real, 1e-300)
        log += np.log(trace) / q
        if 2 * q >= power:
            return np.asarray(np.exp(0.5 * log))
        gram = gram / trace[:, None, None]
        gram, q = gram @ gram, 2 * q


def smooth_slopes(T: ComplexArray, power: float) -> ComplexArray:
    """``Y`` (N, p, m) with ``ds = Re trace(Y^H dT)`` of each value of :func:`smooth_gains` of more than two."""
    gram = _small_gram(T)
    product, q = None, 1
    base, size = gram, smooth_gains(T, power)
    while 2 * q < power:
        gram = gram / np.maximum(np.trace(gram, axis1=1, axis2=2).real, 1e-300)[:, None, None]
        product = gram if product is None else product @ gram
        gram, q = gram @ gram, 2 * q
        product = product / np.maximum(np.trace(product, axis1=1, axis2=2).real, 1e-300)[:, None, None]
    if product is None:
        product = np.broadcast_to(np.eye(base.shape[1], dtype=complex), base.shape)
    weight = np.maximum(np.sum(product * base.swapaxes(1, 2), axis=(1, 2)).real, 1e-300)
    product = product * (size / weight)[:, None, None]
    return np.asarray(T @ product if T.shape[1] > T.shape[2] else product @ T)


def _eigh_of_two(gram: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Eigenvalues, ascending, and eigenvectors of Hermitian 2 x 2 matrices."""
    first, second = gram[:, 0, 0].real, gram[:, 1, 1].real
    across = gram[:, 0, 1]
    half, middle = 0.5 * (first - second), 0.5 * (first + second)
    root = np.hypot(half, np.abs(across))
    left = np.where(half >= 0.0, root + half + 0j, across)
    right = np.where(half >= 0.0, across.conj(), root - half + 0j)
    left = np.where(root == 0.0, 1.0, left)
    size = np.sqrt(np.abs(left) ** 2 + np.abs(right) ** 2)
    left, right = left / size, right / size
    vectors = np.empty(gram.shape, dtype=complex)
    vectors[:, 0, 0], vectors[:, 1, 0] = -right.conj(), left.conj()
    vectors[:, 0, 1], vectors[:, 1, 1] = left, right
    return np.stack([middle - root, middle + root], axis=1), vectors


def _small_gram(T: ComplexArray) -> ComplexArray:
    if T.shape[1] > T.shape[2]:
        return np.asarray(T.conj().swapaxes(1, 2) @ T)
    return np.asarray(T @ T.conj().swapaxes(1, 2))
