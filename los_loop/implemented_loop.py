"""Response of the implemented loop as a linear fractional function of the parameters, with gradients.

At one frequency the loop of the sampled controllers is closed around the telescope's LFT
(:func:`los_loop.closing.closed_loop`); what remains is a small LFT with the 32 channels of Delta. With the largest
singular value sigma of a closed response::

    d sigma / d Delta_c = Re( (sigma-left vector side)_c (right vector side)_c )

Inputs: Delta channels, normalised disturbances, signals added to the commands. Outputs: Delta channels, controlled
line of sight (2), the commands applied to the plant.

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
from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.lft_response import GainSlopes, rows_times
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.closing import ClosedAt, ClosedLoop, closed_loop, sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.figures_of_merit import FigureOfMerit, gain_figures
from los_loop.open_loop import OpenLoop
from los_loop.sampled_loop import SampledLoop
from los_loop.sampled_loop_norms import weighted_gains
from los_loop.spec import DISTURBANCE, LOS_ROWS
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.sections import LOOP_FREQUENCIES
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight

LOWEST, HIGHEST = LOOP_FREQUENCIES
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
    ports: LoopPorts,
    within: tuple[float, float] = (LOWEST, HIGHEST),
    rows: Sequence[FigureOfMerit] | None = None,
) -> dict[str, LoopMetric]:
    """Gains that a stage must keep (or the gains `rows`), by name, in their bands within some frequencies [rad/s].

    `ports` are those of the loop.
    """
    return {
        row.name: LoopMetric(
            row.name,
            ports.rows_of(row.output),
            ports.columns_of(row.inputs[0]),
            float(row.limit(telescope, stage)),
            row.within(telescope, *within),
            row.relative,
        )
        for row in (gain_figures(stage) if rows is None else rows)
    }


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
        self.ports = open_loop.ports
        sensitivity = self.telescope.fsm.los_sensitivity
        self.control_laws = ControlLaws(k_fsm, k_pma, stage, self.ports, sensitivity)

    def point(self, values: dict[str, float]) -> FloatArray:
        """Parameter values (nominal where none is given) as a point of the unit cube."""
        return self.open.point(values)

    def values(self, point: FloatArray) -> dict[str, float]:
        """Parameter values of a point of the unit cube."""
        return self.open.values(point)

    def delta(self, point: FloatArray) -> ComplexArray:
        """Entries of Delta, shape (..., 32), from points of the unit cube, shape (..., 7)."""
        return self.open.delta(point)

    def controls(self, omega: FloatArray) -> ComplexArray:
        """Commands by measurements at N frequencies [rad/s], shape (N, u, y): delay and hold are in it."""
        return self.control_laws.response(omega)

    def at(self, omega: float) -> ClosedAt:
        """Close the loop at a frequency [rad/s]."""
        return self.at_each(np.array([omega]))[0]

    def at_each(self, omega: FloatArray) -> ClosedLoop:
        """Close the loop at each of some frequencies (N,) [rad/s]."""
        return self.around(self.open.at(omega), omega)

    def around(self, lft: ComplexArray, omega: FloatArray) -> ClosedLoop:
        """Close the loop around the telescope's LFT at N frequencies (:meth:`los_loop.open_loop.OpenLoop.at`)."""
        return closed_loop(lft, self.controls(omega), omega)

    def metrics(self) -> dict[str, LoopMetric]:
        """Gains that the loop must keep, by name."""
        return loop_metrics(self.telescope, self.stage, self.ports)

    def exact_gain(self, metric: LoopMetric, omega: float, values: Mapping[str, float]) -> float | None:
        """Normalised gain of a disturbance by the periodic solution, with the sidebands; None for other inputs."""
        if not metric.disturbed:
            return None
        plant, closed = self.sampled_at(values)
        response, relative = weighted_gains(closed, plant, self.telescope, np.array([omega]))
        gain = float(relative[0]) if metric.relative else float(largest_gains(response[:, metric.rows])[0])
        return gain / metric.limit

    def gain(self, omega: float, metric: LoopMetric, point: FloatArray) -> tuple[float, FloatArray, float]:
        """Normalised gain at a frequency, its gradient over the unit cube (7,), its slope over log frequency."""
        values, gradient, slope = self.gains_with_slopes(self.at_each(np.array([omega])), metric, point[None])
        return float(values[0, 0]), np.asarray(gradient[0]), float(slope[0])

    def gains_with_slopes(
        self, closed: ClosedLoop, metric: LoopMetric, points: FloatArray
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
        omega = closed.omega
        scale = self.scales(metric, omega)
        found = closed.lft.part(metric.rows, metric.columns).gain_slopes(self.delta(points))
        slope = scale[:, None] * np.real(found.slopes * self.open.delta_slope(points))
        gradients = slope @ (self.open.channel[:, None] == np.arange(len(self.names)))
        change = scale * self._change(closed, metric, found)
        weights = [self.scales(metric, omega * np.exp(step)) for step in (STEP, -STEP)]
        values = found.values * scale[:, None]
        return values, gradients, (change + values[:, 0] * (weights[0] - weights[1]) / scale) / (2.0 * STEP)

    def _change(self, closed: ClosedLoop, metric: LoopMetric, found: GainSlopes) -> FloatArray:
        """First-order changes (K,) of gains, not normalised, between the frequencies STEP below and above."""
        lft, q, count, ports = closed.lft, self.open.channels, len(closed), self.ports
        added, applied = ports.added, ports.applied
        inputs: ComplexArray = np.zeros((count, lft.T11.shape[2]), complex)
        outputs: ComplexArray = np.zeros((count, applied.stop), complex)
        inputs[:, metric.columns], outputs[:, metric.rows] = found.right, found.left
        both = np.concatenate([lft.T12[:, applied], lft.T11[:, applied]], axis=2)
        commands = (both @ np.concatenate([found.driven, inputs], axis=1)[:, :, None])[:, :, 0]
        by_commands = rows_times(outputs, lft.T11[:, :, added]) + rows_times(found.outer, lft.T21[:, :, added])
        measured = rows_times(by_commands, closed.control)
        row = np.concatenate([found.outer, measured, outputs[:, LOS_ROWS]], axis=1)
        column = np.concatenate([found.driven, inputs[:, ports.columns_of(DISTURBANCE)], commands], axis=1)
        seen = closed.open[:, q : q + ports.measurements] @ column[:, :, None]
        beside = np.outer([np.exp(STEP), np.exp(-STEP)], closed.omega)
        plant = self.open.between(beside.ravel(), np.tile(row, (2, 1)), np.tile(column, (2, 1))).reshape(2, -1)
        controls = self.controls(beside.ravel()).reshape(2, count, ports.commands, ports.measurements)
        control = (by_commands[:, None, :] @ controls @ seen)[:, :, 0, 0]
        total = (plant + control).real
        return np.asarray(total[0] - total[1])

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
        """Responses of all or some outputs to inputs at N points (N, 7) of the unit cube: shape (N, 2 + u, m + u)."""
        return self.some_responses(closed, self.delta(points), rows, columns)

    def some_responses(
        self, closed: ClosedAt | ClosedLoop, delta: ComplexArray, rows: slice, columns: slice
    ) -> ComplexArray:
        """What :meth:`all_responses` gives, for N values of Delta (N, 32), or one for each of N closed loops."""
        return closed.lft.part(rows, columns).closed(delta, self.open.angle)

    def sensitivities(self, closed: ClosedAt, points: FloatArray) -> ComplexArray:
        """From signals added to the commands to the commands applied, at N points (N, 7): shape (N, u, u)."""
        return self.all_responses(closed, points, self.ports.applied, self.ports.added)

    def sampled_at(self, values: Mapping[str, float]) -> tuple[System, SampledLoop]:
        """The continuous plant at parameter values, and the exact periodic loop around it."""
        plant = self.system.at(values)
        return plant, self.sampled_around(plant)

    def sampled_around(self, plant: System, step: FloatArray | None = None) -> SampledLoop:
        """The exact periodic loop around a plant; `step` as for :func:`los_loop.closing.sampled_loop`."""
        return sampled_loop(plant, self.control_laws, step=step)

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
