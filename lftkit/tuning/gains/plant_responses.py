"""Responses of one plant at many frequencies, arranged for closing the loop with any controller.

The plant does not change while the controller is tuned. For a controller with response K only
``T = P11 + P12 (I - K P22)^-1 K P21`` is formed, with small matrices. The delay is exact: it belongs to the
controller's response, ``exp(-j w delay) K``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lftkit.analysis.batched_linalg import solve
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.systems.system import System
from lftkit.tuning.gains.controller_response import ControllerFactors, controller_at
from lftkit.tuning.gains.prefeedback import applied, prefeedback
from lftkit.tuning.requirements import H2Gain, HinfGain
from lftkit.tuning.requirements.gains import band_edges
from lftkit.tuning.requirements.sector import SectorGain


@dataclass(frozen=True)
class Arrays:
    """Responses of the plant at N frequencies [rad/s]; P11, P12 and P21 by the number of the requirement."""

    omega: FloatArray
    P11: dict[int, ComplexArray]
    P12: dict[int, ComplexArray]
    P21: dict[int, ComplexArray]
    P22: ComplexArray

    def at(self, index: IntArray) -> Arrays:
        """The same at some of the frequencies."""
        first, second = ({i: P[index] for i, P in part.items()} for part in (self.P11, self.P12))
        third = _once(self.P21, lambda i: self.P21[i][index])
        return Arrays(self.omega[index], first, second, third, self.P22[index])

    def merged(self, other: Arrays) -> Arrays:
        """The frequencies of both, ascending."""
        omega = np.concatenate([self.omega, other.omega])
        index = np.argsort(omega, kind="stable")
        pairs = ((self.P11, other.P11), (self.P12, other.P12))
        first, second = ({i: np.concatenate([a[i], b[i]])[index] for i in a} for a, b in pairs)
        third = _once(self.P21, lambda i: np.concatenate([self.P21[i], other.P21[i]])[index])
        return Arrays(omega[index], first, second, third, np.concatenate([self.P22, other.P22])[index])


def _apart_from_origin(poles: ComplexArray) -> FloatArray:
    """Magnitudes of poles [rad/s] other than those that rounding may have moved from the origin; at least one."""
    sizes = np.abs(poles)
    apart = sizes[sizes > min(1e-9, 1e-13 * sizes.max(initial=0.0))]
    return apart if len(apart) else np.ones(1)


class PlantResponses:
    """One model with the weights of several gain requirements.

    Parameters
    ----------
    model : System
    measurements, commands : tuple of str
        Ports between which the controller stands.
    requirements : tuple of HinfGain or H2Gain
    loop_delay : float
        Delay of the loop [s], exact.
    """

    def __init__(
        self,
        model: System,
        measurements: tuple[str, ...],
        commands: tuple[str, ...],
        requirements: tuple[HinfGain | H2Gain, ...],
        loop_delay: float = 0.0,
    ) -> None:
        self.requirements, self._delay = requirements, loop_delay
        self.groups: list[int] = []
        keys: list[tuple[tuple[str, ...], int]] = []
        for r in requirements:
            key = (r.inputs, id(r.weight_in))
            if key not in keys:
                keys.append(key)
            self.groups.append(keys.index(key))
        used_in = list(dict.fromkeys(n for r in requirements for n in r.inputs))
        used_out = list(dict.fromkeys(n for r in requirements for n in r.outputs))
        cw, cu = model.input_indices(used_in), model.input_indices(commands)
        rz, ry = model.output_indices(used_out), model.output_indices(measurements)
        columns, rows = np.r_[cw, cu], np.r_[rz, ry]
        self._split = nz, nw = len(rz), len(cw)
        D = model.D[np.ix_(rows, columns)]
        self._F = prefeedback(model.A, model.B[:, cu], model.C[ry], D[nz:, nw:])
        plant = applied(model.A, model.B[:, columns], model.C[rows], D, nz, nw, self._F)
        self._response = FrequencyResponse.of(*plant)
        self._slowest = float(_apart_from_origin(self._response.poles).min())
        self._columns = [_positions(cw, model.input_indices(r.inputs)) for r in requirements]
        self._rows = [_positions(rz, model.output_indices(r.outputs)) for r in requirements]
        self._weights = [(_weight(r.weight_in), _weight(r.weight_out), 1.0 / r.bound) for r in requirements]

    def grid(self, per_decade: int = 50) -> FloatArray:
        """Frequencies [rad/s] from 0 to infinity, fine around every lightly damped pole of plant and weights."""
        poles = [self._response.poles]
        poles += [w.poles for pair in self._weights for w in pair[:2] if w is not None]
        every = np.concatenate(poles)
        sizes = _apart_from_origin(every)
        offsets = (0.0, 0.4, 1.0, 2.5, 6.0, 15.0)  # the gain of a pole changes by less than 2.5 between them
        inner = frequency_grid(every, sizes.min() / 30.0, sizes.max() * 30.0, per_decade=per_decade, offsets=offsets)
        above = np.geomspace(inner[-1], 100.0 * inner[-1], per_decade)[1:]
        at_origin = np.any(np.abs(every) < sizes.min())
        grid = np.concatenate([[1e-5 * sizes.min() if at_origin else 0.0], inner, above, [np.inf]])
        return np.asarray(np.unique(np.concatenate([self._apart_from_poles(grid), band_edges(self.requirements)])))

    def _apart_from_poles(self, omega: FloatArray) -> FloatArray:
        """Frequencies moved off the poles that no feedback takes off the imaginary axis."""
        for w in self._response.on_axis:
            distance = 1e-4 * (w if w > self._slowest else self._slowest)
            omega = np.where(np.abs(omega - w) < distance, w + distance, omega)
        return omega

    def arrays(self, omega: FloatArray, which: tuple[int, ...] | None = None) -> Arrays:
        """Responses of the plant at the frequencies `omega` (N,) for the requirements `which` (all of them if None)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            P = self._response.at(self._apart_from_poles(omega))
        nz, nw = self._split
        P11: dict[int, ComplexArray] = {}
        P12: dict[int, ComplexArray] = {}
        P21: dict[int, ComplexArray] = {}
        shared: dict[int, ComplexArray] = {}
        for i in range(len(self.requirements)) if which is None else which:
            w_in, w_out, scale = self._weights[i]
            rows, columns = self._rows[i], self._columns[i]
            P11[i], P12[i] = P[:, rows][:, :, columns] * scale, P[:, rows, nw:] * scale
            if w_out is not None:
                W = w_out.at(omega)
                P11[i], P12[i] = W @ P11[i], W @ P12[i]
            if w_in is not None:
                P11[i] = P11[i] @ w_in.at(omega)
            r = self.requirements[i]
            if isinstance(r, HinfGain) and r.banded:  # no response at other frequencies
                count = r.counts(omega)[:, None, None]
                P11[i], P12[i] = np.where(count, P11[i], 0.0), np.where(count, P12[i], 0.0)
            if self.groups[i] not in shared:
                third = P[:, nz:][:, :, columns]
                shared[self.groups[i]] = third if w_in is None else third @ w_in.at(omega)
            P21[i] = shared[self.groups[i]]
        return Arrays(omega, P11, P12, P21, P[:, nz:, nw:])

    def controller(self, K: FloatArray, order: int, omega: FloatArray) -> ControllerFactors:
        """The controller with its delay, as the plant after its pre-feedback sees it."""
        factors = controller_at(K, order, omega)
        if not self._delay:
            return replace(factors, response=factors.response - self._F) if self._F.any() else factors
        turn = np.exp(-1j * np.where(np.isfinite(omega), omega, 0.0) * self._delay)[:, None, None]
        return replace(factors, response=factors.response * turn - self._F, turn=turn)

    def closed(
        self, arrays: Arrays, K: ControllerFactors, which: tuple[int, ...]
    ) -> tuple[dict[int, ComplexArray], ComplexArray, ComplexArray]:
        """Closed-loop responses of the requirements `which`, ``S = I - K P22`` and ``M = S^-1 K``.

        Infinite or NaN at a frequency that is a pole of the loop.
        """
        S = np.eye(K.response.shape[1]) - K.response @ arrays.P22
        with np.errstate(divide="ignore", invalid="ignore"):
            M = solve(S, K.response)
        return self.responses(arrays, M, which), S, M

    def responses(self, arrays: Arrays, M: ComplexArray, which: tuple[int, ...]) -> dict[int, ComplexArray]:
        """Closed-loop responses of the requirements `which` with ``M = S^-1 K``."""
        forward: dict[int, ComplexArray] = {}
        out = {}
        with np.errstate(invalid="ignore"):
            for i in which:
                group = self.groups[i]
                if group not in forward:
                    forward[group] = M @ arrays.P21[i]
                out[i] = arrays.P11[i] + arrays.P12[i] @ forward[group]
                r = self.requirements[i]
                if isinstance(r, SectorGain):
                    out[i] = r.indexed(out[i], arrays.omega)
        return out

    def sides(
        self, arrays: Arrays, i: int, T: ComplexArray, index: IntArray | slice = slice(None)
    ) -> tuple[ComplexArray, ComplexArray]:
        """P12 and P21 of requirement i at some frequencies, as its values T (m, z, w) there depend on the loop.

        ``dT = P12 S^-1 dK (I + P22 M) P21``; those of the index of a sector have the factors of its slope.
        """
        r, left, right = self.requirements[i], arrays.P12[i][index], arrays.P21[i][index]
        if isinstance(r, SectorGain):
            before, after = r.slopes(T)
            return before @ left, right @ after
        return left, right


def _once(arrays: dict[int, ComplexArray], change: Callable[[int], ComplexArray]) -> dict[int, ComplexArray]:
    """The changed arrays, those of requirements that share one array changed once."""
    changed: dict[int, ComplexArray] = {}
    by_identity: dict[int, int] = {}
    for i, array in arrays.items():
        first = by_identity.setdefault(id(array), i)
        changed[i] = changed[first] if first in changed else change(i)
    return changed


def _weight(weight: System | None) -> FrequencyResponse | None:
    return None if weight is None else FrequencyResponse.of(*weight.matrices)


def _positions(chosen: Any, indices: Any) -> IntArray:
    position = {int(index): k for k, index in enumerate(chosen)}
    return np.array([position[int(index)] for index in indices], dtype=np.intp)
