"""Nyquist curves of the implemented loop, broken at the mirror's commands or at the forces, the other loop closed.

Of the sensitivity S at the commands of one port the open loop there is ``L = S^-1 - I``; the critical point of its
eigenvalues is -1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from lftkit.analysis.batched_linalg import eigenvalues, largest_gains, solve
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop
from titop_plant.interface import FORCE_STAGES, FORCES, MIRROR

POINTS = 500
"""Frequencies, beside those at the telescope's modes."""

_SIDE = np.geomspace(1e-4, 2e-2, 12)
AT_MODES: FloatArray = np.concatenate([-_SIDE[::-1], [0.0], _SIDE])
"""Relative distances of frequencies around each mode, which is narrower than the steps of the grid."""

AT_ONCE = 64
"""Frequencies whose matrices of the whole loop are held at a time: they stay in the cache."""

FROM, TO = 1.0, 1000.0
"""Range of modes [rad/s]."""


@dataclass(frozen=True)
class BrokenLoop:
    """The loop broken at the commands of one port.

    Parameters
    ----------
    place : {"mirror", "forces"}
    omega : ndarray, shape (N,)
        rad/s.
    loci : ndarray, complex, shape (N, k)
        Eigenvalues of the open loop; each column is one curve.
    sensitivity : ndarray, shape (N,)
        Largest singular value of the sensitivity.
    """

    place: str
    omega: FloatArray
    loci: ComplexArray
    sensitivity: FloatArray


def broken_loops(loop: ImplementedLoop, point: FloatArray) -> tuple[BrokenLoop, ...]:
    """The loop at a point of the unit cube, shape (7,), broken at the mirror, and at the forces where they act."""
    modes = loop.open.modes(point, FROM, TO)
    around = np.concatenate([modes * (1.0 + offset) for offset in AT_MODES])
    omega = np.union1d(np.geomspace(LOWEST, HIGHEST, POINTS), around)
    starts = range(0, max(1, len(omega) - AT_ONCE // 2), AT_ONCE)
    parts = (omega[k : k + AT_ONCE] if k != starts[-1] else omega[k:] for k in starts)
    S = np.concatenate([loop.sensitivities(closed, point[None]) for part in parts for closed in loop.at_each(part)])
    places = {"mirror": MIRROR, **({"forces": FORCES} if loop.stage in FORCE_STAGES else {})}
    return tuple(_broken(place, omega, S[:, channels, channels]) for place, channels in places.items())


def _broken(place: str, omega: FloatArray, S: ComplexArray) -> BrokenLoop:
    unit = np.eye(S.shape[1], dtype=complex)
    loci = eigenvalues(solve(S, np.broadcast_to(unit, S.shape)) - unit)
    # Eigenvalues (N, k) in an order in which each column is one curve: by the nearest one of the frequency
    # before
    distances = np.abs(loci[:-1, :, None] - loci[1:, None, :])
    following = np.argmin(distances, axis=2)
    # where two are nearest to one, the least sum of distances
    for k in np.flatnonzero((np.sort(following, axis=1) != np.arange(loci.shape[1])).any(axis=1)):
        following[k] = linear_sum_assignment(distances[k])[1]
    order, found = np.arange(loci.shape[1]), loci.copy()
    for k, step in enumerate(following):
        order = step[order]
        found[k + 1] = loci[k + 1, order]
    return BrokenLoop(place, omega, found, largest_gains(S))


__all__ = ["BrokenLoop", "broken_loops"]
