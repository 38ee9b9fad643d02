"""Lower bound of the structured singular value: perturbations that make ``I - M Delta`` singular.

Without real scalars the power iteration of Packard, Fan and Doyle (1988) is begun from several vectors: any Delta of
norm 1 gives the bound ``rho(M Delta)``. With real scalars there is a local search besides; Newton steps of least change
bring the perturbation it ends at onto the singular set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.blocks.local_search import ITERATIONS as LOCAL_ITERATIONS
from lftkit.proofs.blocks.local_search import TINY, SmallestPerturbation
from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts

ITERATIONS = 200
NEWTON = 40
SINGULAR = 1e-11
"""Smallest singular value of ``I - M Delta`` that counts as zero."""


@dataclass(frozen=True)
class Perturbation:
    """A member of the structure: `matrix` (w by z), `size` that of its largest block."""

    matrix: ComplexArray
    size: float


def lower_bound(
    M: ComplexArray,
    structure: Sequence[UncertaintyBlock],
    *,
    starts: int,
    seed: int,
    iterations: int = LOCAL_ITERATIONS,
    sides: FloatArray | None = None,
    enough: float = np.inf,
) -> tuple[float, ComplexArray | None]:
    """One over the norm of the smallest perturbation found, and the perturbation; 0 and None if none was found.

    Parameters
    ----------
    M : ndarray, complex
    structure : sequence of UncertaintyBlock
    starts : int
        Vectors to begin with.
    seed : int
        Of these.
    iterations : int
        Most steps of a local search, where there are real scalars.
    sides : ndarray, shape (real scalars, 2), optional
        Of the local search, see :class:`SmallestPerturbation`.
    enough : float
        Bound that ends the search.
    """
    search = _Search(M, structure, iterations, sides)
    rng = np.random.default_rng(seed)
    found: list[Perturbation] = []
    for number in range(starts):
        start = search.first(number, rng)
        candidate = search.by_power(start)
        if search.real:
            candidates = [search.by_local_search(start), search.by_local_search(search.excited(candidate))]
        else:
            candidates = [search.scaled(candidate)]
        found += [c for c in candidates if c is not None]
        if any(enough * c.size <= 1.0 for c in found):
            break
    best = min(found, key=lambda p: p.size, default=None)
    return (0.0, None) if best is None else (1.0 / best.size, best.matrix)


class _Search:
    def __init__(
        self, M: ComplexArray, structure: Sequence[UncertaintyBlock], iterations: int, sides: FloatArray | None
    ) -> None:
        self.M, self.structure, self.parts = M, structure, list(parts(structure))
        self.real = any(block.kind == REAL for block in structure)
        self.local = SmallestPerturbation(M, structure, iterations, sides)
        self.singular = linalg.svd(M)[2].conj() if M.size else np.zeros((0, 0), complex)

    def first(self, number: int, rng: np.random.Generator) -> ComplexArray:
        """Vector w to begin with: right singular vectors of M, then random ones."""
        width = self.M.shape[1]
        if number < min(width, 3):
            return np.asarray(self.singular[number], complex)
        return rng.normal(size=width) + 1j * rng.normal(size=width)

    def by_power(self, w: ComplexArray) -> ComplexArray:
        """Delta of norm 1 at which the power iteration ends, real scalars taken as complex ones."""
        b = w / max(float(linalg.norm(w)), TINY)
        back = b.copy()
        a = self.M @ b
        level = 0.0
        for _ in range(ITERATIONS):
            a = self.M @ b
            before, level = level, float(linalg.norm(a))
            if level <= TINY:
                break
            a = a / level
            z = self._aligned(a, back, forward=True)
            back = self.M.conj().T @ z
            back = back / max(float(linalg.norm(back)), TINY)
            b = self._aligned(a, back, forward=False)
            b = b / max(float(linalg.norm(b)), TINY)
            if abs(level - before) <= 1e-12 * level:
                break
        return self._delta(a, b)

    def _aligned(self, a: ComplexArray, w: ComplexArray, forward: bool) -> ComplexArray:
        """The vector z of the iteration from (a, w), or b."""
        result = np.zeros_like(a if forward else w)
        for block, z_part, w_part in self.parts:
            one, two = a[z_part], w[w_part]
            if block.kind == FULL:
                size_a, size_w = max(float(linalg.norm(one)), TINY), max(float(linalg.norm(two)), TINY)
                if forward:
                    result[z_part] = size_w / size_a * one
                else:
                    result[w_part] = size_a / size_w * two
                continue
            product = complex(np.vdot(two, one))
            phase = product / abs(product) if abs(product) > TINY else 1.0
            if forward:
                result[z_part] = phase * two
            else:
                result[w_part] = np.conj(phase) * one
        return result

    def _delta(self, a: ComplexArray, b: ComplexArray) -> ComplexArray:
        """Delta of norm 1 with ``b`` along ``Delta a`` in each block."""
        delta = np.zeros(self.M.shape[::-1], complex)
        for block, z_part, w_part in self.parts:
            one, two = a[z_part], b[w_part]
            if block.kind == FULL:
                sizes = max(float(linalg.norm(one)) * float(linalg.norm(two)), TINY)
                delta[w_part, z_part] = np.outer(two, one.conj()) / sizes
                continue
            product = complex(np.vdot(one, two))
            phase = product / abs(product) if abs(product) > TINY else 1.0
            delta[w_part, z_part] = phase * np.eye(block.rows)
        return delta

    def scaled(self, delta: ComplexArray) -> Perturbation | None:
        """Delta over the largest eigenvalue of M Delta, where ``I - M Delta`` is singular."""
        values = np.asarray(linalg.eigvals(self.M @ delta), complex)
        largest = values[np.argmax(np.abs(values))]
        return None if abs(largest) <= TINY else self._finished(delta / largest)

    def excited(self, delta: ComplexArray) -> ComplexArray:
        """Vector w of the eigenvector of Delta M whose eigenvalue has the largest real part."""
        values, vectors = linalg.eig(delta @ self.M)
        return np.array(np.asarray(vectors)[:, int(np.argmax(np.asarray(values).real))], dtype=complex)

    def by_local_search(self, start: ComplexArray) -> Perturbation | None:
        """The smallest perturbation that a local search over w finds."""
        delta = self.local.from_vector(start)
        return None if delta is None else self._singular(delta)

    def _singular(self, delta: ComplexArray) -> Perturbation | None:
        """The perturbation after Newton steps of least change to a singular ``I - M Delta``; None if they fail."""
        unit = np.eye(len(self.M))
        for _ in range(NEWTON):
            if not np.all(np.isfinite(delta)):
                return None
            left, values, right = linalg.svd(unit - self.M @ delta)
            if values[-1] <= SINGULAR:
                return self._finished(delta)
            row, column = left[:, -1].conj() @ self.M, right[-1].conj()
            slopes, moves = [], []
            for block, z_part, w_part in self.parts:
                gradient = np.outer(row[w_part], column[z_part])  # of u* M Delta v by the entries of the block
                if block.kind == FULL:
                    step = gradient.conj()
                    slopes += [np.sum(gradient * step), np.sum(gradient * (1j * step))]
                    moves += [(w_part, z_part, step), (w_part, z_part, 1j * step)]
                    continue
                slope = np.trace(gradient)
                identity = np.eye(block.rows, dtype=complex)
                slopes.append(slope)
                moves.append((w_part, z_part, identity))
                if block.kind == COMPLEX:
                    slopes.append(1j * slope)
                    moves.append((w_part, z_part, 1j * identity))
            system = np.array([np.real(slopes), np.imag(slopes)])
            lengths = np.array([max(float(linalg.norm(move)), TINY) for *_, move in moves])
            steps = linalg.pinv(system / lengths) @ np.array([values[-1], 0.0]) / lengths
            delta = delta.copy()
            for length, (w_part, z_part, move) in zip(steps, moves):
                delta[w_part, z_part] += length * move
        return None

    def _finished(self, delta: ComplexArray) -> Perturbation | None:
        """The perturbation with its size, if it is one and ``I - M Delta`` is singular."""
        others = [part for part in self.parts if part[0].kind != REAL]
        reals = [delta[w.start, z.start].real for block, z, w in self.parts if block.kind == REAL]
        sizes = [float(linalg.norm(delta[w_part, z_part], 2)) for _, z_part, w_part in others]
        sizes += self.local.real_sizes(np.array(reals, dtype=float)).tolist()
        least = float(linalg.svd(np.eye(len(self.M)) - self.M @ delta, compute_uv=False)[-1])
        size = max(sizes)
        return Perturbation(delta, size) if least <= 10.0 * SINGULAR and 0.0 < size < np.inf else None
