"""Scalings of a structured singular value test by a barrier method with Newton steps.

Given blocks ``w_k = Delta_k z_k`` with ``z_k = Z_k u`` and ``w_k = W_k u`` it looks for scalings that make the sum of
the quadratic forms below negative definite in u. Real repeated scalars in [-1, 1] have ``z* D z - w* D w +
Re(z* j G w)`` with D > 0 and G Hermitian (Fan, Tits and Doyle 1991), real scalars without bounds the same without D,
complex ones the same without G, full blocks ``d (z* z - w* w)``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import linalg, sparse

from lftkit.arrays import ComplexArray, FloatArray

REAL, ANY_REAL, COMPLEX, FULL = "real", "any real", "complex", "full"


@dataclass(frozen=True)
class BarrierBlock:
    """One block of uncertainty of norm at most 1.

    Parameters
    ----------
    kind : str
        ``real``, ``any real`` (without bounds) or ``complex`` (repeated scalar) or ``full``.
    Z, W : ndarray, complex
        Maps to the input and the output of the block, shapes (k, N) both, for a full block (p, N) and (m, N).
    """

    kind: str
    Z: ComplexArray
    W: ComplexArray


@dataclass(frozen=True)
class Scalings:
    """Result of :func:`lftkit.proofs.state_space.scaling_search.find_scalings`.

    Parameters
    ----------
    margin : float
        The sum of the forms is at most ``-margin u* u``; positive where the test is passed.
    D, G : tuple of ndarray
        Of each block, (k, k); (1, 1) for a full block; zero where the kind has none.
    losses : ndarray
        Of each block: what its interval costs in the binding direction. The largest is the best one to bisect.
    """

    margin: float
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    losses: FloatArray


class BarrierProblem:
    """Variables y = (s, coordinates of the scalings); minimise s with ``s I - F(y) > 0``.

    Parameters
    ----------
    blocks : sequence of BarrierBlock
    penalty : float
        Weight of ``|G|^2 / 2`` in the objective with barrier. Where all responses are nearly real, G costs nothing and
        its centre is far out, so that the inequality is lost in rounding.
    small : int
        Largest product of the sizes of two blocks whose second derivatives are formed in one piece.
    """

    def __init__(self, blocks: Sequence[BarrierBlock], penalty: float = 0.0, small: int = 64) -> None:
        self.blocks, self.small = tuple(blocks), small
        self.N = self.blocks[0].Z.shape[1]
        self.slices: list[tuple[slice | None, slice | None]] = []
        self.at: list[tuple[slice, slice]] = []
        self.forms: list[ComplexArray] = []
        count, row, signals, sizes = 1, 0, [], []
        for block in self.blocks:
            k = 1 if block.kind == FULL else block.Z.shape[0]
            first = slice(count, count + k * k) if block.kind != ANY_REAL else None
            count += k * k if first else 0
            second = slice(count, count + k * k) if block.kind in (REAL, ANY_REAL) else None
            count += k * k if second else 0
            self.slices.append((first, second))
            full = block.kind == FULL
            self.forms.append(
                block.Z.conj().T @ block.Z - block.W.conj().T @ block.W if full else np.zeros((0, 0), complex)
            )
            self.at.append((slice(0, 0), slice(0, 0)) if full else (slice(row, row + k), slice(row + k, row + 2 * k)))
            if not full:
                signals += [block.Z, block.W]
                row += 2 * k
            sizes.append(k if first else 0)
        self.count = count
        self.signals = np.vstack([np.zeros((0, self.N), complex), *signals])
        self.penalty = np.zeros(count)
        for _, second in self.slices:
            if second is not None:
                self.penalty[second] = penalty
        self.trace = np.zeros(count)
        for size, (first, _) in zip(sizes, self.slices):
            if first is not None:
                self.trace[first][:size] = 1.0
        self.degree = float(self.N + sum(sizes))

    def start(self) -> FloatArray:
        """Variables to begin with: equal scalings, s large enough."""
        return self.raised(self.trace / self.trace.sum(), 1e-3)

    def raised(self, y: FloatArray, least: float) -> FloatArray:
        """Variables with the same scalings and s large enough, by at least `least`."""
        y = np.array(y)
        largest = float(linalg.eigvalsh(self.sum_of_forms(y))[-1])
        y[0] = largest + 0.1 * abs(largest) + least
        return y

    def variables(self, D: Sequence[ComplexArray], G: Sequence[ComplexArray]) -> FloatArray:
        """Variables of scalings, with s = 0 and a trace of one."""
        y = np.zeros(self.count)
        for (first, second), d, g in zip(self.slices, D, G):
            for part, matrix in ((first, d), (second, g)):
                if part is not None:
                    y[part] = coordinates(matrix)
        return np.asarray(y / float(self.trace @ y))

    def matrices(self, y: FloatArray, number: int) -> tuple[ComplexArray, ComplexArray]:
        """D and G of a block."""
        block = self.blocks[number]
        k = 1 if block.kind == FULL else block.Z.shape[0]
        D, G = (
            np.zeros((k, k), complex) if part is None else (hermitian_basis(k) @ y[part]).reshape(k, k)
            for part in self.slices[number]
        )
        return D, G

    def sum_of_forms(self, y: FloatArray) -> ComplexArray:
        """Sum of the quadratic forms, (N, N)."""
        inner = np.zeros((len(self.signals), len(self.signals)), complex)
        F = np.zeros((self.N, self.N), complex)
        for i, block in enumerate(self.blocks):
            D, G = self.matrices(y, i)
            if block.kind == FULL:
                F += D[0, 0].real * self.forms[i]
                continue
            z, w = self.at[i]
            inner[z, z], inner[w, w] = D, -D
            inner[z, w], inner[w, z] = 0.5j * G, -0.5j * G
        F += self.signals.conj().T @ (inner @ self.signals)
        return np.asarray(0.5 * (F + F.conj().T))

    def value(self, y: FloatArray, weight: float) -> float:
        """Objective with barrier; infinite outside."""
        objective = weight * y[0] + 0.5 * float(self.penalty @ y**2)
        return self.with_barrier(objective, y, (D for _, D in self._positive(y)))

    def with_barrier(self, objective: float, y: FloatArray, scalings: Iterable[ComplexArray]) -> float:
        """An objective less the logarithms of the determinants of ``s I - F(y)`` and of scalings; infinite outside."""
        for matrix in (y[0] * np.eye(self.N) - self.sum_of_forms(y), *scalings):
            factor, info = linalg.lapack.zpotrf(matrix, lower=1)
            if info:
                return np.inf
            objective -= 2.0 * float(np.sum(np.log(np.diag(factor).real)))
        return float(objective)

    def _positive(self, y: FloatArray) -> list[tuple[slice, ComplexArray]]:
        """The matrices D with the slices of their variables."""
        return [(part, self.matrices(y, i)[0]) for i, (part, _) in enumerate(self.slices) if part is not None]

    def derivatives(self, y: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian."""
        S = positive_inverse(y[0] * np.eye(self.N) - self.sum_of_forms(y))
        inner = self.signals @ S @ self.signals.conj().T
        slope = self._functional(S, inner)
        curvature: FloatArray = np.zeros((self.count, self.count))
        slope[0] = weight - np.trace(S).real
        # Upper triangle of the rows of s and of full blocks
        square = S @ S
        curvature[0] = -self._functional(square, self.signals @ square @ self.signals.conj().T)
        curvature[0, 0] = np.trace(square).real
        for i, (part, _) in enumerate(self.slices):
            if self.blocks[i].kind == FULL and part is not None:
                turned = S @ self.forms[i] @ S
                row = self._functional(turned, self.signals @ turned @ self.signals.conj().T)
                curvature[part.start, part.start :] = row[part.start :]
                curvature[1 : part.start, part.start] = row[1 : part.start]
        self._repeated(inner, curvature)
        curvature = np.asarray(np.triu(curvature) + np.triu(curvature, 1).T)
        for part, D in self._positive(y):
            inverse = positive_inverse(D)
            slope[part] -= coordinates(inverse)
            curvature[part, part] += products([(inverse, inverse)])
        return slope + self.penalty * y, curvature + np.diag(self.penalty)

    def _functional(self, S: ComplexArray, inner: ComplexArray) -> FloatArray:
        """Coefficients of ``y -> trace(S F(y))``; the entry of s is zero. `inner` is ``signals S signals*``."""
        result = np.zeros(self.count)
        for i, (block, (first, second), (z, w)) in enumerate(zip(self.blocks, self.slices, self.at)):
            if block.kind == FULL:
                result[first] = np.sum(S.T * self.forms[i]).real
                continue
            if first is not None:
                result[first] = coordinates(inner[z, z] - inner[w, w])
            if second is not None:
                K = inner[z, w]
                result[second] = coordinates(0.5j * (K.conj().T - K))
        return result

    def _repeated(self, inner: ComplexArray, curvature: FloatArray) -> None:
        """Second derivatives between the scalings of repeated blocks: Kronecker products of small matrices."""
        number = [i for i, block in enumerate(self.blocks) if block.kind != FULL]
        for i in number:
            for j in number[number.index(i) :]:
                k, m = (self.blocks[n].Z.shape[0] for n in (i, j))
                if k * m <= self.small:
                    whole = [slice(self.at[n][0].start, self.at[n][1].stop) for n in (i, j)]
                    rows, columns = (self._variables(n) for n in (i, j))
                    A, B = inner[whole[0], whole[1]], inner[whole[1], whole[0]]
                    full = np.multiply.outer(A, B).transpose(3, 0, 1, 2).reshape(4 * k * k, 4 * m * m)
                    left, right = (_sparse_form(self.blocks[n].kind, size) for n, size in ((i, k), (j, m)))
                    curvature[rows, columns] = (right @ (left @ full).T).T.real
                    continue
                for part, terms in zip(self.slices[i], _terms(*self.at[i])):
                    for other, others in zip(self.slices[j], _terms(*self.at[j])):
                        if part is None or other is None or other.start < part.start:
                            continue
                        curvature[part, other] = products(
                            [(c1 * c2 * inner[R1, L2], inner[R2, L1]) for c1, L1, R1 in terms for c2, L2, R2 in others]
                        )

    def _variables(self, number: int) -> slice:
        """Variables of a block, those of D before those of G."""
        parts = [part for part in self.slices[number] if part is not None]
        return slice(parts[0].start, parts[-1].stop)

    def line_search(self, y: FloatArray, step: FloatArray, weight: float, decrement: float) -> FloatArray:
        """Along a step as far as the objective falls."""
        before, length = self.value(y, weight), 1.0
        for _ in range(40):
            candidate = y + length * step
            if self.value(candidate, weight) <= before - 0.05 * length * decrement**2 + 1e-12 * abs(before):
                return candidate
            length *= 0.6
        return y

    def result(self, y: FloatArray) -> Scalings:
        """Scalings of the variables, with the loss of each block."""
        pairs = [self.matrices(y, i) for i in range(len(self.blocks))]
        S = positive_inverse(y[0] * np.eye(self.N) - self.sum_of_forms(y))
        losses = [
            D[0, 0].real * np.trace(b.Z @ S @ b.Z.conj().T).real
            if b.kind == FULL
            else np.trace(D @ b.Z @ S @ b.Z.conj().T).real
            for b, (D, _) in zip(self.blocks, pairs)
        ]
        return Scalings(-float(y[0]), tuple(D for D, _ in pairs), tuple(G for _, G in pairs), np.array(losses))


