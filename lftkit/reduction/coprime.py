"""Reduction of normalised coprime factors: also unstable systems, with a bound that closed loops understand.

Source: McFarlane and Glover, Robust Controller Design Using Normalized Coprime Factor Plant Descriptions (1990);
Meyer, IEEE TAC 35 (1990). Sampled systems go through the bilinear map, which keeps gains and the gap metric.
"""

from __future__ import annotations

from typing import Any

from scipy import linalg

from lftkit.analysis.coprime_factors import right_coprime_factors
from lftkit.errors import InputError
from lftkit.reduction.balanced import ReducedSystem, error_bound
from lftkit.reduction.balancing import balancing
from lftkit.support.scalars import as_integer
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.image import continuous
from lftkit.systems.system import System


@checked
def ncfmr(system: Any, order: int) -> ReducedSystem:
    """System of lower order by balanced truncation of its normalised right coprime factors (ncfmr in MATLAB).

    With ``G = N M^-1`` and ``N~N + M~M = 1`` the stable system ``[N; M]`` is reduced to ``[Nr; Mr]``, which is
    normalised again, and ``Gr = Nr Mr^-1``. The error is at least the gap and the nu-gap between G and Gr. **A
    controller whose margin for G is above the error bound stabilises Gr, too**, and the other way round; the margin is
    ``1 / value`` of :func:`lftkit.synthesis.ncfsyn`.

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
        G: certain, continuous or sampled, stable or not, stabilisable and detectable.
    order : int
        At most this number of states.

    Returns
    -------
    ReducedSystem
        `hankel_values` and `error_bound` are those of the coprime factors.

    Raises
    ------
    ValueError
        A negative order; a mode that is not stable and not reached or not seen.

    Examples
    --------
    A double integrator with a fast lag:

    >>> from lftkit import s
    >>> found = ncfmr((1 / (s**2 * (0.01 * s + 1))).system("u", "y"), 2)
    >>> found.system.order, bool(found.error_bound < 0.02)
    (2, True)
    """
    given = as_system(system)
    number = as_integer(order, "order")
    if number < 0:
        raise InputError(f"order must be at least 0, got {number}")
    A, B, C, D = continuous(given).matrices
    factors = right_coprime_factors((A, B, C, D), given.name)
    found = balancing(*factors[:3])
    kept = min(number, found.order)
    if kept >= given.order:
        return ReducedSystem(given, found.hankel, 0.0, 0.0)
    reduced = (*found.coordinates(*factors[:3], kept), factors[3])
    ports = given.inputs, (Port("factors", sum(D.shape)),)
    error = System(*factors, *ports) - System(*reduced, *ports)
    tail = 2.0 * float(found.hankel[kept:].sum())
    a, b, c, d = reduced
    drive, feedback, seen = linalg.solve(d[len(C) :].T, b.T).T, c[len(C) :], c[: len(C)]
    matrices = a - drive @ feedback, drive, seen - D @ feedback, D
    if given.dt:
        matrices = to_discrete(*matrices, given.dt)
    lower = System(*matrices, given.inputs, given.outputs, given.name, given.dt)
    return ReducedSystem(lower, found.hankel, error_bound(error, tail), tail)
