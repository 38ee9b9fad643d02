"""Gains of one model on a fixed grid of frequencies, with gradients and Gauss-Newton matrices.

Between two refreshes of the grid every value is a smooth function of the controller at fixed frequencies: no peak is
refined and no Lyapunov equation is solved. H2 norms are sums over the grid, scaled to the exact norm at the refresh.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lftkit.analysis.batched_linalg import determinants, leading_pairs, smooth_gains, smooth_slopes, solve
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.tuning.gains.controller_response import ControllerFactors, controller_modes
from lftkit.tuning.gains.plant_responses import Arrays, PlantResponses


@dataclass
class _Closed:
    """Controller, closed-loop responses, ``S = I - K P22`` and ``M = S^-1 K`` on the grid."""

    own: ControllerFactors
    responses: dict[int, ComplexArray]
    S: ComplexArray
    M: ComplexArray


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
        self._last: tuple[bytes, _Closed] | None = None

    def gains(
        self, K: FloatArray, *, power: float = np.inf, h2: bool = True
    ) -> tuple[dict[int, FloatArray], dict[int, float]]:
        """Singular values (N,) of the H-infinity requirements, largest ones or smooth bounds of them, and H2 norms.

        Of three singular values and more the norm of a `power` of at least this size stands for the largest.
        """
        T = self._closed(K, self.hinf + (self.h2 if h2 else ())).responses
        norms = {i: self.calibration.get(i, 1.0) * float(np.sqrt(self._square(T[i]) / np.pi)) for i in self.h2 if h2}
        return {i: smooth_gains(T[i], power) for i in self.hinf}, norms

    def essential(self, K: FloatArray, *, h2: bool) -> BoolArray:
        """Mask (N,) of the frequencies at which a gain is not small, and of every fourth of the others.

        It is small below a tenth of its peak, a contribution to an H2 norm below a tenth of the mean one.
        """
        closed = self._closed(K, self.hinf + (self.h2 if h2 else ())).responses
        kept = np.arange(len(self.arrays.omega)) % 4 == 0
        kept[[0, -1]] = True
        for i, T in closed.items():
            squares = np.sum(T.real**2 + T.imag**2, axis=(1, 2))
            if i in self.hinf:
                kept |= squares > 0.1**2 * squares.max(initial=0.0)
            else:
                kept |= squares * self.widths > 0.1 * self._square(T) / len(kept)
        return np.asarray(kept)

    def _square(self, T: ComplexArray) -> float:
        return float(self.widths @ np.sum(T.real**2 + T.imag**2, axis=(1, 2)))

    def _closed(self, K: FloatArray, which: tuple[int, ...]) -> _Closed:
        """The closed loop with the gain matrix `K`; that of the last one is kept."""
        key = K.tobytes()
        if self._last is None or self._last[0] != key:
            controller = self.plant.controller(K, self.order, self.arrays.omega)
            self._last = key, _Closed(controller, *self.plant.closed(self.arrays, controller, which))
        known = self._last[1]
        missing = tuple(i for i in which if i not in known.responses)
        if missing:
            known.responses.update(self.plant.responses(self.arrays, known.M, missing))
        return known

    def peak_gradients(self, K: FloatArray, i: int, index: IntArray) -> list[tuple[float, FloatArray]]:
        """Largest singular values at some frequencies with their gradients, shape of K."""
        s, rows, columns = self._slopes(K, i, index)
        return [(float(s[j, 0]), np.real(np.outer(rows[j], columns[j]))) for j in range(len(index))]

    def slopes(self, K: FloatArray, i: int, index: IntArray) -> tuple[FloatArray, FloatArray]:
        """All singular values (m, r) at the frequencies `index` (m,) with their gradients (m, r, *shape of K)."""
        loop, arrays = self._closed(K, (i,)), self.arrays
        T = loop.responses[i][index]
        s, U, V = leading_pairs(T)
        P12, P21 = self.plant.sides(arrays, i, T, index)
        into = U.conj().swapaxes(1, 2) @ P12
        row = loop.own.rows(solve(loop.S[index].swapaxes(1, 2), into.swapaxes(1, 2)).swapaxes(1, 2), index)
        forward = P21 @ V
        column = loop.own.columns(forward + arrays.P22[index] @ (loop.M[index] @ forward), index)
        return s, np.real(row[:, :, :, None] * column.swapaxes(1, 2)[:, :, None, :])

    def weighted_gradient(
        self, K: FloatArray, i: int, weights: FloatArray, index: IntArray, power: float = np.inf
    ) -> FloatArray:
        """Gradient of the weighted sum of the values of :meth:`gains` at the frequencies `index`."""
        T = self._closed(K, (i,)).responses[i][index]
        if power < np.inf and min(T.shape[1:]) > 2:
            left, right = self._factors(K, i, index)
            slope = right @ (smooth_slopes(T, power) * weights[:, None, None]).conj().swapaxes(1, 2)
            return np.asarray(np.real(np.tensordot(left, slope.swapaxes(1, 2), axes=((0, 1), (0, 1)))))
        _, rows, columns = self._slopes(K, i, index)
        return np.asarray(np.real(rows.T @ (weights[:, None] * columns)))

    def _slopes(self, K: FloatArray, i: int, index: IntArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Singular values (m, r) at the frequencies `index` (m,) with the factors of the largest one's slope.

        ``ds = Re(rows dK columns)``, shapes (m, order + u) and (m, order + y).
        """
        loop, arrays = self._closed(K, (i,)), self.arrays
        T = loop.responses[i][index]
        s, U, V = leading_pairs(T)
        P12, P21 = self.plant.sides(arrays, i, T, index)
        into = U[:, None, :, 0].conj() @ P12
        row = solve(loop.S[index].swapaxes(1, 2), into.swapaxes(1, 2)).swapaxes(1, 2)
        forward = P21 @ V[:, :, :1]
        column = forward + arrays.P22[index] @ (loop.M[index] @ forward)
        return s, loop.own.rows(row, index)[:, 0], loop.own.columns(column, index)[:, :, 0]

    def h2_gradient(self, K: FloatArray, i: int) -> FloatArray:
        """Gradient of the H2 norm of requirement i.

        Half the slope of ``sum |T|^2`` is the real part of the sum of ``(P12 S^-1 left)' (right F T^H)'`` with
        ``F = (I + P22 M) P21``.
        """
        loop, arrays = self._closed(K, (i,)), self.arrays
        T = loop.responses[i]
        back = arrays.P21[i] @ T.conj().swapaxes(1, 2)
        back = loop.own.columns(back + arrays.P22 @ (loop.M @ back))
        row = solve(loop.S.swapaxes(1, 2), arrays.P12[i].swapaxes(1, 2)).swapaxes(1, 2)
        left = loop.own.rows(row * self.widths[:, None, None])
        slope = np.real(np.tensordot(left, back.swapaxes(1, 2), axes=((0, 1), (0, 1))))
        return np.asarray(self.calibration.get(i, 1.0) / np.sqrt(np.pi * max(self._square(T), 1e-300)) * slope)

    def gauss_newton(self, K: FloatArray, i: int, weights: FloatArray, most: int = 64) -> FloatArray:
        """``sum_k w_k (left Gram) (x) (right Gram)`` of ``dT = left dK right``: the squared size of dT in dK.

        Shape (a, b, a, b) for K (a, b). The sum is over at most `most` of the frequencies whose weights are
        positive, each for its neighbours.
        """
        index = np.flatnonzero(weights > 0.0)
        step = -(-len(index) // most)
        ends = np.arange(0, len(index), step)
        sums = np.add.reduceat(weights[index], ends)
        heaviest = [int(start + np.argmax(weights[index[start : start + step]])) for start in ends]
        left, right = self._factors(K, i, index[heaviest])
        a, b = K.shape
        GL = (left.conj().swapaxes(1, 2) @ left).reshape(len(ends), a * a)
        GR = (right @ right.conj().swapaxes(1, 2)).reshape(len(ends), b * b)
        both = np.real((GL * sums[:, None]).T @ GR).reshape(a, a, b, b)
        return np.asarray(both.transpose(0, 3, 1, 2))

    def _factors(self, K: FloatArray, i: int, index: IntArray) -> tuple[ComplexArray, ComplexArray]:
        """Factors of ``dT = left dK right`` at the frequencies `index` (m,), (m, z, a) and (m, b, w)."""
        loop, arrays = self._closed(K, (i,)), self.arrays
        P12, P21 = self.plant.sides(arrays, i, loop.responses[i][index], index)
        row = solve(loop.S[index].swapaxes(1, 2), P12.swapaxes(1, 2)).swapaxes(1, 2)
        column = P21 + arrays.P22[index] @ (loop.M[index] @ P21)
        return loop.own.rows(row, index), loop.own.columns(column, index)

    def return_determinant(self, K: FloatArray) -> ComplexArray:
        """``det(jw - A_K) det(I - K P22)`` at the frequencies of the grid, infinity left out."""
        finite = np.isfinite(self.arrays.omega)
        determinant = determinants(self._closed(K, ()).S[finite])
        for pole in controller_modes(K, self.order)[0] if self.order else ():
            determinant = determinant * (1j * self.arrays.omega[finite] - pole)
        return np.asarray(determinant)
