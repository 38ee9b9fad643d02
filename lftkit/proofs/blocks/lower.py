"""Lower bound of the structured singular value: perturbations that make ``I - M Delta`` singular.

Without real scalars the power iteration of Packard, Fan and Doyle (1988) is begun from several vectors: any Delta of
norm 1 gives the bound ``rho(M Delta)``. With real scalars there is a local search besides; Newton steps of least change
bring the perturbation it ends at onto the singular set.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, optimize

from lftkit.arrays import BoolArray, ComplexArray, FloatArray
from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts
from lftkit.support.settings import AlgorithmSettings

sl_optimize: Any = optimize
TINY = 1e-300
Perturbation = tuple[float, ComplexArray]
"""Size of the largest block of a member of the structure, and its matrix (w by z)."""


@dataclass(frozen=True)
class PerturbationSettings(AlgorithmSettings):
    """Numbers of the bounds of a structured singular value.

    Attributes
    ----------
    power_steps : steps of the power iteration, at most
    newton_steps : Newton steps to a singular ``I - M Delta``, at most
    singular : smallest singular value of ``I - M Delta`` that counts as zero
    far : largest scalar with which a local search begins
    local_steps : steps of a local search, at most
    least : level, as a part of the norm of M, below which nothing is proven
    levels : levels that scalings are to prove, at most
    """

    power_steps: int = 200
    newton_steps: int = 40
    singular: float = 1e-11
    far: float = 1e6
    local_steps: int = 200
    least: float = 1e-9
    levels: int = 80


SETTINGS = PerturbationSettings()


class SmallestPerturbation:
    """The local search for one matrix and structure.

    It is found by sequential quadratic programs. The variables are the entries of w, those of each scalar delta, and
    the size t: t is minimised under ``w = Delta z``, ``z = M w``. Constraints and their derivatives are of closed form.

    Parameters
    ----------
    M : ndarray, complex, shape (z, w)
    structure : sequence of UncertaintyBlock
    settings : PerturbationSettings
    sides : ndarray, shape (real scalars, 2), optional
        Magnitudes of the smallest and the largest value of each real scalar in a perturbation of size 1; 1 and 1 by
        default.
    """

    def __init__(
        self,
        M: ComplexArray,
        structure: Sequence[UncertaintyBlock],
        settings: PerturbationSettings = SETTINGS,
        sides: FloatArray | None = None,
    ) -> None:
        self.M, self.parts, self.settings = M, list(parts(structure)), settings
        self.sides = np.ones((sum(block.kind == REAL for block in structure), 2)) if sides is None else sides
        self.width = M.shape[1]
        scalars = [part for part in self.parts if part[0].kind != FULL]
        self.full = [(z, w) for block, z, w in self.parts if block.kind == FULL]
        self.real: BoolArray = np.array([block.kind == REAL for block, _, _ in scalars], dtype=bool)
        self._z = _indices([z for _, z, _ in scalars])
        self._w = _indices([w for _, _, w in scalars])
        self._owner = np.repeat(np.arange(len(scalars)), [block.rows for block, _, _ in scalars])
        # places of the real and imaginary parts of the scalars among the variables behind w
        places = 2 * self.width + np.concatenate([[0], np.cumsum(np.where(self.real, 1, 2))]).astype(int)
        self._re, self._im = places[:-1], places[:-1][~self.real] + 1
        self.count = int(places[-1]) + 1

    def from_vector(self, start: ComplexArray) -> ComplexArray | None:
        """Delta at which a search from the vector w ends, nearly singular; None where it leaves the numbers."""
        w = start / max(float(linalg.norm(start)), TINY)
        pivot = int(np.argmax(np.abs(w)))
        # Variables with the scalars that fit ``w = delta z`` best, and a size that has room for them
        w = w / w[pivot]
        x = np.zeros(self.count)
        x[: self.width], x[self.width : 2 * self.width] = w.real, w.imag
        values = np.array(
            [
                complex(np.vdot(self.M[z] @ w, w[w_of])) / self._square(w, z)
                for block, z, w_of in self.parts
                if block.kind != FULL
            ],
            complex,
        )
        real = values[self.real].real
        side = np.where(real < 0.0, self.sides[:, 0], self.sides[:, 1])
        values[self.real] = np.where(side > 0.0, real, 0.0)  # zero where there is no value of their sign
        values = values / np.maximum(1.0, np.abs(values) / self.settings.far)
        x[self._re], x[self._im] = values.real, values.imag[~self.real]
        sizes = [np.sqrt(float(np.vdot(w[w_of], w[w_of]).real) / self._square(w, z)) for z, w_of in self.full]
        x[-1] = max([1e-6, *self.real_sizes(values[self.real].real), *np.abs(values[~self.real]), *sizes])
        bounds: list[tuple[float | None, float | None]] = [(None, None)] * (self.count - 1) + [(0.0, None)]
        bounds[pivot], bounds[self.width + pivot] = (1.0, 1.0), (0.0, 0.0)
        slope = np.zeros(self.count)
        slope[-1] = 1.0
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # steps out of the bounds are clipped
            result = sl_optimize.minimize(
                lambda x: x[-1],
                x,
                jac=lambda x: slope,
                method="SLSQP",
                bounds=bounds,
                constraints=[
                    {"type": "eq", "fun": self.equalities, "jac": self.equality_slopes},
                    {"type": "ineq", "fun": self.inequalities, "jac": self.inequality_slopes},
                ],
                options={"maxiter": self.settings.local_steps, "ftol": 1e-10},
            )
        return self._delta(result.x) if np.all(np.isfinite(result.x)) else None

    def real_sizes(self, values: FloatArray) -> FloatArray:
        """Sizes of real scalars: values over the side on which they are; infinite where that has no width."""
        side = np.where(values < 0.0, self.sides[:, 0], self.sides[:, 1])
        sizes = np.where(values == 0.0, 0.0, np.inf)
        return np.asarray(np.divide(np.abs(values), side, out=sizes, where=(side > 0.0) & (values != 0.0)))

    def _square(self, w: ComplexArray, z: slice) -> float:
        seen = self.M[z] @ w
        return max(float(np.vdot(seen, seen).real), TINY)

    def _unpacked(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray, float]:
        """w, the scalars, the size."""
        deltas = x[self._re].astype(complex)
        deltas[~self.real] += 1j * x[self._im]
        return x[: self.width] + 1j * x[self.width : 2 * self.width], deltas, float(x[-1])

    def equalities(self, x: FloatArray) -> FloatArray:
        """Real and imaginary parts of ``w - delta z`` of the scalar blocks."""
        w, deltas, _ = self._unpacked(x)
        off = w[self._w] - deltas[self._owner] * (self.M[self._z] @ w)
        return np.concatenate([off.real, off.imag])

    def equality_slopes(self, x: FloatArray) -> FloatArray:
        """Their derivatives, (rows, variables)."""
        w, deltas, _ = self._unpacked(x)
        rows = np.arange(len(self._w))
        rows_of_slopes = -deltas[self._owner, None] * self.M[self._z]
        rows_of_slopes[rows, self._w] += 1.0
        slopes = np.zeros((len(rows), self.count), complex)
        slopes[:, : self.width], slopes[:, self.width : 2 * self.width] = rows_of_slopes, 1j * rows_of_slopes
        seen = self.M[self._z] @ w
        slopes[rows, self._re[self._owner]] = -seen
        two = ~self.real[self._owner]
        slopes[rows[two], self._re[self._owner[two]] + 1] = -1j * seen[two]
        return np.concatenate([slopes.real, slopes.imag])

    def inequalities(self, x: FloatArray) -> FloatArray:
        """Distance of each block from the size: real scalars on both sides, complex scalars, full blocks."""
        w, deltas, size = self._unpacked(x)
        real, other = deltas[self.real].real, deltas[~self.real]
        seen = [(self.M[z] @ w, w[w_of]) for z, w_of in self.full]
        full = [size**2 * np.vdot(z, z).real - np.vdot(w_of, w_of).real for z, w_of in seen]
        down, up = self.sides.T
        return np.concatenate([up * size - real, down * size + real, size**2 - np.abs(other) ** 2, full])

    def inequality_slopes(self, x: FloatArray) -> FloatArray:
        """Their derivatives, (rows, variables)."""
        w, deltas, size = self._unpacked(x)
        real, other = self._re[self.real], deltas[~self.real]
        count, n, end = len(real), self.width, 2 * len(real) + len(other)
        slopes = np.zeros((end + len(self.full), self.count))
        slopes[np.arange(count), real] = -1.0
        slopes[np.arange(count, 2 * count), real] = 1.0
        slopes[: 2 * count, -1] = np.concatenate([self.sides[:, 1], self.sides[:, 0]])
        rows = np.arange(2 * count, end)
        slopes[rows, self._re[~self.real]], slopes[rows, self._im] = -2.0 * other.real, -2.0 * other.imag
        slopes[rows, -1] = 2.0 * size
        for row, (z, w_of) in enumerate(self.full, end):
            seen = self.M[z] @ w
            slope = 2.0 * size**2 * (self.M[z].conj().T @ seen)
            slope[w_of] -= 2.0 * w[w_of]
            slopes[row, :n], slopes[row, n : 2 * n] = slope.real, slope.imag
            slopes[row, -1] = 2.0 * size * np.vdot(seen, seen).real
        return slopes

    def _delta(self, x: FloatArray) -> ComplexArray:
        w, deltas, _ = self._unpacked(x)
        matrix = np.zeros(self.M.shape[::-1], complex)
        scalars = iter(deltas)
        for block, z, w_of in self.parts:
            if block.kind == FULL:
                matrix[w_of, z] = np.outer(w[w_of], (self.M[z] @ w).conj()) / self._square(w, z)
            else:
                matrix[w_of, z] = next(scalars) * np.eye(block.rows)
        return matrix


def _indices(slices: Sequence[slice]) -> Any:
    return np.concatenate([np.zeros(0, int), *(np.arange(part.start, part.stop) for part in slices)]).astype(int)


def lower_bound(
    M: ComplexArray,
    structure: Sequence[UncertaintyBlock],
    *,
    starts: int,
    seed: int,
    sides: FloatArray | None = None,
    enough: float = np.inf,
    settings: PerturbationSettings = SETTINGS,
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
    sides : ndarray, shape (real scalars, 2), optional
        Of the local search, see :class:`SmallestPerturbation`.
    enough : float
        Bound that ends the search.
    settings : PerturbationSettings
    """
    search = _Search(M, structure, settings, sides)
    rng = np.random.default_rng(seed)
    perturbations: list[Perturbation] = []
    for number in range(starts):
        start = search.first(number, rng)
        candidate = search.by_power(start)
        if search.real:
            candidates = [search.by_local_search(start), search.by_local_search(search.excited(candidate))]
        else:
            candidates = [search.scaled(candidate)]
        perturbations += [c for c in candidates if c is not None]
        if any(enough * size <= 1.0 for size, _ in perturbations):
            break
    size, matrix = min(perturbations, key=lambda p: p[0], default=(np.inf, None))
    return 1.0 / size, matrix


class _Search:
    def __init__(
        self,
        M: ComplexArray,
        structure: Sequence[UncertaintyBlock],
        settings: PerturbationSettings,
        sides: FloatArray | None,
    ) -> None:
        self.M, self.structure, self.parts, self.settings = M, structure, list(parts(structure)), settings
        self.real = any(block.kind == REAL for block in structure)
        self.local = SmallestPerturbation(M, structure, settings, sides)
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
        for _ in range(self.settings.power_steps):
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
        # Delta of norm 1 with ``b`` along ``Delta a`` in each block
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
        for _ in range(self.settings.newton_steps):
            if not np.all(np.isfinite(delta)):
                return None
            left, values, right = linalg.svd(unit - self.M @ delta)
            if values[-1] <= self.settings.singular:
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
        return (size, delta) if least <= 10.0 * self.settings.singular and 0.0 < size < np.inf else None
