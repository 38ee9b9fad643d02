"""Normalised coprime factors: a system, stable or not, as the quotient of two stable ones."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.analysis.riccati import riccati
from lftkit.arrays import Matrices
from lftkit.errors import InputError


def right_coprime_factors(plant: Matrices, name: str = "system") -> Matrices:
    """``[N; M]`` of ``G = N M^-1`` with ``N~N + M~M = 1``, in continuous time.

    The transposes of those of ``G'`` are the left ones. Source: Vidyasagar, IEEE TAC 33 (1988).

    Parameters
    ----------
    plant : tuple of ndarray
        A (n, n), B (n, m), C (p, n), D (p, m) of G.
    name : str
        For messages.

    Returns
    -------
    tuple of ndarray
        Matrices of ``[N; M]``, n states, m inputs, p + m outputs.

    Raises
    ------
    ValueError
        A mode that is not stable and not reached or not seen.

    Examples
    --------
    Of ``1 / s`` they are ``1 / (s + 1)`` and ``s / (s + 1)``:

    >>> one = np.eye(1)
    >>> A, B, C, D = right_coprime_factors((0.0 * one, one, one, 0.0 * one))
    >>> A.round(9).tolist(), C.round(9).tolist(), D.tolist()
    ([[-1.0]], [[1.0], [-1.0]], [[0.0], [1.0]])
    """
    A, B, C, D = plant
    S = np.eye(B.shape[1]) + D.T @ D
    X = riccati(A, B, C.T @ C, S, C.T @ D) if len(A) else A
    Y = riccati(A.T, C.T, B @ B.T, np.eye(len(C)) + D @ D.T, B @ D.T) if len(A) else A
    if X is None or Y is None:  # without Y the factors have a common zero that is not stable
        raise InputError(f"{name}: the system must be stabilisable and detectable to rounding, got one that is not")
    F = -linalg.solve(S, D.T @ C + B.T @ X)
    # Symmetric square root of a positive definite matrix
    values, vectors = linalg.eigh(S)
    into = linalg.inv(np.asarray(vectors * np.sqrt(values) @ vectors.T))
    return A + B @ F, B @ into, np.vstack([C + D @ F, F]), np.vstack([D @ into, into])
