"""The barrier problem of few variables and small forms: all second derivatives are one product of matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.state_space.barrier import (
    FULL,
    BarrierBlock,
    BarrierProblem,
    coordinates,
    hermitian_basis,
    positive_inverse,
    products,
)


class DenseBarrierProblem(BarrierProblem):
    """As :class:`BarrierProblem`, with the forms of all variables in one array (variables, N, N)."""

    def __init__(self, blocks: Sequence[BarrierBlock], penalty: float = 0.0) -> None:
        super().__init__(blocks, penalty)
        self.terms = np.zeros((self.count, self.N, self.N), complex)
        self.terms[0] = -np.eye(self.N)
        single, self.repeated = [], []
        for block, own, (first, second) in zip(self.blocks, self.forms, self.slices):
            if first is not None and (block.kind == FULL or len(block.Z) == 1):
                single.append(first.start)
            elif first is not None:
                self.repeated.append((first, len(block.Z)))
            if block.kind == FULL:
                self.terms[first] = own
                continue
            Z, W, E = block.Z, block.W, hermitian_basis(len(block.Z)).T.reshape(-1, len(block.Z), len(block.Z))
            if first is not None:
                self.terms[first] = Z.conj().T @ E @ Z - W.conj().T @ E @ W
            if second is not None:
                half = 0.5j * (Z.conj().T @ E @ W)
                self.terms[second] = half + half.conj().transpose(0, 2, 1)
        self.single = np.array(single, dtype=int)
        self._flat = self.terms.reshape(self.count, -1)

    def sum_of_forms(self, y: FloatArray) -> ComplexArray:
        """Sum of the quadratic forms, (N, N)."""
        return np.asarray((y[1:] @ self._flat[1:]).reshape(self.N, self.N))

    def value(self, y: FloatArray, weight: float) -> float:
        """Objective with barrier; infinite outside."""
        scales = y[self.single]
        if not np.all(scales > 0.0):
            return np.inf
        total = weight * y[0] + 0.5 * float(self.penalty @ y**2) - float(np.sum(np.log(scales)))
        for matrix in (y[0] * np.eye(self.N) - self.sum_of_forms(y), *self._repeated_scalings(y)):
            factor, info = linalg.lapack.zpotrf(matrix, lower=1)
            if info:
                return np.inf
            total -= 2.0 * float(np.sum(np.log(np.diag(factor).real)))
        return float(total)

    def _repeated_scalings(self, y: FloatArray) -> list[ComplexArray]:
        return [(hermitian_basis(k) @ y[part]).reshape(k, k) for part, k in self.repeated]

    def derivatives(self, y: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian."""
        factor, _ = linalg.lapack.zpotrf(y[0] * np.eye(self.N) - self.sum_of_forms(y), lower=1)
        half = linalg.lapack.ztrtri(factor, lower=1)[0]
        # L^-1 F L^-*: its trace is that of S F, inner products are the traces of S F S F'
        turned = np.tril(half) @ self.terms @ np.tril(half).conj().T
        slope = np.trace(turned, axis1=1, axis2=2).real.copy()
        slope[0] += weight
        rows = turned.reshape(self.count, -1).view(float)
        curvature = rows @ rows.T
        for (part, _), D in zip(self.repeated, self._repeated_scalings(y)):
            inverse = positive_inverse(D)
            slope[part] -= coordinates(inverse)
            curvature[part, part] += products([(inverse, inverse)])
        slope[self.single] -= 1.0 / y[self.single]
        curvature[self.single, self.single] += y[self.single] ** -2.0
        curvature[np.diag_indices(self.count)] += self.penalty
        return slope + self.penalty * y, np.asarray(curvature)
