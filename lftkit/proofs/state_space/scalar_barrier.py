"""The barrier problem of blocks that are not repeated, without a loop over pairs of blocks.

With a = z_i S z_j*, b = z_i S w_j*, c = w_i S z_j* and d = w_i S w_j* the second derivatives are |a|^2 - |b|^2 - |c|^2
+ |d|^2 by D and D, Im(c d* - a b*) by D and G, and Re(a d* - b* c) / 2 by G and G.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.state_space.barrier import FULL, BarrierBlock, BarrierProblem, positive_inverse


class ScalarBarrierProblem(BarrierProblem):
    """As :class:`BarrierProblem`, for repeated scalars that occur once."""

    def __init__(self, blocks: Sequence[BarrierBlock], penalty: float = 0.0) -> None:
        super().__init__(blocks, penalty)
        single = [i for i, block in enumerate(self.blocks) if block.kind != FULL]
        empty = np.zeros((0, self.N), complex)
        self.z = np.vstack([empty, *(self.blocks[i].Z for i in single)])
        self.w = np.vstack([empty, *(self.blocks[i].W for i in single)])
        first, second = ([self.slices[i][k] for i in single] for k in (0, 1))
        self.scaled = np.array([k for k, part in enumerate(first) if part is not None], dtype=int)
        self.turned = np.array([k for k, part in enumerate(second) if part is not None], dtype=int)
        self.of_d = np.array([part.start for part in first if part is not None], dtype=int)
        self.of_g = np.array([part.start for part in second if part is not None], dtype=int)
        full = [i for i, block in enumerate(self.blocks) if block.kind == FULL]
        own = [self.slices[i][0] for i in full]
        self.of_full = np.array([part.start for part in own if part is not None], dtype=int)
        self.full_forms = np.array([self.forms[i] for i in full], dtype=complex).reshape(-1, self.N, self.N)
        self.positive = np.concatenate([self.of_d, self.of_full])

    def sum_of_forms(self, y: FloatArray) -> ComplexArray:
        """Sum of the quadratic forms, (N, N)."""
        D, G = np.zeros(len(self.z)), np.zeros(len(self.z))
        D[self.scaled], G[self.turned] = y[self.of_d], y[self.of_g]
        F = self.z.conj().T @ (D[:, None] * self.z + 1j * G[:, None] * self.w) - self.w.conj().T @ (D[:, None] * self.w)
        F = F + np.tensordot(y[self.of_full], self.full_forms, 1)
        return np.asarray(0.5 * (F + F.conj().T))

    def value(self, y: FloatArray, weight: float) -> float:
        """Objective with barrier; infinite outside."""
        scales = y[self.positive]
        if not np.all(scales > 0.0):
            return np.inf
        factor, info = linalg.lapack.zpotrf(y[0] * np.eye(self.N) - self.sum_of_forms(y), lower=1)
        if info:
            return np.inf
        barrier = 2.0 * float(np.sum(np.log(np.diag(factor).real))) + float(np.sum(np.log(scales)))
        return float(weight * y[0] + 0.5 * float(self.penalty @ y**2) - barrier)

    def derivatives(self, y: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian."""
        S = positive_inverse(y[0] * np.eye(self.N) - self.sum_of_forms(y))
        slope = self._slope(S)
        slope[0] = weight - np.trace(S).real
        square = S @ S
        curvature = np.zeros((self.count, self.count))
        curvature[0] = -self._slope(square)
        curvature[0, 0] = np.trace(square).real
        for number, form in zip(self.of_full, self.full_forms):
            curvature[number, 1:] = self._slope(S @ form @ S)[1:]
        curvature[:, 0] = curvature[0]
        curvature[1:, self.of_full] = curvature[self.of_full, 1:].T
        self._pairs(S, curvature)
        slope[self.positive] -= 1.0 / y[self.positive]
        curvature[self.positive, self.positive] += y[self.positive] ** -2.0
        return slope + self.penalty * y, curvature + np.diag(self.penalty)

    def _slope(self, S: ComplexArray) -> FloatArray:
        """Coefficients of ``y -> trace(S F(y))``; the entry of s is zero."""
        zS, wS = self.z @ S, self.w @ S
        result = np.zeros(self.count)
        squares = (np.sum(zS * self.z.conj(), axis=1) - np.sum(wS * self.w.conj(), axis=1)).real
        result[self.of_d] = squares[self.scaled]
        result[self.of_g] = np.sum(zS * self.w.conj(), axis=1).imag[self.turned]
        result[self.of_full] = np.einsum("ij,kji->k", S, self.full_forms).real
        return result

    def _pairs(self, S: ComplexArray, curvature: FloatArray) -> None:
        zS, wS = self.z @ S, self.w @ S
        a, b = zS @ self.z.conj().T, zS @ self.w.conj().T
        c, d = wS @ self.z.conj().T, wS @ self.w.conj().T
        by_d = np.abs(a) ** 2 - np.abs(b) ** 2 - np.abs(c) ** 2 + np.abs(d) ** 2
        mixed = (c * d.conj() - a * b.conj()).imag
        by_g = 0.5 * (a * d.conj() - b.conj() * c).real
        curvature[np.ix_(self.of_d, self.of_d)] = by_d[np.ix_(self.scaled, self.scaled)]
        curvature[np.ix_(self.of_d, self.of_g)] = mixed[np.ix_(self.scaled, self.turned)]
        curvature[np.ix_(self.of_g, self.of_d)] = mixed[np.ix_(self.scaled, self.turned)].T
        curvature[np.ix_(self.of_g, self.of_g)] = by_g[np.ix_(self.turned, self.turned)]
