"""A discrete-time system as one in continuous time, where the map loses little.

It is the bilinear map of ``sign z`` (:mod:`lftkit.systems.sampled.bilinear`, with the period 2). The inverse that it
needs is that of ``sign A + I``: well conditioned as long as no pole is near ``z = -sign``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from math import pi
from typing import NamedTuple

import numpy as np

from lftkit.analysis.hinf.direct_gain import response_at
from lftkit.arrays import ComplexArray, Matrices
from lftkit.systems.sampled.bilinear import discrete_point, to_continuous, unwarped_frequency

MAX_CONDITION = 1e4  # of the matrix that is inverted


class HalfPlane(NamedTuple):
    """The mapped system, the one that was given, and what the map may have lost.

    Parameters
    ----------
    matrices, given : tuple of ndarray
        Shapes (n, n), (n, m), (p, n), (p, m): in continuous and in discrete time.
    sign : float
        1 or -1.
    condition : float
        Of ``sign A + I``, 1-norm: the mapped matrices are exact to so many roundings.
    """

    matrices: Matrices
    given: Matrices
    sign: float
    condition: float

    @classmethod
    def of(cls, system: Matrices) -> Iterator[HalfPlane]:
        """The maps that are well conditioned, first by the sign of the trace.

        The second one is for a peak at ``z = -sign``, which the first one has at infinity.
        """
        A, B, C, D = system
        first, one = 1.0 if A.trace() >= 0.0 else -1.0, np.eye(len(A))
        for sign in (first, -first):
            with suppress(ValueError):
                mapped = to_continuous(A * sign, B * sign, C, D, rcond=0.0)
                shifted, inverse = A * sign + one, 0.5 * (one - mapped[0])
                condition = float(abs(shifted).sum(axis=0).max() * abs(inverse).sum(axis=0).max())
                if condition <= MAX_CONDITION:
                    yield cls(mapped, system, sign, condition)

    def angle(self, omega: float) -> float:
        """Angle on the unit circle [rad] of the frequency `omega` in continuous time."""
        turn = 2.0 * unwarped_frequency(omega)
        return turn if self.sign > 0.0 else pi - turn

    def response(self, omega: float) -> ComplexArray:
        """Response (p, m) of the matrices that were given, at the point of the circle of `omega`."""
        return response_at(self.given, self.sign * (-1.0 if omega == np.inf else discrete_point(1j * omega)))
