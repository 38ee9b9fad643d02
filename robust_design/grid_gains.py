"""Gains of one model on a fixed grid of frequencies, with gradients and Gauss-Newton matrices.

Between two refreshes of the grid every value is a smooth function of the controller at fixed frequencies: no peak is
refined and no Lyapunov equation is solved. H2 norms are sums over the grid, scaled to the exact norm at the refresh.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lti.batched_linalg import determinants, largest_gains, solve
from robust_design.gains import singular_slopes
from robust_design.plant_responses import Arrays, PlantResponses

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass
class GridGains:
    """One model on a fixed grid.

    Parameters
    ----------
    plant : PlantResponses
    arrays : Arrays
        Responses at the frequencies of the grid, ascending.
    order : int
        Order of the controller.
    hinf, h2 : tuple of int
        Numbers of the requirements of each kind among those of the plant.
    calibration : dict of int to float
        Exact H2 norm over the sum on the grid.
    """

    plant: PlantResponses
    arrays: Arrays
    order: int
    hinf: tuple[int, ...]
    h2: tuple[int, ...]
    calibration: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        omega = np.where(np.isfinite(self.arrays.omega), self.arrays.omega, 0.0)
        widths = np.zeros(len(omega))
        steps = np.maximum(np.diff(omega), 0.0)
        widths[:-1] += 0.5 * steps
        widths[1:] += 0.5 * steps
        self.widths = np.where(np.isfinite(self.arrays.omega), widths, 0.0)

    def gains(self, K: FloatArray, *, h2: bool = True) -> tuple[dict[int, FloatArray], dict[int, float]]:
        """Largest singular values (N,) of the H-infinity requirements, and the H2 norms."""
        own = self.plant.controller(K, self.order, self.arrays.omega)
        which = self.hinf + (self.h2 if h2 else ())
        T, _, _ = self.plant.closed(self.arrays, own, which)
        squares = {i: float(self.widths @ np.sum(np.abs(T[i]) ** 2, axis=(1, 2))) for i in which if i in self.h2}
        norms = {i: self.calibration.get(i, 1.0) * float(np.sqrt(s / np.pi)) for i, s in squares.items()}
        return {i: largest_gains(T[i]) for i in self.hinf}, norms

    def peak_gradients(self, K: FloatArray, i: int, index: NDArray[np.intp]) -> list[tuple[float, FloatArray]]:
        """Largest singular values at some frequencies with their gradients, shape of K."""
        s, rows, columns = singular_slopes(self.plant, self.arrays.at(index), K, self.order, i)
        return [(float(s[j, 0]), np.real(np.outer(rows[j, 0], columns[j, :, 0]))) for j in range(len(index))]

    def weighted_gradient(self, K: FloatArray, i: int, weights: FloatArray, index: NDArray[np.intp]) -> FloatArray:
        """Gradient of the weighted sum of the largest singular values at the frequencies `index`."""
        _, rows, columns = singular_slopes(self.plant, self.arrays.at(index), K, self.order, i)
        return np.asarray(np.real(rows[:, 0].T @ (weights[:, None] * columns[:, :, 0])))

    def h2_gradient(self, K: FloatArray, i: int) -> FloatArray:
        """Gradient of the H2 norm of requirement i."""
        left, right, T = self._factors(K, i)
        inner = left.conj().swapaxes(1, 2) @ T @ right.conj().swapaxes(1, 2)
        square = float(self.widths @ np.sum(np.abs(T) ** 2, axis=(1, 2)))
        slope = np.real(np.tensordot(self.widths, inner, axes=1)) / max(float(np.sqrt(square)), 1e-300)
        return np.asarray(self.calibration.get(i, 1.0) / np.sqrt(np.pi) * slope)

    def gauss_newton(self, K: FloatArray, i: int, weights: FloatArray) -> FloatArray:
        """``sum_k w_k (left Gram) (x) (right Gram)`` of ``dT = left dK right``: the squared size of dT in dK.

        Shape (a, b, a, b) for K (a, b).
        """
        index = np.flatnonzero(weights > 0.0)
        left, right, _ = self._factors(K, i, index)
        a, b = K.shape
        GL = (left.conj().swapaxes(1, 2) @ left).reshape(len(index), a * a)
        GR = (right @ right.conj().swapaxes(1, 2)).reshape(len(index), b * b)
        both = np.real((GL * weights[index, None]).T @ GR).reshape(a, a, b, b)
        return np.asarray(both.transpose(0, 3, 1, 2))

    def _factors(
        self, K: FloatArray, i: int, index: NDArray[np.intp] | None = None
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Factors of ``dT = left dK right``, (N, z, a) and (N, b, w), and T."""
        arrays = self.arrays if index is None else self.arrays.at(index)
        own = self.plant.controller(K, self.order, arrays.omega, factors=True)
        assert own.left is not None and own.right is not None
        T, S, M = self.plant.closed(arrays, own, (i,))
        left = solve(S.swapaxes(1, 2), arrays.P12[i].swapaxes(1, 2)).swapaxes(1, 2) @ own.left
        right = own.right @ (arrays.P21[i] + arrays.P22 @ (M @ arrays.P21[i]))
        return left, right, T[i]

    def return_determinant(self, K: FloatArray) -> ComplexArray:
        """``det(jw - A_K) det(I - K P22)`` at the frequencies of the grid, infinity left out."""
        finite = np.isfinite(self.arrays.omega)
        w = self.arrays.omega[finite]
        own = self.plant.controller(K, self.order, w)
        S = np.eye(own.response.shape[1]) - own.response @ self.arrays.P22[finite]
        n = self.order
        shifted = 1j * w[:, None, None] * np.eye(n) - K[:n, :n]
        return np.asarray(determinants(S) * (determinants(shifted) if n else 1.0))
