"""H-infinity gains of one model as a function of the gain matrix, with their peaks refined.

The response of the plant is computed once on a refined grid. Peaks are refined with exact responses between the grid
points; closed-loop poles whose resonance the grid does not resolve add their own frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.analysis.batched_linalg import gains_above, leading_pairs, solve
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.tuning.gains.plant_responses import Arrays, PlantResponses


@dataclass(frozen=True)
class GainPeak:
    """A local maximum of the gain: value, frequency [rad/s] and gradient with respect to the gain matrix."""

    value: float
    omega: float
    gradient: FloatArray | None


class LoopGains:
    """H-infinity gains of one model for several requirements at once.

    Parameters
    ----------
    plant : PlantResponses
    which : tuple of int
        Numbers of the H-infinity requirements among those of the plant.
    grid : Arrays, optional
        Responses on the first grid.
    """

    def __init__(self, plant: PlantResponses, which: tuple[int, ...], grid: Arrays | None = None) -> None:
        self.plant, self._which = plant, which
        self._first_grid = self.grid = plant.arrays(plant.grid()) if grid is None else grid

    def copied(self) -> LoopGains:
        """The same gains, with the grid as it was at first: for controllers of another structure."""
        return LoopGains(self.plant, self._which, self._first_grid)

    def add(self, omega: FloatArray) -> None:
        """Add frequencies [rad/s] to the grid."""
        new = np.setdiff1d(omega[np.isfinite(omega) & (omega > 0.0)], self.grid.omega)
        if len(new):
            self.grid = self.grid.merged(self.plant.arrays(new))

    def _gains(self, K: FloatArray, order: int, omega: FloatArray, i: int) -> FloatArray:
        """Exact gains of requirement i at the frequencies `omega` (N,)."""
        response, _, _ = self.plant.closed(self.plant.arrays(omega, (i,)), self.plant.controller(K, order, omega), (i,))
        return gains_above(response[i], 0.0)

    def peaks(
        self,
        gain_matrix: FloatArray,
        order: int,
        *,
        closed_loop_poles: ComplexArray,
        band: float,
        gradients: bool = True,
    ) -> list[list[GainPeak]]:
        """For each requirement the local maxima above `band` times its largest gain.

        Parameters
        ----------
        gain_matrix : ndarray, shape (order + u, order + y)
        order : int
            Order of the controller.
        closed_loop_poles : ndarray, complex
            Poles of the (stable) closed loop [rad/s], which say where the grid must be finer.
        band : float
            Between 0 and 1.
        """
        which = self._which
        sets = [self.grid]
        extra = unresolved(self.grid.omega, closed_loop_poles)
        if len(extra):
            sets.append(self.plant.arrays(extra, which))
        responses = [
            self.plant.closed(arrays, self.plant.controller(gain_matrix, order, arrays.omega), which)[0]
            for arrays in sets
        ]
        omega = np.concatenate([arrays.omega for arrays in sets])
        index = np.argsort(omega, kind="stable")
        omega = omega[index]
        by_gain: list[list[GainPeak]] = []
        for i in which:
            parts = [gains_above(response[i], min(band, 0.5)) for response in responses]
            w, gains = self._split_high_cells(omega, np.concatenate(parts)[index], gain_matrix, order, i)
            top = float(gains.max())
            padded = np.concatenate([[-np.inf], gains, [-np.inf]])
            maximal = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]) & (gains >= band * top)
            maxima = np.flatnonzero(maximal)
            maxima = maxima[np.argsort(-gains[maxima], kind="stable")][:24]
            at, value = self._refined(w, gains, maxima, gain_matrix, order, i)
            if not gradients:
                by_gain.append([GainPeak(float(v), float(peak), None) for v, peak in zip(value, at)])
                continue
            # Points of the grid beside the peaks are lower bounds of the norm in their own right (Apkarian and Noll's
            # extended set of frequencies): a step sees a peak that would grow there, most of all at zero frequency
            also = np.setdiff1d(np.flatnonzero(gains >= band * top), maxima)
            if len(also) > 10:
                also = also[np.unique(np.linspace(0, len(also) - 1, 10).astype(int))]
            at = np.concatenate([at, w[also]])
            s, rows, columns = singular_slopes(self.plant, self.plant.arrays(at, (i,)), gain_matrix, order, i)
            peaks = (
                GainPeak(float(s[j, k]), float(at[j]), np.real(np.outer(rows[j, k], columns[j, :, k])))
                for j in range(len(at))
                for k in range(s.shape[1])
                if s[j, k] >= 0.98 * s[j, 0]  # those this close to the largest give subgradients of their own
            )
            by_gain.append(sorted(peaks, key=lambda peak: -peak.value))
        return by_gain

    def _split_high_cells(
        self, w: FloatArray, gains: FloatArray, K: FloatArray, order: int, i: int
    ) -> tuple[FloatArray, FloatArray]:
        """Add the middle of every cell whose ends are both near the top: a peak may hide between two high points."""
        high = gains >= 0.9 * gains.max()
        cells = np.flatnonzero(high[:-1] & high[1:] & np.isfinite(w[1:]))
        if len(cells) == 0:
            return w, gains
        cells = cells[np.argsort(-(gains[cells] + gains[cells + 1]), kind="stable")][:60]
        middle = 0.5 * (w[cells] + w[cells + 1])
        index = np.argsort(np.concatenate([w, middle]), kind="stable")
        added = np.concatenate([gains, self._gains(K, order, middle, i)])
        return np.concatenate([w, middle])[index], added[index]

    def _refined(
        self, w: FloatArray, gains: FloatArray, maxima: IntArray, K: FloatArray, order: int, i: int
    ) -> tuple[FloatArray, FloatArray]:
        """Peaks between the grid points: golden sections and parabolas in all brackets at once."""
        inner = (maxima > 0) & (maxima < len(w) - 2) & np.isfinite(w[np.minimum(maxima + 1, len(w) - 1)])
        omega, value = w[maxima].copy(), gains[maxima].copy()
        act = np.flatnonzero(inner)
        if len(act) == 0:
            return omega, value
        p = maxima[act]
        x = np.column_stack([w[p - 1], w[p], w[p + 1]])
        y = np.column_stack([gains[p - 1], gains[p], gains[p + 1]])
        for step in range(12):
            trial = _trial_points(x, y, step)
            _narrow(x, y, trial, self._gains(K, order, trial, i))
            if np.all(x[:, 2] - x[:, 0] <= 1e-7 * x[:, 1]):
                break
            flat = y[:, 1] - np.minimum(y[:, 0], y[:, 2]) <= 1e-11 * y[:, 1]
            if np.all(flat):
                break
        omega[act], value[act] = x[:, 1], y[:, 1]
        return omega, value


def singular_slopes(
    plant: PlantResponses, arrays: Arrays, K: FloatArray, order: int, i: int
) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Singular values s (N, r) of requirement i with the factors of ``ds = Re(rows dK columns)``.

    Shapes (N, r, order + u) and (N, order + y, r).
    """
    controller = plant.controller(K, order, arrays.omega)
    responses, S, M = plant.closed(arrays, controller, (i,))
    s, U, V = leading_pairs(responses[i])
    P12, P21 = plant.sides(arrays, i, responses[i])
    row = solve(S.swapaxes(1, 2), (U.conj().swapaxes(1, 2) @ P12).swapaxes(1, 2))
    forward = P21 @ V
    return s, controller.rows(row.swapaxes(1, 2)), controller.columns(forward + arrays.P22 @ (M @ forward))


