"""The structured singular value of a matrix, from both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.proofs.blocks.balancing import balanced_matrix
from lftkit.proofs.blocks.lower import lower_bound
from lftkit.proofs.structured.upper import upper_bound
from lftkit.proofs.trusted.structured import MuCertificate, UncertaintyBlock, checked_matrix
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
    M: ArrayLike, structure: Sequence[UncertaintyBlock], *, rtol: float = 1e-4, starts: int = 8, seed: int = 0
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
        lower, perturbation = lower_bound(balanced, structure, starts=1, seed=seed)
        upper, certificate = upper_bound(matrix, structure, lower, rtol)
        enough = upper / (1.0 + rtol)
        if starts > 1 and lower < enough:
            lower, perturbation = lower_bound(balanced, structure, starts=starts, seed=seed, enough=enough)
    return MuBounds(lower, upper, perturbation, certificate)
