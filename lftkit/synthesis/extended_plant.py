"""Matrices of a plant by its groups of ports, and its closed loop with a gain: **u = + K y**."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray


@dataclass(frozen=True)
class ExtendedPlant:
    """Plant with weights folded in, extended by the controller's states.

    Parameters
    ----------
    A, B1, B2, C1, C2 : ndarray
        States (n + n_K), disturbances, (n_K + u), performance outputs, (n_K + y).
    D11, D12, D21, D22 : ndarray
    """

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray
    D11: FloatArray
    D12: FloatArray
    D21: FloatArray
    D22: FloatArray

    @cached_property
    def _through(self) -> bool:
        return bool(self.D22.any())

    def closed(self, K: FloatArray) -> ClosedLoopMatrices:
        """Closed loop with the gain matrix K (n_K + u, n_K + y)."""
        if not self._through:
            left, right = self.B2 @ K, K @ self.C2
            return ClosedLoopMatrices(
                self.A + left @ self.C2,
                self.B1 + left @ self.D21,
                self.C1 + self.D12 @ right,
                self.D11 + self.D12 @ (K @ self.D21),
                self.B2,
                self.D12,
                self.C2,
                self.D21,
            )
        inner = loop_inverse(np.eye(K.shape[1]) - self.D22 @ K)
        KS = K @ inner
        left = self.B2 + self.B2 @ KS @ self.D22  # B2 (I - K D22)^-1
        left_z = self.D12 + self.D12 @ KS @ self.D22
        right, right_w = inner @ self.C2, inner @ self.D21
        return ClosedLoopMatrices(
            self.A + self.B2 @ KS @ self.C2,
            self.B1 + self.B2 @ KS @ self.D21,
            self.C1 + self.D12 @ KS @ self.C2,
            self.D11 + self.D12 @ KS @ self.D21,
            left,
            left_z,
            right,
            right_w,
        )


@dataclass(frozen=True)
class ClosedLoopMatrices:
    """Matrices of the closed loop and the factors of their derivatives: ``dA = left dK right`` and so on."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    left: FloatArray
    left_z: FloatArray
    right: FloatArray
    right_w: FloatArray


def loop_inverse(M: FloatArray) -> FloatArray:
    """Inverse of ``I - D22 K``, without a warning where it is nearly singular: the poles of the loop show it.

    Raises
    ------
    LinAlgError
        It is singular.
    """
    factors, pivots, info = linalg.lapack.dgetrf(M)
    if info:
        raise linalg.LinAlgError("the algebraic loop is singular")
    return np.asarray(linalg.lapack.dgetri(factors, pivots)[0])