def positive_inverse(matrix: ComplexArray) -> ComplexArray:
    """Inverse of a positive definite matrix."""
    factor, _ = linalg.lapack.zpotrf(matrix, lower=1)
    lower = np.tril(linalg.lapack.zpotri(factor, lower=1)[0])
    return np.asarray(lower + np.tril(lower, -1).conj().T)


def _terms(z: slice, w: slice) -> tuple[list[tuple[complex, slice, slice]], ...]:
    """Terms (c, L, R) of ``sum c L* X R`` for X = D, then for X = G."""
    return [(1.0, z, z), (-1.0, w, w)], [(0.5j, z, w), (-0.5j, w, z)]


@lru_cache(maxsize=64)
def hermitian_basis(k: int) -> ComplexArray:
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


@lru_cache(maxsize=64)
def _sparse_form(kind: str, k: int) -> Any:
    """Matrices ``[[D, j G / 2], [-j G / 2, -D]]`` of the variables of a block as rows (variables, 4 k^2)."""
    basis = hermitian_basis(k).T.reshape(k * k, k, k)
    D, G = np.zeros((2, k * k, 2 * k, 2 * k), complex)
    D[:, :k, :k], D[:, k:, k:] = basis, -basis
    G[:, :k, k:], G[:, k:, :k] = 0.5j * basis, -0.5j * basis
    parts = ([D] if kind != ANY_REAL else []) + ([G] if kind in (REAL, ANY_REAL) else [])
    return sparse.csr_array(np.concatenate(parts).reshape(-1, 4 * k * k))