def _trial_points(x: FloatArray, y: FloatArray, step: int) -> FloatArray:
    """Vertex of the parabola through three points; every third time a golden section of the longer side."""
    a, b, c = x.T
    fa, fb, fc = y.T
    with np.errstate(divide="ignore", invalid="ignore"):
        up = (b - a) ** 2 * (fb - fc) - (b - c) ** 2 * (fb - fa)
        down = (b - a) * (fb - fc) - (b - c) * (fb - fa)
        vertex = b - 0.5 * up / down
    golden = np.where(c - b > b - a, b + 0.381966 * (c - b), b - 0.381966 * (b - a))
    near = np.abs(vertex - b) < 1e-3 * np.minimum(c - b, b - a)
    nudged = b + np.where(c - b > b - a, 0.02 * (c - b), -0.02 * (b - a))
    vertex = np.where(near, nudged, vertex)
    good = np.isfinite(vertex) & (vertex > a) & (vertex < c) & (vertex != b)
    if step % 3 == 2:
        good &= near
    return np.where(good, vertex, golden)


def _narrow(x: FloatArray, y: FloatArray, trial: FloatArray, value: FloatArray) -> None:
    """Put the trial points into the brackets, in place."""
    for j, (t, v) in enumerate(zip(trial, value)):
        right = t > x[j, 1]
        if v > y[j, 1]:
            if right:
                x[j, 0], y[j, 0] = x[j, 1], y[j, 1]
            else:
                x[j, 2], y[j, 2] = x[j, 1], y[j, 1]
            x[j, 1], y[j, 1] = t, v
        elif right:
            x[j, 2], y[j, 2] = t, v
        else:
            x[j, 0], y[j, 0] = t, v


def unresolved(grid: FloatArray, poles: ComplexArray) -> FloatArray:
    """Frequencies [rad/s] of closed-loop resonances that `grid` (N,) does not resolve."""
    light = poles[(poles.imag > 0) & (np.abs(poles.real) < 0.5 * np.abs(poles))]
    right = np.clip(np.searchsorted(grid, light.imag), 1, len(grid) - 1)
    gap = np.minimum(np.abs(grid[right] - light.imag), np.abs(light.imag - grid[right - 1]))
    missing = light[gap > 0.4 * np.abs(light.real)]
    steps = np.array([-1.0, -0.4, 0.0, 0.4, 1.0])
    near = (missing.imag[:, None] + steps * np.abs(missing.real)[:, None]).ravel()
    size = np.abs(poles)
    far = size[(size > grid[-2]) | ((size < grid[1]) & (size > 0))]
    new = np.unique(np.concatenate([near, (far[:, None] * np.array([0.3, 0.6, 1.0, 1.7, 3.0])).ravel()]))
    return np.setdiff1d(new[new > 0], grid)
