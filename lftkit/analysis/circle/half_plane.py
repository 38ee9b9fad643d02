"""A discrete-time system as one in continuous time, where the map loses little.

``s = (z - sign) / (z + sign)`` takes the unit circle to the imaginary axis. The inverse that it needs is that of
``sign A + I``: well conditioned as long as no pole is near ``z = -sign``.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan, pi
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from lftkit.arrays import ComplexArray, FloatArray, Matrices

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
        first = 1.0 if system[0].trace() >= 0.0 else -1.0
        for sign in (first, -first):
            if plane := _mapped(system, sign):
                yield plane

    def angle(self, omega: float) -> float:
        """Angle on the unit circle [rad] of the frequency `omega` in continuous time."""
        turn = 2.0 * atan(omega)
        return turn if self.sign > 0.0 else pi - turn

    def response(self, omega: float) -> ComplexArray:
        """Response (p, m) of the matrices that were given, at the point of the circle of `omega`."""
        A, B, C, D = self.given
        z = complex(-self.sign) if omega == np.inf else self.sign * (1.0 + 1j * omega) / (1.0 - 1j * omega)
        shifted = np.multiply(A, -1.0 + 0.0j, order="F")
        shifted.flat[:: len(A) + 1] += z
        return np.asarray(C @ lapack.zgesv(shifted, B, overwrite_a=1)[2] + D)


def _mapped(system: Matrices, sign: float) -> HalfPlane | None:
    A, B, C, D = system
    n = len(A)
    shifted = A * sign
    shifted.flat[:: n + 1] += 1.0
    identity: FloatArray = np.zeros((n, n), order="F")
    identity.flat[:: n + 1] = 1.0
    inverse, info = lapack.dgesv(shifted, identity)[2:]
    if info:
        return None
    condition = float(abs(shifted).sum(axis=0).max() * abs(inverse).sum(axis=0).max())
    if not condition <= MAX_CONDITION:
        return None
    own = inverse * -2.0
    own.flat[:: n + 1] += 1.0
    driven = inverse @ B
    mapped = own, driven * (2.0 * sign), C @ inverse, D - (C @ driven) * sign
    return HalfPlane(mapped, system, sign, condition)
