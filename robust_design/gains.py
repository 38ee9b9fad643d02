"""Frequency side of a closed loop: H-infinity gains of one model as a function of the gain matrix, fast.

The plant does not change while the controller is tuned. Its response is computed once on a refined grid; for a
new controller only ``T = P11 + P12 (I - K P22)^-1 K P21`` is formed, with small matrices. Peaks are refined with exact
responses between the grid points, closed-loop poles whose resonance the grid does not resolve add their own
frequencies. The delay is exact: ``exp(-j w delay)`` multiplies the command columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lti.batched_linalg import gains_above, leading_pairs, solve
from lti.frequency_grid import frequency_grid
from lti.frequency_response import FrequencyResponse
from lti.state_space_model import StateSpace
from robust_design.requirements import HinfGain

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

GRID_OFFSETS = (0.0, 0.4, 1.0, 2.5, 6.0, 15.0)  # around a pole: its gain changes by less than 2.5 between them
REFINEMENTS = 12
HIGH_CELL, MAX_CELLS = 0.9, 60
NEAR_MULTIPLE = 0.98  # singular values this close to the largest give subgradients of their own


@dataclass(frozen=True)
class Peak:
    """A local maximum of the gain: value, frequency [rad/s] and gradient with respect to the gain matrix."""

    value: float
    omega: float
    gradient: FloatArray | None


@dataclass(frozen=True)
class _Arrays:
    """Plant responses at N frequencies for one model."""

    omega: FloatArray
    P11: tuple[ComplexArray, ...]
    P12: tuple[ComplexArray, ...]
    P21: tuple[ComplexArray, ...]
    P22: ComplexArray


class LoopGains:
    """H-infinity gains of one model for several requirements at once.

    Parameters
    ----------
    model : StateSpace
    measurements, commands : tuple of str
        Ports between which the controller stands.
    requirements : tuple of HinfGain
    loop_delay : float
        Delay of the loop [s], exact.
    per_decade : int
        Density of the logarithmic part of the grid.
    """

    def __init__(
        self,
        model: StateSpace,
        measurements: tuple[str, ...],
        commands: tuple[str, ...],
        requirements: tuple[HinfGain, ...],
        loop_delay: float = 0.0,
        per_decade: int = 50,
    ) -> None:
        self.requirements = requirements
        self._delay = loop_delay
        self._commands = len(model.input_indices(commands))
        self._groups: list[int] = []
        keys: list[tuple[tuple[str, ...], int]] = []
        for r in requirements:
            key = (r.inputs, id(r.weight_in))
            if key not in keys:
                keys.append(key)
            self._groups.append(keys.index(key))
        used_in = list(dict.fromkeys(n for r in requirements for n in r.inputs))
        used_out = list(dict.fromkeys(n for r in requirements for n in r.outputs))
        cw, cu = model.input_indices(used_in), model.input_indices(commands)
        rz, ry = model.output_indices(used_out), model.output_indices(measurements)
        columns, rows = np.r_[cw, cu], np.r_[rz, ry]
        self._response = FrequencyResponse.of(
            model.A, model.B[:, columns], model.C[rows], model.D[np.ix_(rows, columns)]
        )
        self._split = (len(rz), len(cw))
        self._columns = [_places(cw, model.input_indices(r.inputs)) for r in requirements]
        self._rows = [_places(rz, model.output_indices(r.outputs)) for r in requirements]
        self._weights = [(_weight(r.weight_in), _weight(r.weight_out), 1.0 / r.bound) for r in requirements]
        self._grid = self._arrays(self._frequencies(per_decade))

    def _frequencies(self, per_decade: int) -> FloatArray:
        poles = [self._response.poles]
        poles += [w.poles for pair in self._weights for w in pair[:2] if w is not None]
        every = np.concatenate(poles)
        sizes = np.abs(every[np.abs(every) > 1e-9])
        if len(sizes) == 0:
            sizes = np.array([1.0])
        grid = frequency_grid(
            every, sizes.min() / 30.0, sizes.max() * 30.0, per_decade=per_decade, offsets=GRID_OFFSETS
        )
        above = np.geomspace(grid[-1], 100.0 * grid[-1], per_decade)[1:]
        # at a pole in the origin the open loop has no value: the closed loop's limit is taken a little above
        at_origin = np.any(np.abs(every) <= 1e-9)
        return np.concatenate([[1e-5 * sizes.min() if at_origin else 0.0], grid, above, [np.inf]])

    def _arrays(self, omega: FloatArray) -> _Arrays:
        with np.errstate(divide="ignore", invalid="ignore"):
            P = self._response.at(omega)
        nz, nw = self._split
        if self._delay:
            finite = np.where(np.isfinite(omega), omega, 0.0)
            P[:, :, nw:] *= np.exp(-1j * finite * self._delay)[:, None, None]
        P11: list[ComplexArray] = []
        P12: list[ComplexArray] = []
        P21: list[ComplexArray] = []
        for i, (w_in, w_out, scale) in enumerate(self._weights):
            rows, columns = self._rows[i], self._columns[i]
            first = P[:, rows][:, :, columns] * scale
            second = P[:, rows, nw:] * scale
            third = P[:, nz:][:, :, columns]
            if w_out is not None:
                W = w_out.at(omega)
                first, second = W @ first, W @ second
            if w_in is not None:
                W = w_in.at(omega)
                first, third = first @ W, third @ W
            P11.append(first)
            P12.append(second)
            P21.append(third if i == self._groups.index(self._groups[i]) else P21[self._groups.index(self._groups[i])])
        return _Arrays(omega, tuple(P11), tuple(P12), tuple(P21), P[:, nz:, nw:])

    def _closed(
        self, arrays: _Arrays, K: ComplexArray, which: tuple[int, ...]
    ) -> tuple[dict[int, ComplexArray], ComplexArray]:
        """Closed-loop responses of the requirements `which`, and ``M = (I - K P22)^-1 K``."""
        M = solve(np.eye(self._commands) - K @ arrays.P22, K)
        forward: dict[int, ComplexArray] = {}
        out = {}
        for i in which:
            group = self._groups[i]
            if group not in forward:
                forward[group] = M @ arrays.P21[i]
            out[i] = arrays.P11[i] + arrays.P12[i] @ forward[group]
        return out, M

    def peaks(
        self,
        gain_matrix: FloatArray,
        order: int,
        *,
        closed_loop_poles: ComplexArray,
        band: float,
        floor: float = 0.0,
        most: int = 24,
        gradients: bool = True,
    ) -> list[list[Peak]]:
        """For each requirement the local maxima above `band` times its largest gain (and above `floor`).

        Parameters
        ----------
        gain_matrix : ndarray, shape (order + u, order + y)
        order : int
            Order of the controller.
        closed_loop_poles : ndarray, complex
            Poles of the (stable) closed loop [rad/s], which say where the grid must be finer.
        band : float
            Between 0 and 1.
        floor : float
            Peaks below this value are of no interest (the largest one is always given).
        most : int
            Largest number of peaks for a requirement.
        """
        which = tuple(range(len(self.requirements)))
        sets = [self._grid]
        extra = self._unresolved(closed_loop_poles)
        if len(extra):
            sets.append(self._arrays(extra))
        responses = [
            self._closed(arrays, controller_response(gain_matrix, order, arrays.omega), which)[0] for arrays in sets
        ]
        omega = np.concatenate([arrays.omega for arrays in sets])
        index = np.argsort(omega, kind="stable")
        omega = omega[index]
        found: list[list[Peak]] = []
        for i in which:
            parts = [gains_above(response[i], min(band, 0.5)) for response in responses]
            w, gains = self._split_high_cells(omega, np.concatenate(parts)[index], gain_matrix, order, i)
            top = float(gains.max())
            places = _local_maxima(gains, max(band * top, min(floor, top)))[:most]
            at, value = self._refined(w, gains, places, gain_matrix, order, i)
            if gradients:
                also = _shoulders(gains, band * top, places)
                at, value = np.concatenate([at, w[also]]), np.concatenate([value, gains[also]])
            found.append(self._with_gradients(gain_matrix, order, i, at, value, gradients))
        return found

    def _unresolved(self, poles: ComplexArray) -> FloatArray:
        """Frequencies of closed-loop resonances that the grid does not resolve."""
        light = poles[(poles.imag > 0) & (np.abs(poles.real) < 0.5 * np.abs(poles))]
        grid = self._grid.omega
        place = np.clip(np.searchsorted(grid, light.imag), 1, len(grid) - 1)
        gap = np.minimum(np.abs(grid[place] - light.imag), np.abs(light.imag - grid[place - 1]))
        missing = light[gap > 0.4 * np.abs(light.real)]
        steps = np.array([-1.0, -0.4, 0.0, 0.4, 1.0])
        near = (missing.imag[:, None] + steps * np.abs(missing.real)[:, None]).ravel()
        size = np.abs(poles)
        far = size[(size > grid[-2]) | ((size < grid[1]) & (size > 0))]
        new = np.unique(np.concatenate([near, (far[:, None] * np.array([0.3, 0.6, 1.0, 1.7, 3.0])).ravel()]))
        return np.setdiff1d(new[new > 0], grid)

    def _split_high_cells(
        self, w: FloatArray, gains: FloatArray, K: FloatArray, order: int, i: int
    ) -> tuple[FloatArray, FloatArray]:
        """Add the middle of every cell whose ends are both near the top: a peak may hide between two high points."""
        high = gains >= HIGH_CELL * gains.max()
        cells = np.flatnonzero(high[:-1] & high[1:] & np.isfinite(w[1:]))
        if len(cells) == 0:
            return w, gains
        cells = cells[np.argsort(-(gains[cells] + gains[cells + 1]), kind="stable")][:MAX_CELLS]
        middle = 0.5 * (w[cells] + w[cells + 1])
        response, _ = self._closed(self._arrays(middle), controller_response(K, order, middle), (i,))
        index = np.argsort(np.concatenate([w, middle]), kind="stable")
        added = np.concatenate([gains, gains_above(response[i], 0.0)])
        return np.concatenate([w, middle])[index], added[index]

    def _refined(
        self, w: FloatArray, gains: FloatArray, places: NDArray[np.intp], K: FloatArray, order: int, i: int
    ) -> tuple[FloatArray, FloatArray]:
        """Peaks between the grid points: golden sections and parabolas in all brackets at once."""
        inner = (places > 0) & (places < len(w) - 2) & np.isfinite(w[np.minimum(places + 1, len(w) - 1)])
        omega, value = w[places].copy(), gains[places].copy()
        act = np.flatnonzero(inner)
        if len(act) == 0:
            return omega, value
        p = places[act]
        x = np.column_stack([w[p - 1], w[p], w[p + 1]])
        y = np.column_stack([gains[p - 1], gains[p], gains[p + 1]])
        for step in range(REFINEMENTS):
            trial = _trial_points(x, y, step)
            sample = self._arrays(trial)
            response, _ = self._closed(sample, controller_response(K, order, trial), (i,))
            _narrow(x, y, trial, gains_above(response[i], 0.0))
            if np.all(x[:, 2] - x[:, 0] <= 1e-7 * x[:, 1]):
                break
            flat = y[:, 1] - np.minimum(y[:, 0], y[:, 2]) <= 1e-11 * y[:, 1]
            if np.all(flat):
                break
        omega[act], value[act] = x[:, 1], y[:, 1]
        return omega, value

    def _with_gradients(
        self, K: FloatArray, order: int, i: int, omega: FloatArray, value: FloatArray, gradients: bool
    ) -> list[Peak]:
        if not gradients:
            return [Peak(float(v), float(w), None) for v, w in zip(value, omega)]
        arrays = self._arrays(omega)
        Kw, left, right = controller_factors(K, order, omega)
        responses, M = self._closed(arrays, Kw, (i,))
        s, U, V = leading_pairs(responses[i])
        S = np.eye(self._commands) - Kw @ arrays.P22
        row = solve(S.swapaxes(1, 2), (U.conj().swapaxes(1, 2) @ arrays.P12[i]).swapaxes(1, 2))
        rows = row.swapaxes(1, 2) @ left
        forward = arrays.P21[i] @ V
        columns = right @ (forward + arrays.P22 @ (M @ forward))
        return sorted(
            (
                Peak(float(s[j, k]), float(omega[j]), np.real(np.outer(rows[j, k], columns[j, :, k])))
                for j in range(len(omega))
                for k in range(s.shape[1])
                if s[j, k] >= NEAR_MULTIPLE * s[j, 0]
            ),
            key=lambda peak: -peak.value,
        )


def controller_response(K: FloatArray, order: int, omega: FloatArray) -> ComplexArray:
    """``D_K + C_K (jw - A_K)^-1 B_K`` at the frequencies `omega` (N,): shape (N, u, y)."""
    n = order
    out = np.broadcast_to(K[n:, n:], (len(omega), *K[n:, n:].shape)).astype(complex)
    finite = np.isfinite(omega)
    if n == 0 or not finite.any():
        return out
    out[finite] += K[n:, :n] @ _resolvent(K[:n, :n], omega[finite]) @ K[:n, n:]
    return out


def controller_factors(K: FloatArray, order: int, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Response (N, u, y) and the factors of ``dK(jw) = left dK right``: (N, u, order + u), (N, order + y, y)."""
    n, N = order, len(omega)
    nu, ny = K.shape[0] - n, K.shape[1] - n
    left = np.zeros((N, nu, n + nu), dtype=complex)
    right = np.zeros((N, n + ny, ny), dtype=complex)
    left[:, :, n:], right[:, n:, :] = np.eye(nu), np.eye(ny)
    finite = np.isfinite(omega)
    if n and finite.any():
        Phi = _resolvent(K[:n, :n], omega[finite])
        left[finite, :, :n] = K[n:, :n] @ Phi
        right[finite, :n, :] = Phi @ K[:n, n:]
    return K[n:, n:] + K[n:, :n] @ right[:, :n, :], left, right


