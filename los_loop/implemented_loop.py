"""Response of the implemented loop as a linear fractional function of the parameters, with gradients.

At one frequency the loop of the sampled controllers is closed around the telescope's LFT; what remains is a small
matrix with the 32 Delta channels, and every response at any parameter values is a solution of order 32::

    T(w, Delta) = T11 + T12 Delta (I - M Delta)^-1 T21
    d sigma / d Delta_c = Re( (sigma-left vector side)_c (right vector side)_c )

Inputs: Delta channels, 22 normalised disturbances, signals added to the 8 commands. Outputs: Delta channels, controlled
line of sight (2), the 8 commands applied to the plant.

Commands are held for a tick (:mod:`los_loop.open_loop`). The hold of
the values of slower sensors is its fundamental, the mean of the delays of a sample's ticks: sidebands are left out.
:func:`los_loop.sampled_loop_norms.tone_response` has both exactly and confirms what is found here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System
from lftkit.analysis.batched_linalg import largest_gains, singular_triples, singular_values, solve
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.figures_of_merit import FigureOfMerit, gain_figures
from los_loop.open_loop import OpenLoop, closed_lft
from los_loop.sampled_loop import SampledLoop, sampled_loop
from los_loop.sampled_loop_norms import weighted_gains
from los_loop.spec import (
    DISTURBANCE,
    LINE_OF_SIGHT,
    NO_DEVICES,
    OUTPUTS,
    Placed,
    held_response,
    laws,
)
from titop_plant.interface import (
    COLUMNS,
    DT,
    FRAME_TICKS,
    TRUTH,
    sample_ticks,
)
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight

LOWEST, HIGHEST = 1e-2, 3000.0
"""Frequencies of a search [rad/s]; the highest is just below half of the sampling rate."""
STEP = 1e-6
"""Of log frequency, to both sides, for the slope of a gain."""


@dataclass(frozen=True)
class LoopMetric:
    """A figure of merit at the values of a telescope and in a stage (:mod:`los_loop.figures_of_merit`).

    Parameters
    ----------
    name : str
    rows, columns : slice
        Of the outputs and inputs of the loop's response (:mod:`los_loop.spec`).
    limit : float
        Gain that counts as 1.
    band : (float, float)
        Frequencies [rad/s] at which it counts.
    relative : bool
        Whether the weight of the relative error is applied.
    """

    name: str
    rows: slice
    columns: slice
    limit: float
    band: tuple[float, float]
    relative: bool = False

    @property
    def disturbed(self) -> bool:
        """Whether the inputs are normalised disturbances."""
        return bool(self.columns.start == 0)


def loop_metrics(
    telescope: Telescope,
    stage: str,
    within: tuple[float, float] = (LOWEST, HIGHEST),
    placed: Placed = NO_DEVICES,
    rows: Sequence[FigureOfMerit] | None = None,
) -> dict[str, LoopMetric]:
    """Gains that a stage must keep (or the gains `rows`), by name, in their bands within some frequencies [rad/s]."""
    return {
        row.name: LoopMetric(
            row.name,
            placed.rows(row.output),
            placed.columns_of(row.inputs[0]),
            float(row.limit(telescope, stage)),
            row.within(*within),
            row.relative,
        )
        for row in (gain_figures(stage) if rows is None else rows)
    }


@dataclass(frozen=True)
class ClosedAt:
    """The loop at one frequency as an LFT in Delta: matrix from (Delta, disturbances, commands added) to outputs.

    `open` and `control` are what was closed: the LFT of the telescope, and commands by measurements.
    """

    omega: float
    M: ComplexArray
    T12: ComplexArray
    T21: ComplexArray
    T11: ComplexArray
    open: ComplexArray
    control: ComplexArray


class ImplementedLoop:
    """The loop of one stage around the uncertain telescope.

    Parameters
    ----------
    open_loop : OpenLoop
    k_fsm, k_pma : SampledSystem
    stage : {"none", "isolator", "fsm", "fsm+pma"}
        The loops that are closed; for ``none`` the system is that of the hard-mounted payload.
    """

    def __init__(self, open_loop: OpenLoop, k_fsm: SampledSystem, k_pma: SampledSystem, stage: str) -> None:
        self.open = open_loop
        self.system, self.telescope, self.stage = open_loop.system, open_loop.telescope, stage
        self.names = open_loop.names
        self.pair = (k_fsm, k_pma)
        self.placed = open_loop.placed
        sensitivity = self.telescope.fsm.los_sensitivity
        self.laws = laws(k_fsm, k_pma, stage, sensitivity, self.placed)

    def point(self, values: dict[str, float]) -> FloatArray:
        """Parameter values (nominal where none is given) as a point of the unit cube."""
        return self.open.point(values)

    def values(self, point: FloatArray) -> dict[str, float]:
        """Parameter values of a point of the unit cube."""
        return self.open.values(point)

    def delta(self, point: FloatArray) -> ComplexArray:
        """Entries of Delta, shape (..., 32), from points of the unit cube, shape (..., 7)."""
        return self.open.delta(point)

    def control(self, omega: float) -> ComplexArray:
        """Commands by measurements, shape (8, 22), one tick of delay and the hold of slower sensors in it."""
        return np.asarray(self.controls(np.array([omega]))[0])

    def controls(self, omega: FloatArray) -> ComplexArray:
        """What :meth:`control` gives at N frequencies [rad/s], shape (N, 8, 22)."""
        z = np.exp(1j * omega * DT)
        out = np.zeros((len(omega), self.placed.commands, self.placed.measurements), complex)
        rows, seen = np.arange(self.placed.commands), np.arange(self.placed.measurements)
        for law in self.laws:
            if law.gain:
                part = np.ix_(np.arange(len(omega)), rows[law.command], seen[law.measured])
                out[part] = law.gain * _sampled_responses(law.system, z)
        for name, ticks in sample_ticks(FRAME_TICKS).items():
            out[:, :, COLUMNS[name]] *= held_response(z, ticks)[:, None, None]
        return np.asarray(out / z[:, None, None])

    def at(self, omega: float) -> ClosedAt:
        """Close the loop at a frequency [rad/s]."""
        return self.at_each(np.array([omega]))[0]

    def at_each(self, omega: FloatArray) -> list[ClosedAt]:
        """Close the loop at each of some frequencies (N,) [rad/s]."""
        return self.around(self.open.at(omega), omega)

    def around(self, lft: ComplexArray, omega: FloatArray) -> list[ClosedAt]:
        """Close the loop around the telescope's LFT at N frequencies (:meth:`los_loop.open_loop.OpenLoop.at`)."""
        q, commands, measured = self.open.channels, self.placed.commands, self.placed.measurements
        y, u = q + measured, lft.shape[2] - commands
        K, held, into = self.controls(omega), lft[:, :, u:], lft[:, :, :u]
        unit = np.broadcast_to(np.eye(commands, dtype=complex), (len(omega), commands, commands))
        command = solve(np.asarray(unit - K @ held[:, q:y]), np.concatenate([K, unit], axis=2))
        applied = np.concatenate([command[:, :, :measured] @ into[:, q:y], command[:, :, measured:]], axis=2)
        whole = np.concatenate([held @ applied, applied], axis=1)
        whole[:, : lft.shape[1], :u] += into
        rows = np.r_[y : y + TRUTH, lft.shape[1] : whole.shape[1]]
        return [
            ClosedAt(float(w), T[:q, :q], T[rows, :q], T[:q, q:], T[rows, q:], own, law)
            for w, T, own, law in zip(omega, whole, lft, K)
        ]

    def metrics(self) -> dict[str, LoopMetric]:
        """Gains that the loop must keep, by name."""
        return loop_metrics(self.telescope, self.stage, placed=self.placed)

    def exact_gain(self, metric: LoopMetric, omega: float, values: Mapping[str, float]) -> float | None:
        """Normalised gain of a disturbance by the periodic solution, with the sidebands; None for other inputs."""
        if not metric.disturbed:
            return None
        plant, closed = self.sampled_at(values)
        response, relative = weighted_gains(closed, plant, self.telescope, np.array([omega]))
        gain = float(relative[0]) if metric.relative else float(largest_gains(response[:, metric.rows])[0])
        return gain / metric.limit

    def gain(self, closed: ClosedAt, metric: LoopMetric, point: FloatArray) -> tuple[float, FloatArray, float]:
        """Normalised gain, its gradient over the unit cube, shape (7,), and its slope over log frequency."""
        values, gradient, slope = self.gains_with_slopes([closed], metric, point[None])
        return float(values[0, 0]), np.asarray(gradient[0]), float(slope[0])

    def gains_with_slopes(
        self, closed: Sequence[ClosedAt], metric: LoopMetric, points: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of K closed loops, each at a point of the unit cube (K, 7) of its own.

        Returns
        -------
        values : ndarray, shape (K, r)
            Normalised singular values, largest first.
        gradients : ndarray, shape (K, 7)
            Of the largest one over the unit cube.
        slopes : ndarray, shape (K,)
            Of the largest one over log frequency: ``Re(l dP r)`` for the open loop P with its controllers; the signals
            r that the right singular vector causes in the closed loop, and what reaches the left one from signals l
            added there. Only the numbers ``l P r`` are computed at the two frequencies beside.
        """
        omega = np.array([own.omega for own in closed])
        delta, scale = self.delta(points), self.scales(metric, omega)
        M, T12, T21, T11 = (np.array([getattr(own, name) for own in closed]) for name in ("M", "T12", "T21", "T11"))
        out, into = T12[:, metric.rows], T21[:, :, metric.columns]
        loop, each = M * -delta[:, None, :], np.arange(delta.shape[1])
        loop[:, each, each] += 1.0
        # T12 Delta (I - M Delta)^-1, and T12 (I - Delta M)^-1 = T12 + T12 Delta (I - M Delta)^-1 M
        inner = solve(loop.swapaxes(1, 2), (out * delta[:, None, :]).swapaxes(1, 2)).swapaxes(1, 2)
        U, s, Vh = singular_triples(T11[:, metric.rows, metric.columns] + inner @ into)
        left, right = U[:, :, 0].conj(), Vh[:, 0].conj()
        z = solve(loop, into @ right[:, :, None])[:, :, 0]
        outer = _through(left, inner)
        row = _through(left, out) + _through(outer, M)
        slope = scale[:, None] * np.real(row * z * self.open.delta_slope(points))
        gradients = slope @ (self.open.channel[:, None] == np.arange(len(self.names)))
        signals = _Signals(left, outer, right, z * delta)
        change = scale * self._change(closed, metric, (T12, T21, T11), signals)
        weights = [self.scales(metric, omega * np.exp(step)) for step in (STEP, -STEP)]
        values = s * scale[:, None]
        return values, gradients, (change + values[:, 0] * (weights[0] - weights[1]) / scale) / (2.0 * STEP)

    def _change(
        self,
        closed: Sequence[ClosedAt],
        metric: LoopMetric,
        parts: tuple[ComplexArray, ComplexArray, ComplexArray],
        signals: _Signals,
    ) -> FloatArray:
        """First-order changes (K,) of gains, not normalised, between the frequencies STEP below and above."""
        T12, T21, T11 = parts
        q, count, placed = self.open.channels, len(closed), self.placed
        added, applied = placed.added, placed.applied
        inputs: ComplexArray = np.zeros((count, T11.shape[2]), complex)
        outputs: ComplexArray = np.zeros((count, applied.stop), complex)
        inputs[:, metric.columns], outputs[:, metric.rows] = signals.right, signals.left
        both = np.concatenate([T12[:, applied], T11[:, applied]], axis=2)
        commands = (both @ np.concatenate([signals.driven, inputs], axis=1)[:, :, None])[:, :, 0]
        by_commands = _through(outputs, T11[:, :, added]) + _through(signals.outer, T21[:, :, added])
        measured = _through(by_commands, np.array([own.control for own in closed]))
        row = np.concatenate([signals.outer, measured, outputs[:, OUTPUTS[LINE_OF_SIGHT]]], axis=1)
        column = np.concatenate([signals.driven, inputs[:, placed.columns_of(DISTURBANCE)], commands], axis=1)
        seen = np.array([own.open[q : q + placed.measurements] for own in closed]) @ column[:, :, None]
        beside = np.outer([np.exp(STEP), np.exp(-STEP)], [own.omega for own in closed])
        plant = self.open.between(beside.ravel(), np.tile(row, (2, 1)), np.tile(column, (2, 1))).reshape(2, -1)
        controls = self.controls(beside.ravel()).reshape(2, count, placed.commands, placed.measurements)
        control = (by_commands[:, None, :] @ controls @ seen)[:, :, 0, 0]
        found = (plant + control).real
        return np.asarray(found[0] - found[1])

    def singular_vectors(
        self, closed: ClosedAt, metric: LoopMetric, point: FloatArray
    ) -> tuple[float, ComplexArray, ComplexArray]:
        """Normalised gain with its left and right singular vectors."""
        T = self.responses(closed, metric, self.delta(point)[None])[0]
        U, s, Vh = linalg.svd(T, full_matrices=False)
        return float(s[0]) * self.scale(metric, closed.omega), U[:, 0], Vh[0].conj()

    def responses(self, closed: ClosedAt, metric: LoopMetric, delta: ComplexArray) -> ComplexArray:
        """Responses of a metric for N values of Delta (N, 32): shape (N, rows, columns), not normalised."""
        return self.some_responses(closed, delta, metric.rows, metric.columns)

    def all_responses(
        self,
        closed: ClosedAt,
        points: FloatArray,
        rows: slice = slice(None),
        columns: slice = slice(None),
    ) -> ComplexArray:
        """Responses of all or some outputs to inputs at N points (N, 7) of the unit cube: shape (N, 10, 30)."""
        return self.some_responses(closed, self.delta(points), rows, columns)

    def some_responses(self, closed: ClosedAt, delta: ComplexArray, rows: slice, columns: slice) -> ComplexArray:
        """What :meth:`all_responses` gives, for N values of Delta (N, 32)."""
        T12, T21, T11 = closed.T12[rows], closed.T21[:, columns], closed.T11[rows][:, columns]
        return self.open.closed(closed.M, T12, T21, T11, delta)

    def responses_each(
        self, closed: Sequence[ClosedAt], delta: ComplexArray, rows: slice, columns: slice
    ) -> ComplexArray:
        """Responses of K closed loops, each for a diagonal of Delta (K, 32) of its own: shape (K, rows, columns)."""
        M, T12, T21, T11 = (np.array([getattr(own, name) for own in closed]) for name in ("M", "T12", "T21", "T11"))
        return closed_lft(M, T12[:, rows], T21[:, :, columns], T11[:, rows, columns], delta)

    def sensitivities(self, closed: ClosedAt, points: FloatArray) -> ComplexArray:
        """From signals added to the commands to the commands applied, at N points (N, 7): shape (N, 8, 8)."""
        return self.all_responses(closed, points, self.placed.applied, self.placed.added)

    def sampled_at(self, values: Mapping[str, float]) -> tuple[System, SampledLoop]:
        """The continuous plant at parameter values, and the exact periodic loop around it."""
        plant = self.system.at(values)
        return plant, self.sampled_around(plant)

    def sampled_around(self, plant: System, step: FloatArray | None = None) -> SampledLoop:
        """The exact periodic loop around a plant; `step` as for :func:`los_loop.sampled_loop.sampled_loop`."""
        sensitivity = self.telescope.fsm.los_sensitivity
        return sampled_loop(
            plant,
            *self.pair,
            loop=self.stage,
            frame_ticks=FRAME_TICKS,
            los_sensitivity=sensitivity,
            step=step,
            placed=self.placed,
        )

    def scale(self, metric: LoopMetric, omega: float) -> float:
        """Weight of the relative error, where it applies, over the limit."""
        return float(self.scales(metric, np.array([omega]))[0])

    def scales(self, metric: LoopMetric, omega: FloatArray) -> FloatArray:
        """What :meth:`scale` gives at N frequencies [rad/s], shape (N,)."""
        weight = rpe_weight(omega, self.telescope.weights.rpe_window) if metric.relative else np.ones(len(omega))
        return np.asarray(weight / metric.limit)

    def gains(self, closed: ClosedAt, metric: LoopMetric, points: FloatArray) -> FloatArray:
        """Normalised gains at N points of the unit cube (N, 7): shape (N,)."""
        T = self.responses(closed, metric, self.delta(points))
        return np.asarray(largest_gains(T) * self.scale(metric, closed.omega))

    def all_gains(self, closed: ClosedAt, metric: LoopMetric, point: FloatArray) -> FloatArray:
        """All normalised singular values at a point of the unit cube, largest first."""
        T = self.responses(closed, metric, self.delta(point)[None])
        return np.asarray(singular_values(T)[0] * self.scale(metric, closed.omega))


@dataclass(frozen=True)
class _Signals:
    """Of K closed loops: left singular vectors (conjugate) and right ones, and both at the channels of Delta.

    `outer` is what the left ones see of signals at the outputs of Delta, `driven` what the right ones cause there.
    """

    left: ComplexArray
    outer: ComplexArray
    right: ComplexArray
    driven: ComplexArray


def _through(rows: ComplexArray, matrices: ComplexArray) -> ComplexArray:
    """``row @ matrix`` of K rows (K, p) and matrices (K, p, m): shape (K, m)."""
    return np.asarray((rows[:, None, :] @ matrices)[:, 0])


def _sampled_responses(system: SampledSystem, z: ComplexArray) -> ComplexArray:
    if system.order == 0:
        return np.asarray(np.broadcast_to(system.D, (len(z), *system.D.shape)), dtype=complex)
    shifted = np.asarray(z[:, None, None] * np.eye(system.order) - system.A, dtype=complex)
    entered = np.broadcast_to(system.B.astype(complex), (len(z), *system.B.shape))
    return np.asarray(system.D + system.C @ solve(shifted, entered))
