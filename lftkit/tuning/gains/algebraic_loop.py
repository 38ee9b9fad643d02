"""Distance of the algebraic loop of controller and plant from being singular.

With a direct path D22 from command to measurement, a pole of the closed loop goes to infinity where ``I - D22 K``
becomes singular. Short of that its state matrix has entries so large that rounding decides on the slow poles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray


@dataclass(frozen=True)
class WellPosedness:
    """The algebraic loop stays away from being singular, a hard requirement: not one that users give."""

    hard: bool = True
    name: str = "distance of the algebraic loop from being singular"


def algebraic_values(
    D22: FloatArray, K: FloatArray, *, least: float = 1e-3, near: float = 0.3
) -> list[tuple[float, FloatArray]]:
    """``least / |eigenvalue|`` of ``I - D22 K`` for the small eigenvalues, with gradients by K.

    Parameters
    ----------
    D22 : ndarray, shape (y, u)
    K : ndarray, shape (u, y)
    least : float
        Magnitude of the eigenvalues that the descents keep: without feedback all are 1.
    near : float
        Values below say nothing to a descent.

    Examples
    --------
    1 - 0.5 K at K = 1.996: the eigenvalue is 0.002, half of the limit.

    >>> (value, gradient), = algebraic_values(np.array([[0.5]]), np.array([[1.996]]))
    >>> round(value, 6), round(gradient.item(), 3)
    (0.5, 125.0)
    """
    if not D22.any():
        return []
    solved: Any = linalg.eig(np.eye(len(D22)) - D22 @ K, left=True, right=True, check_finite=False)
    poles, left, right = solved
    size = np.maximum(np.abs(poles), 1e-300)
    values = []
    for i in np.flatnonzero((least / size > near) & (poles.imag >= 0.0)):
        scale = left[:, i].conj() @ right[:, i]
        slope = -np.outer(D22.T @ left[:, i].conj(), right[:, i]) / (scale if abs(scale) > 1e-14 else 1e-14)
        gradient = -least / size[i] ** 3 * np.real(poles[i].conj() * slope)
        values.append((float(least / size[i]), np.asarray(gradient)))
    return values
