"""The gain that no controller changes, at single points: a lower bound of the H-infinity norm of all loops.

At a point s of the imaginary axis a loop has the gain ``P11 + P12 R P21`` with any R. What is left of P11 between the
errors that P12 does not reach and the disturbances, and between the errors and the disturbances that P21 does not see,
is there for every R. A stable loop has no larger gain to the right of the axis than on it, so that zeros there count,
too: ``W S`` is W at a zero of the plant.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.analysis.hinf.direct_gain import response_at
from lftkit.analysis.zeros import zeros_of
from lftkit.arrays import ComplexArray
from lftkit.synthesis.extended_plant import ExtendedPlant

FREQUENCIES = 0.0, *np.logspace(-6.0, 6.0, 121).tolist(), np.inf
"""Over the norm of A."""
ROUNDING = 1e-11
"""Part of the gain of the plant without a controller that its rounding may make out of reach."""
POLE = 1e-5
"""Distance of a point from the poles, over the norm of A."""
ZERO = 1e-6
"""Gain at a zero, relative to that on the axis beside it; distance of zeros from the axis, relative to their size."""
EPS = float(np.finfo(float).eps)

Responses = tuple[ComplexArray, ComplexArray, ComplexArray]
"""From disturbances to errors, from commands to errors, and from disturbances to measurements."""


def gain_out_of_reach(plant: ExtendedPlant) -> float:
    """Largest one over the imaginary axis and the zeros to the right of it, of a plant in continuous time."""
    P = plant
    rate = float(linalg.norm(P.A)) if P.A.any() else 1.0
    poles = linalg.eigvals(P.A) if len(P.A) else np.zeros(0)

    def apart(point: complex) -> bool:
        """Not at a pole, where responses are rounding; a mode that is not reached or seen is a zero, too."""
        return bool(np.abs(poles - point).min(initial=np.inf) > POLE * rate)

    axis = [_out_of_reach(P, point) for point in (1j * rate * omega for omega in FREQUENCIES) if apart(point)]
    zeros = [*zeros_of(P.A, P.B2, P.C1, P.D12), *zeros_of(P.A, P.B1, P.C2, P.D21)]
    right = [_out_of_reach(P, zero, abs(zero)) for zero in zeros if zero.real > ZERO * abs(zero) and apart(zero)]
    return max([0.0, *axis, *right])


def _out_of_reach(plant: ExtendedPlant, point: complex, beside: float | None = None) -> float:
    """At a point; at a zero there are directions with next to no gain beside that at the frequency `beside`."""
    try:
        P11, P12, P21 = _responses(plant, point)
        _, near12, near21 = (P11, P12, P21) if beside is None else _responses(plant, 1j * beside)
    except linalg.LinAlgError:  # a pole
        return 0.0
    left = _null(P12.conj().T, near12) @ P11, (_null(P21, near21) @ P11.conj().T).conj().T
    rounding = ROUNDING * float(linalg.norm(P11))
    return max([0.0, *(float(linalg.norm(part, 2)) - rounding for part in left if part.size)])


def _responses(plant: ExtendedPlant, point: complex) -> Responses:
    P, nw, nz = plant, plant.B1.shape[1], len(plant.C1)
    D = np.block([[P.D11, P.D12], [P.D21, P.D22]])
    M = np.asarray(D, complex)
    if np.isfinite(point) and len(P.A):
        M = response_at((P.A, np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2]), D), point)
    return M[:nz, :nw], M[:nz, nw:], M[nz:, :nw]


def _null(M: ComplexArray, near: ComplexArray) -> ComplexArray:
    """Orthonormal rows v with ``M v* = 0``, as far as rounding and the gains `near` tell."""
    _, sizes, V = linalg.svd(M)
    least = float(linalg.svdvals(near).min(initial=np.inf))
    rank = np.count_nonzero((sizes > EPS * max(M.shape) * sizes.max(initial=0.0)) & (sizes > ZERO * least))
    return np.asarray(V[rank:], complex)
