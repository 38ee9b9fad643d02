"""Scalings of a structured singular value test: Newton steps along the centres of a barrier problem.

The problem has faster forms for few variables, and for blocks that are not repeated.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.settings import CELLS, CellSettings
from lftkit.proofs.state_space.barrier import (
    FULL,
    BarrierBlock,
    BarrierProblem,
    Scalings,
    coordinates,
    hermitian_basis,
    newton_step,
    positive_inverse,
    products,
)


class ScalarBarrierProblem(BarrierProblem):
    """As :class:`BarrierProblem`, for repeated scalars that occur once.

    With a = z_i S z_j*, b = z_i S w_j*, c = w_i S z_j* and d = w_i S w_j* the second derivatives are |a|^2 - |b|^2 -
    |c|^2 + |d|^2 by D and D, Im(c d* - a b*) by D and G, and Re(a d* - b* c) / 2 by G and G.
    """

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
        parts = [self.slices[i][0] for i in full]
        self.of_full = np.array([part.start for part in parts if part is not None], dtype=int)
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
        zS, wS = self.z @ S, self.w @ S
        a, b = zS @ self.z.conj().T, zS @ self.w.conj().T
        c, d = wS @ self.z.conj().T, wS @ self.w.conj().T
        by_d = np.abs(a) ** 2 - np.abs(b) ** 2 - np.abs(c) ** 2 + np.abs(d) ** 2
        mixed = (c * d.conj() - a * b.conj()).imag[np.ix_(self.scaled, self.turned)]
        by_g = 0.5 * (a * d.conj() - b.conj() * c).real
        curvature[np.ix_(self.of_d, self.of_d)] = by_d[np.ix_(self.scaled, self.scaled)]
        curvature[np.ix_(self.of_d, self.of_g)] = mixed
        curvature[np.ix_(self.of_g, self.of_d)] = mixed.T
        curvature[np.ix_(self.of_g, self.of_g)] = by_g[np.ix_(self.turned, self.turned)]
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


class DenseBarrierProblem(BarrierProblem):
    """As :class:`BarrierProblem`, with the forms of all variables in one array (variables, N, N).

    All second derivatives are one product of matrices.
    """

    def __init__(self, blocks: Sequence[BarrierBlock], penalty: float = 0.0) -> None:
        super().__init__(blocks, penalty)
        self.terms = np.zeros((self.count, self.N, self.N), complex)
        self.terms[0] = -np.eye(self.N)
        single, self.repeated = [], []
        for block, form, (first, second) in zip(self.blocks, self.forms, self.slices):
            if first is not None and (block.kind == FULL or len(block.Z) == 1):
                single.append(first.start)
            elif first is not None:
                self.repeated.append((first, len(block.Z)))
            if block.kind == FULL:
                self.terms[first] = form
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
        objective = weight * y[0] + 0.5 * float(self.penalty @ y**2) - float(np.sum(np.log(scales)))
        return self.with_barrier(objective, y, self._repeated_scalings(y))

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


def barrier_problem(
    blocks: Sequence[BarrierBlock], penalty: float = 0.0, settings: CellSettings = CELLS
) -> BarrierProblem:
    """The barrier problem of some blocks, in the form that is fastest for their sizes."""
    problem = BarrierProblem(blocks, penalty, settings.small)
    if problem.count * problem.N**2 <= settings.dense:
        return DenseBarrierProblem(blocks, penalty)
    single = all(block.kind == FULL or len(block.Z) == 1 for block in blocks)
    return ScalarBarrierProblem(blocks, penalty) if single else problem


def find_scalings(
    blocks: Sequence[BarrierBlock],
    *,
    iterations: int = 80,
    until: float = np.inf,
    precision: float = 1e-7,
    penalty: float = 0.0,
    settings: CellSettings = CELLS,
) -> Scalings:
    """Scalings of trace one with a margin as large as it gets, or as soon as the sign of it is certain.

    Parameters
    ----------
    blocks : sequence of BarrierBlock
        N is the same for all; together the W have rank N.
    iterations : int
        Most Newton steps.
    until : float
        ``time.monotonic()`` after which it stops.
    precision : float
        Smallest distance to the optimal margin that is worth a step.
    penalty : float
        Of :class:`lftkit.proofs.state_space.barrier.BarrierProblem`.
    settings : CellSettings
        Of these `growth`, `centred`, `dense` and `small`.
    """
    if not blocks:  # are members of a system without elements well posed: no signal is left to show it for
        return Scalings(1.0, (), (), np.zeros(0))
    problem = barrier_problem(blocks, penalty, settings)
    y = start = problem.start()
    steps = newton_path(problem, start, iterations, growth=settings.growth, centred=settings.centred, until=until)
    for y, gap, centre in steps:
        if y[0] < 0.0 and gap < 0.5 * -y[0]:
            break
        if centre and (y[0] - 2.0 * gap > 0.0 or gap < precision):
            break
    return problem.result(y)


def newton_path(
    problem: BarrierProblem, y: FloatArray, iterations: int, *, growth: float, centred: float, until: float = np.inf
) -> Iterator[tuple[FloatArray, float, bool]]:
    """Newton steps along the centres of a problem towards its optimum, from variables inside.

    Parameters
    ----------
    problem : BarrierProblem
    y : ndarray
        Variables to begin with.
    iterations : int
        Most steps.
    growth : float
        Factor by which the weight of the objective grows from one centre to the next.
    centred : float
        Newton decrement at which a point counts as a centre.
    until : float
        ``time.monotonic()`` after which it stops.

    Yields
    ------
    y : ndarray
        The variables.
    gap : float
        Distance of a centre from the optimum.
    centre : bool
        Whether the point is one.
    """
    weight = -2.0 * float(problem.derivatives(y, 0.0)[0][0])
    for _ in range(iterations):
        if time.monotonic() > until:
            return
        slope, curvature = problem.derivatives(y, weight)
        step = newton_step(curvature, -slope, problem.trace)
        decrement = math.sqrt(max(float(-slope @ step), 0.0))
        y = problem.line_search(y, step, weight, decrement)
        yield y, problem.degree / weight, decrement <= centred
        if decrement <= centred:
            weight *= growth
