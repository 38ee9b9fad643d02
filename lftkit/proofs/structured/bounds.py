"""The structured singular value of a matrix, from both sides: upper bounds by D and G scalings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.proofs.blocks.lower import SETTINGS, PerturbationSettings, lower_bound
from lftkit.proofs.blocks.structure import balanced_matrix
from lftkit.proofs.state_space.barrier import BarrierBlock
from lftkit.proofs.state_space.scaling_search import find_scalings
from lftkit.proofs.trusted.proof import FULL, REAL, ProofError
from lftkit.proofs.trusted.structured import MuCertificate, UncertaintyBlock, check_mu, checked_matrix, parts
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked


@dataclass(frozen=True)
class MuBounds:
    """Bounds of the structured singular value.

    Parameters
    ----------
    lower : float
        One over the norm of `perturbation`; zero where none was found.
    upper : float
        Proven by `certificate`, to 1e-9 of the norm of M at best.
    perturbation : ndarray, complex, or None
        Delta of the structure, shape of M transposed, with which ``I - M Delta`` is singular: to 1e-10 once the blocks
        of M are balanced, which changes neither the structure nor Delta.
    certificate : MuCertificate or None
        For :func:`check_mu`; None where M is zero.
    """

    lower: float
    upper: float
    perturbation: ComplexArray | None
    certificate: MuCertificate | None


@checked
def mu(
    M: ArrayLike,
    structure: Sequence[UncertaintyBlock],
    *,
    rtol: float = 1e-4,
    starts: int = 8,
    seed: int = 0,
    settings: PerturbationSettings = SETTINGS,
) -> MuBounds:
    """Structured singular value ``1 / min {norm(Delta): I - M Delta singular}`` (mussv of the Robust Control Toolbox).

    Parameters
    ----------
    M : array_like, complex, shape (rows of all z, rows of all w)
        ``z = M w`` and ``w = Delta z``.
    structure : sequence of UncertaintyBlock
        Of :func:`real_block`, :func:`complex_block` and :func:`full_block`, in the order of the rows of M.
    rtol : float
        Relative precision of the upper bound.
    starts : int
        Vectors from which perturbations are searched, as long as the bounds differ by more than `rtol`.
    seed : int
        Of these.
    settings : PerturbationSettings
        Numbers of both bounds.

    Returns
    -------
    MuBounds
        The distance of the bounds is not under control: with real scalars it may be large. The upper bound is that of
        D and G scalings (Fan, Tits and Doyle 1991).

    Raises
    ------
    ValueError
        M does not fit the structure, is not finite; a precision or a number of starts that is not positive.

    Examples
    --------
    The value lies between spectral radius (one repeated scalar) and norm (one full block):

    >>> M = [[2.0, 2.0], [-1.0, -1.0]]
    >>> from lftkit.proofs import complex_block, full_block, mu
    >>> for structure in [complex_block(2)], [complex_block(), complex_block()], [full_block(2)]:
    ...     bounds = mu(M, structure)
    ...     print(round(bounds.lower, 3), round(bounds.upper, 3))
    1.0 1.0
    3.0 3.0
    3.162 3.162
    """
    if not rtol > 0.0 or starts < 1:
        raise InputError(f"rtol and starts must be positive, got {rtol} and {starts}")
    matrix = checked_matrix(M, structure)  # type: ignore[arg-type]
    with one_thread():
        balanced = balanced_matrix(matrix, structure)[0]
        lower, perturbation = lower_bound(balanced, structure, starts=1, seed=seed, settings=settings)
        upper, certificate = upper_bound(matrix, structure, lower, rtol, settings)
        enough = upper / (1.0 + rtol)
        if starts > 1 and lower < enough:
            lower, perturbation = lower_bound(
                balanced, structure, starts=starts, seed=seed, enough=enough, settings=settings
            )
    return MuBounds(lower, upper, perturbation, certificate)


def upper_bound(
    M: ComplexArray,
    structure: Sequence[UncertaintyBlock],
    lower: float,
    rtol: float,
    settings: PerturbationSettings = SETTINGS,
) -> tuple[float, MuCertificate | None]:
    """Least level that scalings prove, to `rtol`, and their certificate, which passes :func:`check_mu`.

    Parameters
    ----------
    M : ndarray, complex
    structure : sequence of UncertaintyBlock
    lower : float
        A lower bound of mu.
    rtol : float
    settings : PerturbationSettings

    Returns
    -------
    tuple of float and MuCertificate or None
        None where M is zero: then mu is zero.
    """
    norm = float(linalg.norm(M, 2)) if M.size else 0.0
    if norm == 0.0:
        return 0.0, None
    scaling = _Scaling(M, structure)
    level, best = scaling.plain()
    no = max(lower, settings.least * norm) / (1.0 + rtol)
    for _ in range(settings.levels):
        if level <= no * (1.0 + rtol) ** 2:
            break
        middle = math.sqrt(level * no)
        certificate = scaling.certificate(middle, 1e-2 * rtol)
        if certificate is None:
            no = middle
        else:
            level, best = certificate.level, certificate
    return best.level, best


class _Scaling:
    """Scalings of one matrix, whose blocks are balanced first."""

    def __init__(self, M: ComplexArray, structure: Sequence[UncertaintyBlock]) -> None:
        self.M, self.structure, self.parts = M, structure, list(parts(structure))
        self.balanced, self.scale = balanced_matrix(M, structure)

    def plain(self) -> tuple[float, MuCertificate]:
        """The norm of the balanced matrix, a little raised so that it passes the check."""
        D = tuple(
            s * s * np.eye(1 if b.kind == FULL else b.rows, dtype=complex) for b, s in zip(self.structure, self.scale)
        )
        G = tuple(0.0 * d for d in D)
        level = float(linalg.norm(self.balanced, 2))
        for part in 1e-12, 1e-9, 1e-6, 1e-3:
            certificate = MuCertificate(level * (1.0 + part), D, G)
            if self._passes(certificate):
                return certificate.level, certificate
        raise ProofError("the norm must be proven with scalings of one, got no margin")

    def certificate(self, level: float, precision: float) -> MuCertificate | None:
        """Scalings for a level, or for less where they prove less; None if none were found."""
        unit = np.eye(self.M.shape[1], dtype=complex)
        blocks = [BarrierBlock(b.kind, self.balanced[z] / level, unit[w]) for b, z, w in self.parts]
        scalings = find_scalings(blocks, iterations=200, precision=precision)
        if not scalings.margin > 0.0:
            return None
        D = tuple(s * s * _hermitian(d) for d, s in zip(scalings.D, self.scale))
        G = tuple(0.5 * level * s * s * _hermitian(g) for g, s in zip(scalings.G, self.scale))
        certificate = MuCertificate(level, D, G)
        return self._lowered(certificate) if self._passes(certificate) else None

    def _passes(self, certificate: MuCertificate) -> bool:
        try:
            return check_mu(self.M, self.structure, certificate) >= 1.0
        except ProofError:
            return False

    def _lowered(self, certificate: MuCertificate) -> MuCertificate:
        """The lowest level that the same scalings prove."""
        # The forms of which ``G - level^2 D`` is the inequality, (N, N)
        width = self.M.shape[1]
        unit = np.eye(width, dtype=complex)
        D: ComplexArray = np.zeros((width, width), complex)
        rest: ComplexArray = np.zeros((width, width), complex)
        for (block, z_rows, w_rows), d, g in zip(self.parts, certificate.D, certificate.G):
            z, w = self.M[z_rows], unit[w_rows]
            if block.kind == FULL:
                D += d[0, 0].real * w.conj().T @ w
                rest += d[0, 0].real * z.conj().T @ z
                continue
            D += w.conj().T @ d @ w
            rest += z.conj().T @ d @ z
            if block.kind == REAL:
                mixed = z.conj().T @ (1j * g) @ w
                rest += mixed + mixed.conj().T
        D, G = _hermitian(D), _hermitian(rest)
        factor, info = linalg.lapack.zpotrf(D, lower=1)
        if info:
            return certificate
        half = linalg.solve_triangular(factor, G, lower=True)
        largest = float(linalg.eigvalsh(linalg.solve_triangular(factor, half.conj().T, lower=True))[-1])
        for part in 1e-10, 1e-8, 1e-6:
            level = math.sqrt(max(largest, 0.0)) * (1.0 + part)
            lowered = MuCertificate(level, certificate.D, certificate.G)
            if 0.0 < level < certificate.level and self._passes(lowered):
                return lowered
        return certificate


def _hermitian(matrix: ComplexArray) -> ComplexArray:
    return np.asarray(0.5 * (matrix + matrix.conj().T), complex)
