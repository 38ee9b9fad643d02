"""Real matrices with a bound of every entry's error, and positive definiteness of a matrix that is known so.

Nothing that LAPACK returns is trusted. Roundings that are granted to numpy, with their sources, are the table of
``docs/certificates_mathematics.md``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.proof import ComplexArray, FloatArray

UNIT = 2.0**-53
INFLATE = 1.0 + 1e-6  # covers the rounding of the bounds themselves
TINY = 1e-290  # covers what gets too small


class Ball:
    """Real matrix with an elementwise bound of its error; an ArithmeticError where a number is not finite."""

    def __init__(self, mid: FloatArray, rad: FloatArray | None = None) -> None:
        self.mid = mid
        self.rad = np.zeros_like(mid) if rad is None else rad
        if not (np.isfinite(self.mid).all() and np.isfinite(self.rad).all()):
            raise ArithmeticError("numbers must be finite")

    def __matmul__(self, other: Ball) -> Ball:
        a, b = np.abs(self.mid), np.abs(other.mid)
        k = self.mid.shape[1] + 2
        rad = (k * UNIT / (1.0 - k * UNIT)) * (a @ b) + self.rad @ (b + other.rad) + a @ other.rad
        return Ball(self.mid @ other.mid, INFLATE * rad + TINY)

    def __add__(self, other: Ball) -> Ball:
        mid = self.mid + other.mid
        return Ball(mid, INFLATE * (self.rad + other.rad + UNIT * np.abs(mid)))

    def __neg__(self) -> Ball:
        return Ball(-self.mid, self.rad)

    def __sub__(self, other: Ball) -> Ball:
        return self + (-other)

    def transposed(self) -> Ball:
        """Transpose."""
        return Ball(self.mid.T, self.rad.T)

    def times(self, factor: Ball) -> Ball:
        """Product with a scalar, given as a 1 x 1 ball."""
        f, r = float(factor.mid[0, 0]), float(factor.rad[0, 0])
        mid = f * self.mid
        rad = UNIT * np.abs(mid) + abs(f) * self.rad + r * (np.abs(self.mid) + self.rad)
        return Ball(mid, INFLATE * rad + TINY)


def scalar(value: float) -> Ball:
    """Exact scalar."""
    return Ball(np.array([[float(value)]]))


def exact_product(*factors: FloatArray) -> Ball:
    """Product of matrices, every entry the exact one rounded once (integers of any length inside)."""
    product: Any = None
    for factor in factors:
        whole = [int(math.ldexp(m, 53)) << (e + 1100) for m, e in map(math.frexp, factor.ravel().tolist())]
        integers = np.array(whole, dtype=object).reshape(factor.shape)
        product = integers if product is None else product @ integers
    denominator = 1 << (1153 * len(factors))
    mid = np.array([value / denominator for value in product.ravel()], dtype=float).reshape(product.shape)
    return Ball(mid, UNIT * np.abs(mid) * INFLATE + TINY)


def embedded(matrix: ComplexArray | FloatArray) -> FloatArray:
    """Complex matrix as a real one of twice the size."""
    real, imag = np.real(matrix), np.imag(matrix)
    return np.block([[real, -imag], [imag, real]])


def hermitian(real: FloatArray, imag: FloatArray) -> FloatArray:
    """Embedded Hermitian matrix of the lower triangles of its parts."""
    lower, strict = np.tril(real), np.tril(imag, -1)
    return embedded(lower + np.tril(real, -1).T + 1j * (strict - strict.T))


def turned(G: FloatArray) -> FloatArray:
    """``j G`` of an embedded matrix."""
    half = len(G) // 2
    return np.vstack([-G[half:], G[:half]])


def positive(matrix: ComplexArray | FloatArray, rest: FloatArray, factor: float = 1.0) -> bool:
    """Whether the Hermitian part, less anything whose entries are below `rest`, is certainly positive definite.

    Any R will do: with ``A = R R* + shift I + E`` the matrix A is positive definite if the norm of E is below `shift`.
    R is about the Cholesky factor of ``A - shift I`` and nobody trusts it: E is computed from it, with a bound of all
    rounding. The condition is written so that a number which is not finite refuses.

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


def definite_ratio(matrix: Ball, enough: float = 2.0**58) -> float:
    """Margin of positive definiteness over the bound of all rounding, as a power of two; 0 if it is not certain.

    No margin above `enough` is looked for.
    """
    n, diagonal = len(matrix.mid), np.diag(matrix.mid)
    if n == 0:
        return math.inf
    if not np.all(diagonal > 0.0):
        return 0.0
    scale = np.exp2(-np.round(0.5 * np.log2(diagonal)))  # powers of two: exact, but for what gets too small
    mid, rad = (part * scale[:, None] * scale for part in (matrix.mid, matrix.rad))
    rad, factor = rad + UNIT * np.abs(mid) + TINY, 1.0
    while factor <= enough and positive(mid, rad, factor):
        factor *= 4.0
    return factor / 4.0 if factor > 1.0 else 0.0