@lru_cache(maxsize=64)
def _sparse_basis(k: int) -> Any:
    """Transpose of :func:`hermitian_basis` as a sparse matrix."""
    return sparse.csr_array(hermitian_basis(k).T)


def coordinates(matrix: ComplexArray) -> FloatArray:
    """Coefficients of ``X -> trace(matrix X)`` in the basis."""
    return np.asarray((_sparse_basis(len(matrix)) @ matrix.T.ravel()).real)


def products(pairs: Sequence[tuple[ComplexArray, ComplexArray]]) -> FloatArray:
    """Matrix of the bilinear form ``(X, Y) -> Re sum trace(X A Y B)`` in the bases, for pairs (A, B)."""
    k, m = pairs[0][0].shape
    first, second = (np.stack([pair[i].ravel() for pair in pairs]) for i in (0, 1))
    full = (first.T @ second).reshape(k, m, m, k).transpose(3, 0, 1, 2).reshape(k * k, m * m)
    left, right = _sparse_basis(k), _sparse_basis(m)
    return np.asarray((right @ (left @ full).T).T.real)


def newton_step(curvature: FloatArray, slope: FloatArray, trace: FloatArray) -> FloatArray:
    """Newton step that keeps the trace, with the Hessian scaled to a unit diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    scaled = curvature * scale[:, None] * scale
    for shift in (1e-13, 1e-10, 1e-7, 1e-4):
        factor, info = linalg.lapack.dpotrf(scaled + shift * np.eye(len(scaled)), lower=1)
        if not info:
            break
    else:
        return np.zeros_like(slope)
    free, held = (scale * linalg.cho_solve((factor, True), scale * v) for v in (slope, trace))
    return np.asarray(free - held * (float(trace @ free) / float(trace @ held)))
