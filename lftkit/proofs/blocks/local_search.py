"""The smallest perturbation that makes ``I - M Delta`` singular, by a local search: sequential quadratic programs.

The variables are the entries of w, those of each scalar delta, and the size t: t is minimised under ``w = Delta z``,
``z = M w``. Constraints and their derivatives are of closed form.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import linalg, optimize

from lftkit.arrays import BoolArray, ComplexArray, FloatArray
from lftkit.proofs.trusted.proof import FULL, REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts

sl_optimize: Any = optimize
ITERATIONS = 200
FAR = 1e6
"""Largest scalar to begin with."""
TINY = 1e-300


class SmallestPerturbation:
    """The local search for one matrix and structure.

    Parameters
    ----------
    M : ndarray, complex, shape (z, w)
    structure : sequence of UncertaintyBlock
    iterations : int
        Most steps of a search.
    sides : ndarray, shape (real scalars, 2), optional
        Magnitudes of the smallest and the largest value of each real scalar in a perturbation of size 1; 1 and 1 by
        default.
    """

    def __init__(
        self,
        M: ComplexArray,
        structure: Sequence[UncertaintyBlock],
        iterations: int = ITERATIONS,
        sides: FloatArray | None = None,
    ) -> None:
        self.M, self.parts, self.iterations = M, list(parts(structure)), iterations
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
        x0 = self._first(w / w[pivot])
        bounds: list[tuple[float | None, float | None]] = [(None, None)] * (self.count - 1) + [(0.0, None)]
        bounds[pivot], bounds[self.width + pivot] = (1.0, 1.0), (0.0, 0.0)
        slope = np.zeros(self.count)
        slope[-1] = 1.0
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # steps out of the bounds are clipped
            result = sl_optimize.minimize(
                lambda x: x[-1],
                x0,
                jac=lambda x: slope,
                method="SLSQP",
                bounds=bounds,
                constraints=[
                    {"type": "eq", "fun": self.equalities, "jac": self.equality_slopes},
                    {"type": "ineq", "fun": self.inequalities, "jac": self.inequality_slopes},
                ],
                options={"maxiter": self.iterations, "ftol": 1e-10},
            )
        return self._delta(result.x) if np.all(np.isfinite(result.x)) else None

    def _first(self, w: ComplexArray) -> FloatArray:
        """Variables with the scalars that fit ``w = delta z`` best, and a size that has room for them."""
        x = np.zeros(self.count)
        x[: self.width], x[self.width : 2 * self.width] = w.real, w.imag
        values = np.array([self._quotient(w, z, own) for block, z, own in self.parts if block.kind != FULL], complex)
        values[self.real] = self._allowed(values[self.real].real)
        values = values / np.maximum(1.0, np.abs(values) / FAR)
        x[self._re], x[self._im] = values.real, values.imag[~self.real]
        sizes = [np.sqrt(float(np.vdot(w[own], w[own]).real) / self._square(w, z)) for z, own in self.full]
        x[-1] = max([1e-6, *self.real_sizes(values[self.real].real), *np.abs(values[~self.real]), *sizes])
        return x

    def _allowed(self, values: FloatArray) -> FloatArray:
        """Real scalars, zero where there is no value of their sign."""
        return np.asarray(np.where(np.where(values < 0.0, self.sides[:, 0], self.sides[:, 1]) > 0.0, values, 0.0))

    def real_sizes(self, values: FloatArray) -> FloatArray:
        """Sizes of real scalars: values over the side on which they are; infinite where that has no width."""
        side = np.where(values < 0.0, self.sides[:, 0], self.sides[:, 1])
        sizes = np.where(values == 0.0, 0.0, np.inf)
        return np.asarray(np.divide(np.abs(values), side, out=sizes, where=(side > 0.0) & (values != 0.0)))

    def _square(self, w: ComplexArray, z: slice) -> float:
        seen = self.M[z] @ w
        return max(float(np.vdot(seen, seen).real), TINY)

    def _quotient(self, w: ComplexArray, z: slice, own: slice) -> complex:
        return complex(np.vdot(self.M[z] @ w, w[own])) / self._square(w, z)

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
        own = -deltas[self._owner, None] * self.M[self._z]
        own[rows, self._w] += 1.0
        slopes = np.zeros((len(rows), self.count), complex)
        slopes[:, : self.width], slopes[:, self.width : 2 * self.width] = own, 1j * own
        seen = self.M[self._z] @ w
        slopes[rows, self._re[self._owner]] = -seen
        two = ~self.real[self._owner]
        slopes[rows[two], self._re[self._owner[two]] + 1] = -1j * seen[two]
        return np.concatenate([slopes.real, slopes.imag])

    def inequalities(self, x: FloatArray) -> FloatArray:
        """What each block has left to the size: real scalars on both sides, complex scalars, full blocks."""
        w, deltas, size = self._unpacked(x)
        real, other = deltas[self.real].real, deltas[~self.real]
        seen = [(self.M[z] @ w, w[own]) for z, own in self.full]
        full = [size**2 * np.vdot(z, z).real - np.vdot(own, own).real for z, own in seen]
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
        for row, (z, own) in enumerate(self.full, end):
            seen = self.M[z] @ w
            slope = 2.0 * size**2 * (self.M[z].conj().T @ seen)
            slope[own] -= 2.0 * w[own]
            slopes[row, :n], slopes[row, n : 2 * n] = slope.real, slope.imag
            slopes[row, -1] = 2.0 * size * np.vdot(seen, seen).real
        return slopes

    def _delta(self, x: FloatArray) -> ComplexArray:
        w, deltas, _ = self._unpacked(x)
        matrix = np.zeros(self.M.shape[::-1], complex)
        scalars = iter(deltas)
        for block, z, own in self.parts:
            if block.kind == FULL:
                matrix[own, z] = np.outer(w[own], (self.M[z] @ w).conj()) / self._square(w, z)
            else:
                matrix[own, z] = next(scalars) * np.eye(block.rows)
        return matrix


def _indices(slices: Sequence[slice]) -> Any:
    return np.concatenate([np.zeros(0, int), *(np.arange(part.start, part.stop) for part in slices)]).astype(int)
