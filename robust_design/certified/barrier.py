"""Scalings of a structured singular value test by a barrier method with Newton steps.

Given blocks ``w_k = Delta_k z_k`` with ``z_k = Z_k u`` and ``w_k = W_k u`` it looks for scalings that make the sum of
the quadratic forms below negative definite in u. Real repeated scalars in [-1, 1] have ``z* D z - w* D w +
Re(z* j G w)`` with D > 0 and G Hermitian (Fan, Tits and Doyle 1991), complex repeated scalars the same without G, full
blocks ``d (z* z - w* w)``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

sl: Any = linalg
FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

REAL, COMPLEX, FULL = "real", "complex", "full"
GROWTH = 8.0
"""Factor by which the weight of the objective grows from one centre to the next."""
CENTRED = 0.3
"""Newton decrement at which a point counts as centred."""


@dataclass(frozen=True)
class Block:
    """One block of uncertainty of norm at most 1.

    Parameters
    ----------
    kind : str
        ``real`` or ``complex`` (repeated scalar) or ``full``.
    Z, W : ndarray, complex
        Maps to the input and the output of the block, shapes (k, N) both, for a full block (p, N) and (m, N).
    """

    kind: str
    Z: ComplexArray
    W: ComplexArray


@dataclass(frozen=True)
class Scalings:
    """Result of :func:`find_scalings`.

    Parameters
    ----------
    margin : float
        The sum of the forms is at most ``-margin u* u``; positive where the test is passed.
    D, G : tuple of ndarray
        Of each block, (k, k); (1, 1) for a full block; G is zero where the kind has none.
    losses : ndarray
        Of each block: what its interval costs in the binding direction. The largest is the best one to bisect.
    """

    margin: float
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    losses: FloatArray


def find_scalings(
    blocks: Sequence[Block], *, iterations: int = 80, until: float = np.inf, precision: float = 1e-7
) -> Scalings:
    """Scalings of trace one with a margin as large as it gets, or as soon as the sign of it is certain.

    Parameters
    ----------
    blocks : sequence of Block
        N is the same for all; together the W have rank N.
    iterations : int
        Most Newton steps.
    until : float
        ``time.monotonic()`` after which it stops.
    precision : float
        Smallest distance to the optimal margin that is worth a step.
    """
    problem = _Problem(blocks)
    y = problem.start()
    weight = -2.0 * float(problem.derivatives(y, 0.0)[0][0])
    for _ in range(iterations):
        if time.monotonic() > until:
            break
        slope, curvature = problem.derivatives(y, weight)
        step = _solve(curvature, -slope, problem.trace)
        decrement = math.sqrt(max(float(-slope @ step), 0.0))
        y = problem.line_search(y, step, weight, decrement)
        gap = problem.degree / weight
        if y[0] < 0.0 and gap < 0.5 * -y[0]:
            break
        if decrement > CENTRED:
            continue
        if y[0] - 2.0 * gap > 0.0 or gap < precision:
            break
        weight *= GROWTH
    return problem.result(y)


class _Problem:
    """Variables y = (s, coordinates of the scalings); minimise s with ``s I - F(y) > 0``."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.N = self.blocks[0].Z.shape[1]
        self.slices: list[tuple[slice, slice | None]] = []
        at = 1
        for block in self.blocks:
            size = 1 if block.kind == FULL else block.Z.shape[0] ** 2
            first = slice(at, at + size)
            at += size
            second = slice(at, at + size) if block.kind == REAL else None
            at += size if second else 0
            self.slices.append((first, second))
        self.count = at
        self.forms = [
            b.Z.conj().T @ b.Z - b.W.conj().T @ b.W if b.kind == FULL else np.zeros((0, 0), complex)
            for b in self.blocks
        ]
        sizes = [1 if b.kind == FULL else b.Z.shape[0] for b in self.blocks]
        self.trace = np.zeros(at)
        for size, (first, _) in zip(sizes, self.slices):
            self.trace[first][:size] = 1.0
        self.degree = float(self.N + sum(sizes))

    def start(self) -> FloatArray:
        y: FloatArray = self.trace / self.trace.sum()
        largest = float(linalg.eigvalsh(self.sum_of_forms(y))[-1])
        y[0] = largest + 0.1 * abs(largest) + 1e-3
        return y

    def matrices(self, y: FloatArray, number: int) -> tuple[ComplexArray, ComplexArray]:
        """D and G of a block."""
        block, (first, second) = self.blocks[number], self.slices[number]
        k = 1 if block.kind == FULL else block.Z.shape[0]
        basis = _basis(k)
        D = (basis @ y[first]).reshape(k, k)
        return D, (basis @ y[second]).reshape(k, k) if second is not None else np.zeros((k, k), complex)

    def sum_of_forms(self, y: FloatArray) -> ComplexArray:
        F = np.zeros((self.N, self.N), complex)
        for i, block in enumerate(self.blocks):
            D, G = self.matrices(y, i)
            if block.kind == FULL:
                F += D[0, 0].real * self.forms[i]
                continue
            F += block.Z.conj().T @ D @ block.Z - block.W.conj().T @ D @ block.W
            if block.kind == REAL:
                half = block.Z.conj().T @ (0.5j * G) @ block.W
                F += half + half.conj().T
        return np.asarray(0.5 * (F + F.conj().T))

    def value(self, y: FloatArray, weight: float) -> float:
        """Objective with barrier; infinite outside."""
        total = weight * y[0]
        for matrix in (y[0] * np.eye(self.N) - self.sum_of_forms(y), *self._positive(y)):
            factor, info = sl.lapack.zpotrf(matrix, lower=1)
            if info:
                return np.inf
            total -= 2.0 * float(np.sum(np.log(np.diag(factor).real)))
        return float(total)

    def _positive(self, y: FloatArray) -> list[ComplexArray]:
        return [self.matrices(y, i)[0] for i in range(len(self.blocks))]

    def derivatives(self, y: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian."""
        S = _inverse(y[0] * np.eye(self.N) - self.sum_of_forms(y))
        slope = self._functional(S)
        curvature: FloatArray = np.zeros((self.count, self.count))
        slope[0] = weight - np.trace(S).real
        square = S @ S
        curvature[0] = -self._functional(square)
        curvature[0, 0] = np.trace(square).real
        for i, block in enumerate(self.blocks):
            first, _ = self.slices[i]
            if block.kind == FULL:
                curvature[first.start] = self._functional(S @ self.forms[i] @ S)
                curvature[first.start, 0] = curvature[0, first.start]
        self._repeated(S, curvature)
        curvature = np.asarray(np.triu(curvature) + np.triu(curvature, 1).T)
        for i, D in enumerate(self._positive(y)):
            first, _ = self.slices[i]
            inverse = _inverse(D)
            slope[first] -= _coordinates(inverse)
            curvature[first, first] += _product(inverse, inverse)
        return slope, curvature

    def _functional(self, S: ComplexArray) -> FloatArray:
        """Coefficients of ``y -> trace(S F(y))``; the entry of s is zero."""
        result = np.zeros(self.count)
        for i, block in enumerate(self.blocks):
            first, second = self.slices[i]
            if block.kind == FULL:
                result[first] = np.sum(S.T * self.forms[i]).real
                continue
            result[first] = _coordinates(block.Z @ S @ block.Z.conj().T - block.W @ S @ block.W.conj().T)
            if second is not None:
                K = block.Z @ S @ block.W.conj().T
                result[second] = _coordinates(0.5j * (K.conj().T - K))
        return result

    def _repeated(self, S: ComplexArray, curvature: FloatArray) -> None:
        """Second derivatives between the scalings of repeated blocks: Kronecker products of small matrices."""
        number = [i for i, block in enumerate(self.blocks) if block.kind != FULL]
        for i in number:
            for j in number[number.index(i) :]:
                for part, terms in zip(self.slices[i], _terms(self.blocks[i])):
                    for other, others in zip(self.slices[j], _terms(self.blocks[j])):
                        if part is None or other is None or other.start < part.start:
                            continue
                        block = np.zeros((part.stop - part.start, other.stop - other.start))
                        for c1, L1, R1 in terms:
                            for c2, L2, R2 in others:
                                block += _product(c1 * c2 * (R1 @ S @ L2.conj().T), R2 @ S @ L1.conj().T)
                        curvature[part, other] = block
        for i, block_i in enumerate(self.blocks):  # rows of full blocks below the diagonal go above it
            if block_i.kind == FULL:
                row = self.slices[i][0].start
                curvature[:row, row] = np.where(np.arange(row) == 0, curvature[0, row], curvature[row, :row])

    def line_search(self, y: FloatArray, step: FloatArray, weight: float, decrement: float) -> FloatArray:
        before, length = self.value(y, weight), 1.0
        for _ in range(40):
            candidate = y + length * step
            if self.value(candidate, weight) <= before - 0.05 * length * decrement**2 + 1e-12 * abs(before):
                return candidate
            length *= 0.6
        return y

    def result(self, y: FloatArray) -> Scalings:
        pairs = [self.matrices(y, i) for i in range(len(self.blocks))]
        S = _inverse(y[0] * np.eye(self.N) - self.sum_of_forms(y))
        losses = [
            D[0, 0].real * np.trace(b.Z @ S @ b.Z.conj().T).real
            if b.kind == FULL
            else np.trace(D @ b.Z @ S @ b.Z.conj().T).real
            for b, (D, _) in zip(self.blocks, pairs)
        ]
        return Scalings(-float(y[0]), tuple(D for D, _ in pairs), tuple(G for _, G in pairs), np.array(losses))


def _inverse(matrix: ComplexArray) -> ComplexArray:
    """Inverse of a positive definite matrix."""
    factor, _ = sl.lapack.zpotrf(matrix, lower=1)
    lower = np.tril(sl.lapack.zpotri(factor, lower=1)[0])
    return np.asarray(lower + np.tril(lower, -1).conj().T)


def _terms(block: Block) -> tuple[list[tuple[complex, ComplexArray, ComplexArray]], ...]:
    """Terms (c, L, R) of ``sum c L* X R`` for X = D, then for X = G."""
    Z, W = block.Z, block.W
    return [(1.0, Z, Z), (-1.0, W, W)], [(0.5j, Z, W), (-0.5j, W, Z)]


@lru_cache(maxsize=64)
def _basis(k: int) -> ComplexArray:
    """Orthonormal basis of the Hermitian k x k matrices as columns (k^2, k^2), the diagonal ones first."""
    columns = [np.zeros((k, k), complex) for _ in range(k * k)]
    for a in range(k):
        columns[a][a, a] = 1.0
    at = k
    for a in range(k):
        for b in range(a):
            columns[at][a, b] = columns[at][b, a] = np.sqrt(0.5)
            columns[at + 1][a, b], columns[at + 1][b, a] = 1j * np.sqrt(0.5), -1j * np.sqrt(0.5)
            at += 2
    result: ComplexArray = np.stack([c.ravel() for c in columns], axis=1)
    result.flags.writeable = False
    return result


def _coordinates(matrix: ComplexArray) -> FloatArray:
    """Coefficients of ``X -> trace(matrix X)`` in the basis."""
    return np.asarray((_basis(len(matrix)).T @ matrix.T.ravel()).real)


def _product(A: ComplexArray, B: ComplexArray) -> FloatArray:
    """Matrix of the bilinear form ``(X, Y) -> Re trace(X A Y B)`` in the bases."""
    k, m = A.shape
    full = np.einsum("bc,da->abcd", A, B).reshape(k * k, m * m)
    return np.asarray((_basis(k).T @ full @ _basis(m)).real)


def _solve(curvature: FloatArray, slope: FloatArray, trace: FloatArray) -> FloatArray:
    """Newton step that keeps the trace, with the Hessian scaled to a unit diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    scaled = curvature * scale[:, None] * scale
    for shift in (1e-13, 1e-10, 1e-7, 1e-4):
        factor, info = sl.lapack.dpotrf(scaled + shift * np.eye(len(scaled)), lower=1)
        if not info:
            break
    else:
        return np.zeros_like(slope)
    free, held = (scale * linalg.cho_solve((factor, True), scale * v) for v in (slope, trace))
    return np.asarray(free - held * (float(trace @ free) / float(trace @ held)))
