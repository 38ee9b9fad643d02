"""Scalings that bound the structured singular value, and their check, which optimises nothing.

For every Delta of the structure with norm below 1 / level, ``w = Delta z`` and ``z = M w`` give ``z* D z - level^2 w* D
w >= 0`` and ``Re z* (j G) w = 0`` for each block (G for real scalars alone). If the sum of these forms is negative
definite in w, only w = 0 remains and ``I - M Delta`` is regular (Fan, Tits and Doyle 1991): mu is at most the level.
The sum is checked with the bounds of rounding of :mod:`lftkit.proofs.state_space.checker`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.blocks.structure import FULL, REAL, UncertaintyBlock, checked_matrix, parts
from lftkit.proofs.state_space.checker import Ball, definite_ratio, embedded, scalar
from lftkit.proofs.trusted.proof import ProofError


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
    if not (0.0 < certificate.level < np.inf and len(certificate.D) == len(certificate.G) == len(structure)):
        raise ProofError("a certificate must have a positive level, and D and G for each block")
    try:
        with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
            worst = _ratio(matrix, structure, certificate)
    except ArithmeticError as error:
        raise ProofError(f"the inequality must be one of finite numbers, got: {error}") from None
    if not worst >= 1.0:
        raise ProofError("the inequality must hold beyond rounding, got no margin")
    return worst


def _ratio(matrix: ComplexArray, structure: Sequence[UncertaintyBlock], certificate: MuCertificate) -> float:
    """Smallest ratio of the certificate's matrices."""
    width = matrix.shape[1]
    square = scalar(certificate.level) @ scalar(certificate.level)
    total = Ball(np.zeros((2 * width, 2 * width)))
    worst = np.inf
    unit = np.eye(width, dtype=complex)
    for i, (block, z_rows, w_rows) in enumerate(parts(structure)):
        z, w = (_embedded(part) for part in (matrix[z_rows], unit[w_rows]))
        D, G = (_hermitian(part[i], block, name) for part, name in ((certificate.D, "D"), (certificate.G, "G")))
        if block.kind != REAL and np.any(G):
            raise ProofError("G must be zero for a block that is not real")
        if block.kind == FULL:
            D_z, D_w = (D[0, 0] * np.eye(2 * size) for size in (block.columns, block.rows))
        else:
            D_z = D_w = D
        k = len(G) // 2
        turned = np.vstack([-G[k:], G[:k]])  # j G
        worst = min(worst, definite_ratio(Ball(D)))
        total = total + (w.transposed() @ (Ball(D_w) @ w)).times(square) - z.transposed() @ (Ball(D_z) @ z)
        if block.kind == REAL:
            mixed = z.transposed() @ (Ball(turned) @ w)
            total = total - (mixed + mixed.transposed())
    return min(worst, definite_ratio(total))


def _embedded(part: ComplexArray) -> Ball:
    return Ball(embedded(part.real, part.imag))


def _hermitian(matrix: ComplexArray, block: UncertaintyBlock, name: str) -> FloatArray:
    """Embedded scaling of a block, made Hermitian from its lower triangle."""
    size = 1 if block.kind == FULL else block.rows
    given = np.asarray(matrix, dtype=complex)
    if given.shape != (size, size) or not np.all(np.isfinite(given)):
        raise ProofError(f"{name} of a block must be a finite matrix of size {size}, got another")
    lower = np.tril(given, -1)
    return embedded(np.diag(np.diag(given).real) + (lower + lower.conj().T).real, (lower + lower.conj().T).imag)
