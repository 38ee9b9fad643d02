"""All requirements of one closed loop that is evaluated once: for samples of parameters.

The closed loop (delay by Padé) is brought to modal form once; gains are scanned at its resonances and on a
coarse grid, the
best peak is refined. Weights multiply in the frequency domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains, solve
from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.analysis.frequency_response import FrequencyResponse, direct_response
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.delay import delay_radius
from lftkit.systems.system import System
from lftkit.tuning.requirements import ControllerPoles, H2Gain, HinfGain, Poles, SectorGain, TuningRequirement
from lftkit.tuning.requirements.assembled_loop import PADE_ORDER, AssembledLoop
from lftkit.tuning.requirements.gains import band_edges


class ClosedLoopEvaluator:
    """Closed loop of one model.

    Parameters
    ----------
    model, controller : System
    loop_delay : float
        Delay on the commands [s].
    """

    def __init__(self, model: System, controller: System, loop_delay: float = 0.0) -> None:
        self._model, self._plain, self._delay = model, controller, loop_delay
        self._assembled = AssembledLoop(model, controller, loop_delay)
        measured = {p.name for p in controller.inputs}
        commanded = {p.name for p in controller.outputs}
        self._inputs = [p.name for p in model.inputs if p.name not in commanded]
        self._outputs = [p.name for p in model.outputs if p.name not in measured] + sorted(measured)
        self._loop = close_loop(model, self._assembled.controller, self._inputs, self._outputs)
        self._weights: dict[int, FrequencyResponse] = {}

    @cached_property
    def _response(self) -> FrequencyResponse:
        return FrequencyResponse.of(*self._loop.matrices)

    @property
    def abscissa(self) -> float:
        """Largest real part of the closed-loop poles [rad/s]."""
        return float(self._response.poles.real.max(initial=-np.inf))

    def values(self, requirements: Sequence[TuningRequirement]) -> tuple[FloatArray, FloatArray]:
        """Normalised values and peak frequencies [rad/s] of the requirements; infinite values where unstable."""
        count = len(requirements)
        values, frequencies = np.zeros(count), np.zeros(count)
        unstable = self.abscissa >= 0.0 or self._response.on_axis.size > 0  # to rounding
        if not all(isinstance(r, H2Gain) for r in requirements) and unstable:
            return np.full(count, np.inf), frequencies
        gains = [i for i, r in enumerate(requirements) if isinstance(r, HinfGain)]
        if gains:
            poles = self._response.poles
            low, high = pole_range(poles, zero=0.0)
            inner = frequency_grid(poles, low / 10.0, high * 10.0, per_decade=12, offsets=(0.0, 1.0))
            grid = np.unique(np.concatenate([[0.0], inner, [np.inf], band_edges(requirements)]))
            T = self._response.at(grid)
        for i, r in enumerate(requirements):
            if isinstance(r, HinfGain):
                r.check(self._model)
                values[i], frequencies[i] = self._peak(r, grid, T)
            elif isinstance(r, H2Gain):
                values[i] = r.certified(self._assembled, 0.0).value
            elif isinstance(r, Poles):
                poles = self._response.poles
                if isinstance(r, ControllerPoles):
                    poles = FrequencyResponse.of(*self._plain.matrices).poles
                elif self._delay:
                    poles = poles[np.abs(poles) < delay_radius(self._delay, PADE_ORDER)]
                values[i] = float(r.pieces(poles)[0].max(initial=-np.inf))
        return values, frequencies

    def _weighted(self, r: HinfGain, omega: FloatArray, T: ComplexArray) -> ComplexArray:
        rows, columns = self._loop.output_indices(r.outputs), self._loop.input_indices(r.inputs)
        part = T[:, rows][:, :, columns]
        if r.weight_out is not None:
            part = self._weight(r.weight_out).at(omega) @ part
        if r.weight_in is not None:
            part = part @ self._weight(r.weight_in).at(omega)
        if isinstance(r, SectorGain):
            return r.indexed(part / r.bound, omega) * r.bound
        return part * r.counts(omega)[:, None, None]

    def _weight(self, weight: System) -> FrequencyResponse:
        """A weight ready for evaluation, made once."""
        if id(weight) not in self._weights:
            self._weights[id(weight)] = FrequencyResponse.of(*weight.matrices)
        return self._weights[id(weight)]

    def _peak(self, r: HinfGain, grid: FloatArray, T: ComplexArray) -> tuple[float, float]:
        gains = largest_gains(self._weighted(r, grid, T))
        best, peak = -np.inf, 0.0
        inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] > gains[2:])) + 1
        high = inner[gains[inner] > 0.6 * gains.max()]
        for i in [*np.argsort(-gains)[:1].tolist(), *high[np.argsort(-gains[high])][1:3].tolist()]:
            value, omega = float(gains[i]), float(grid[i])
            if 0 < i < len(grid) - 2:
                value, omega = self._refined(r, grid[i - 1], grid[i + 1], value, omega)
            if value > best:
                best, peak = value, omega
        return best / r.bound, peak

    def _refined(self, r: HinfGain, low: float, high: float, best: float, peak: float) -> tuple[float, float]:
        for _ in range(8):
            points = np.asarray(np.linspace(low, high, 9), dtype=float)
            gains = largest_gains(self._weighted(r, points, self._response.at(points)))
            i = int(np.argmax(gains))
            if gains[i] > best:
                best, peak = float(gains[i]), float(points[i])
            low, high = points[max(i - 1, 0)], points[min(i + 1, 8)]
        return best, peak


def gain_at(model: System, controller: System, r: HinfGain, omega: float, K: ComplexArray, loop_delay: float) -> float:
    """Normalised gain of `r` at one frequency [rad/s] by a direct solution of the plant, delay exact.

    `K` is the controller's response (u, y) at `omega`.
    """
    if not r.counts(np.array([omega]))[0]:
        return 0.0
    u, y = [p.name for p in controller.outputs], [p.name for p in controller.inputs]
    cw, cu = model.input_indices(r.inputs), model.input_indices(u)
    rz, ry = model.output_indices(r.outputs), model.output_indices(y)
    columns, rows = np.r_[cw, cu], np.r_[rz, ry]
    P = direct_response(model.A, model.B[:, columns], model.C[rows], model.D[np.ix_(rows, columns)], omega)
    nz, nw = len(rz), len(cw)
    if np.isfinite(omega):
        P[:, nw:] *= np.exp(-1j * omega * loop_delay)
    inner = np.eye(len(cu)) - K @ P[nz:, nw:]
    T = P[:nz, :nw] + P[:nz, nw:] @ solve(inner[None], (K @ P[nz:, :nw])[None])[0]
    if r.weight_out is not None:
        T = direct_response(*r.weight_out.matrices, omega) @ T
    if r.weight_in is not None:
        T = T @ direct_response(*r.weight_in.matrices, omega)
    if isinstance(r, SectorGain):
        return float(largest_gains(r.indexed(T[None] / r.bound, np.array([omega])))[0])
    return float(largest_gains(T[None])[0]) / r.bound
