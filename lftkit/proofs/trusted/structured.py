"""Scalings that bound the structured singular value, and their check.

For every Delta of the structure with norm below 1 / level, ``w = Delta z`` and ``z = M w`` give ``z* D z - level^2 w* D
w >= 0`` and ``Re z* (j G) w = 0`` for each block (G for real scalars alone). If the sum of these forms is negative
definite in w, only w = 0 remains and ``I - M Delta`` is regular (Fan, Tits and Doyle 1991): mu is at most the level.
The sum is checked with the bounds of rounding of :mod:`lftkit.proofs.trusted.arithmetic`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.proofs.trusted.arithmetic import Ball, definite_ratio, embedded, hermitian, scalar, turned
from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL, ComplexArray, FloatArray, ProofError, require


@dataclass(frozen=True)
class UncertaintyBlock:
    """One block of ``Delta``, with ``w = Delta z`` and ``z = M w``.

    Parameters
    ----------
    kind : str
        ``real`` or ``complex`` (a scalar times the identity) or ``full`` (any complex matrix).
    rows, columns : int
        Sizes of w and z; equal for a scalar.

    Raises
    ------
    ValueError
        Another kind, a size below 1, a scalar that is not square.
    """

    kind: str
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.kind not in (REAL, COMPLEX, FULL):
            raise ValueError(f"kind must be real, complex or full, got {self.kind!r}")
        if min(self.rows, self.columns) < 1 or (self.kind != FULL and self.rows != self.columns):
            raise ValueError(
                f"a block must have sizes of 1 at least, equal for a scalar, got {self.rows} x {self.columns}"
            )

    @property
    def scalar(self) -> bool:
        """Whether it has one uncertain number: a full block of 1 x 1 is a complex scalar."""
        return self.kind != FULL or self.rows == self.columns == 1


def parts(structure: Sequence[UncertaintyBlock]) -> Iterator[tuple[UncertaintyBlock, slice, slice]]:
    """Each block with the rows of M (its z) and the columns of M (its w)."""
    z = w = 0
    for block in structure:
        yield block, slice(z, z + block.columns), slice(w, w + block.rows)
        z, w = z + block.columns, w + block.rows


def checked_matrix(M: ComplexArray, structure: Sequence[UncertaintyBlock]) -> ComplexArray:
    """M as a complex matrix.

    Raises
    ------
    ValueError
        No blocks, entries that are not finite, a shape that does not fit the blocks.
    """
    matrix = np.asarray(M, dtype=complex)
    shape = sum(b.columns for b in structure), sum(b.rows for b in structure)
    if not structure or matrix.shape != shape:
        raise ValueError(f"M must have the shape {shape} of its blocks, got {matrix.shape}")
    if not np.all(np.isfinite(matrix)):
        raise ValueError("M must be finite, got entries that are not")
    return matrix


@dataclass(frozen=True)
class MuCertificate:
    """Scalings for a level.

    Parameters
    ----------
    level : float
    D, G : tuple of ndarray
        Of each block, Hermitian (k, k), (1, 1) for a full block; D positive definite, G zero but for real scalars.
    """

    level: float
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]


def check_mu(M: ComplexArray, structure: Sequence[UncertaintyBlock], certificate: MuCertificate) -> float:
    """Verify that mu is at most the level of a certificate; a ProofError says why not.

    Parameters
    ----------
    M : array_like, complex
    structure : sequence of UncertaintyBlock
    certificate : MuCertificate

    Returns
    -------
    float
        Smallest ratio of a margin to the bound of all rounding, 1 at least.

    Raises
    ------
    ProofError
        It does not hold beyond rounding.
    ValueError
        M does not fit the structure.
    """
    matrix = checked_matrix(M, structure)
    own = 0.0 < certificate.level < np.inf and len(certificate.D) == len(certificate.G) == len(structure)
    require(own, "a certificate must have a positive level, and D and G for each block")
    try:
        with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
            worst = _ratio(matrix, structure, certificate)
    except ArithmeticError as error:
        raise ProofError(f"the inequality must be one of finite numbers, got: {error}") from None
    require(worst >= 1.0, "the inequality must hold beyond rounding, got no margin")
    return worst


def _ratio(matrix: ComplexArray, structure: Sequence[UncertaintyBlock], certificate: MuCertificate) -> float:
    """Smallest ratio of the certificate's matrices."""
    width = matrix.shape[1]
    square = scalar(certificate.level) @ scalar(certificate.level)
    total = Ball(np.zeros((2 * width, 2 * width)))
    worst = np.inf
    unit = np.eye(width, dtype=complex)
    for i, (block, z_rows, w_rows) in enumerate(parts(structure)):
        z, w = (Ball(embedded(part)) for part in (matrix[z_rows], unit[w_rows]))
        D, G = (_hermitian(part[i], block, name) for part, name in ((certificate.D, "D"), (certificate.G, "G")))
        require(block.kind == REAL or not np.any(G), "G must be zero for a block that is not real")
        if block.kind == FULL:
            D_z, D_w = (D[0, 0] * np.eye(2 * size) for size in (block.columns, block.rows))
        else:
            D_z = D_w = D
        worst = min(worst, definite_ratio(Ball(D)))
        total = total + (w.transposed() @ (Ball(D_w) @ w)).times(square) - z.transposed() @ (Ball(D_z) @ z)
        if block.kind == REAL:
            mixed = z.transposed() @ (Ball(turned(G)) @ w)
            total = total - (mixed + mixed.transposed())
    return min(worst, definite_ratio(total))


def _hermitian(matrix: ComplexArray, block: UncertaintyBlock, name: str) -> FloatArray:
    """Embedded scaling of a block, made Hermitian from its lower triangle."""
    size = 1 if block.kind == FULL else block.rows
    given = np.asarray(matrix, dtype=complex)
    own = given.shape == (size, size) and np.all(np.isfinite(given))
    require(own, f"{name} of a block must be a finite matrix of size {size}, got another")
    return hermitian(given.real, given.imag)
