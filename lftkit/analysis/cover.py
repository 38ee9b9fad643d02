"""An uncertain system that contains given responses: a nominal one times one plus weighted dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.magnitude_fit import fit_magnitude
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.matrices import frequencies
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement

LEAST = 1e-6
"""Relative error, over the largest one, in the place of a smaller one: a weight has no zeros on the axis."""


@dataclass(frozen=True, eq=False)
class Cover:
    """What :func:`ucover` finds.

    Attributes
    ----------
    system : System
        ``G0 (1 + W delta)`` with the ports of the nominal system.
    weight : System
        W: stable and minimum phase.
    omega : ndarray, shape (N,)
        Frequencies [rad/s].
    envelope : ndarray, shape (N,)
        Largest relative error of the members, ``|Gk / G0 - 1|``, which ``|W|`` is nowhere below at these frequencies.
    """

    system: System
    weight: System
    omega: FloatArray
    envelope: FloatArray


@checked
def ucover(
    members: Sequence[Any] | ArrayLike, nominal: Any, order: int, omega: ArrayLike, *, name: str = "delta"
) -> Cover:
    """Uncertain system that contains given members on a grid (ucover in MATLAB, multiplicative).

    Parameters
    ----------
    members : sequence of System, or array_like of complex, shape (K, N)
        Systems of one input and one output, or their responses at `omega`: for instance measured ones.
    nominal : System, or what :func:`lftkit.as_system` takes
        G0: certain, one input and one output, continuous or sampled.
    order : int
        Of the weight W.
    omega : array_like, shape (N,)
        Frequencies [rad/s], positive, rising; below pi / dt for sampled systems. **Between them nothing is promised**:
        resonances of members need points of their own.
    name : str
        Of the element.

    Raises
    ------
    ValueError
        Shapes that do not fit, responses that are not finite, a nominal response of zero, members that are all the
        nominal one; as for :func:`lftkit.fit_magnitude`.

    Examples
    --------
    A gain from 1.5 to 2.5 around 2, which is 25 % at every frequency:

    >>> from lftkit import s
    >>> lags = [(k / (s + 1)).system("u", "y") for k in (1.5, 1.8, 2.5)]
    >>> found = ucover(lags, (2 / (s + 1)).system("u", "y"), 0, np.geomspace(0.01, 100.0, 20))
    >>> round(found.weight.D.item(), 6), found.system.occurrences()
    (0.25, {'delta': 1})
    """
    G0 = as_system(nominal)
    G0.require_siso()
    w = frequencies(omega)
    responses = _responses(members, w)
    centre = G0.response(w)[:, 0, 0]
    if np.any(centre == 0.0):
        raise InputError(f"{G0.name}: the response must not be zero, got zero at {w[centre == 0.0][0]:g} rad/s")
    envelope = (np.abs(responses - centre) / np.abs(centre)).max(axis=0)
    if not envelope.max() > 0.0:
        raise InputError("members must differ from the nominal system, got equal responses")
    weight = fit_magnitude(w, np.maximum(envelope, LEAST * envelope.max()), order, above=True, dt=G0.dt)
    # G0 (1 + W delta): w = delta z, z = W u, y = G0 (u + w)
    (A, B, C, D), (a, b, c, d) = G0.matrices, weight.matrices
    none, zero = np.zeros((len(a), 1)), np.zeros((1, len(a)))
    return Cover(
        System(
            linalg.block_diag(a, A),
            np.block([[none, b], [B, B]]),
            np.block([[c, np.zeros((1, len(A)))], [zero, C]]),
            np.block([[np.zeros((1, 1)), d], [D, D]]),
            G0.inputs,
            G0.outputs,
            G0.name,
            G0.dt,
            (name,),
            (DynamicElement(name),),
        ),
        weight,
        w,
        envelope,
    )


def _responses(members: Sequence[Any] | ArrayLike, omega: FloatArray) -> ComplexArray:
    """Responses (K, N) of systems, or those that are given."""
    if (
        isinstance(members, Sequence)
        and len(members)
        and not isinstance(members[0], Sequence | np.ndarray | complex | float | np.number)
    ):
        systems = [as_system(one) for one in members]
        for one in systems:
            one.require_siso()
        found = np.array([one.response(omega)[:, 0, 0] for one in systems])
    else:
        try:
            found = np.atleast_2d(np.asarray(members, dtype=complex))
        except (TypeError, ValueError):
            raise InputError(f"members must be systems or their responses, got {type(members).__name__}") from None
    if found.ndim != 2 or found.shape[1] != len(omega) or not found.size:
        raise InputError(f"members must be responses of shape (K, {len(omega)}), got {found.shape}")
    if not np.all(np.isfinite(found)):
        raise InputError("members must have finite responses, got one that is not")
    return found