def _resolvent(A: FloatArray, omega: FloatArray) -> ComplexArray:
    n = len(A)
    # an exact controller integrator has no value at 0: the limit is taken a hair above
    w = np.where(omega == 0.0, 1e-12, omega)
    shifted = 1j * w[:, None, None] * np.eye(n) - A
    return solve(shifted, np.broadcast_to(np.eye(n, dtype=complex), shifted.shape))


def _weight(weight: StateSpace | None) -> FrequencyResponse | None:
    return None if weight is None else FrequencyResponse.of(*weight.matrices)


def _local_maxima(gains: FloatArray, level: float) -> NDArray[np.intp]:
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    top = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]) & (gains >= level)
    places = np.flatnonzero(top)
    return places[np.argsort(-gains[places], kind="stable")]


def _shoulders(gains: FloatArray, level: float, peaks: NDArray[np.intp], most: int = 10) -> NDArray[np.intp]:
    """Grid points above `level` beside the peaks (Apkarian and Noll's extended set of frequencies).

    Each is a lower bound of the norm in its own right; with them a step sees a peak that would grow beside the present
    one, most of all at zero frequency.
    """
    high = np.setdiff1d(np.flatnonzero(gains >= level), peaks)
    if len(high) > most:
        high = high[np.unique(np.linspace(0, len(high) - 1, most).astype(int))]
    return high


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


def _places(chosen: NDArray[np.intp], wanted: NDArray[np.intp]) -> NDArray[np.intp]:
    where = {int(index): place for place, index in enumerate(chosen)}
    return np.array([where[int(index)] for index in wanted], dtype=np.intp)
