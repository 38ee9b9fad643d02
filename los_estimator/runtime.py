"""The line-of-sight observer at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import COLUMNS, DT, HELD, HELD_PARTS, K_FSM_INPUTS, K_FSM_OUTPUTS

_PARTS = tuple(
    tuple(zip(range(COLUMNS[name].start, COLUMNS[name].stop), range(part.start, part.stop)))
    for name, part in HELD_PARTS.items()
)
"""For each port that is held: columns of the measurement, and where their values are kept."""


def hold_values(measurement: FloatArray, held: FloatArray) -> None:
    """Replace the values `held` (h,) of each port that is held by those of a measurement (22,) if all are finite."""
    for part in _PARTS:
        for column, _ in part:
            x = measurement[column]
            if x - x != 0.0:  # 0 for a finite number only: cheaper than np.isfinite on two elements
                break
        else:
            for column, kept in part:
                held[kept] = measurement[column]


class LosEstimator:
    """Observer K_FSM: measurements to the estimated line of sight.

    ======== ============ ==== ========================================================================
    port     name         size content
    ======== ============ ==== ========================================================================
    input    of a sensor       one for each entry of :mod:`titop_plant.sensors`, in their order; a
                               file may leave out some of them, which then have no effect
    output   los_estimate 2    LOS without the mirror's share [rad]
    ======== ============ ==== ========================================================================

    **The estimate has the sign of the true line of sight; the mirror is driven to its negative.**
    A camera is slower than the loop: between its frames, and when a frame was dropped, the measurement
    holds NaN and the last finite value is used (zero before the first frame).

    Parameters
    ----------
    k_fsm : SampledSystem
        Ports as in the table, period 1 ms.
    sensors : sequence of Port
        Further inputs, of sensors of a telescope's file: their values follow the measurements.

    Raises
    ------
    ValueError
        Other ports or another period.

    Examples
    --------
    An observer that hands on the camera value holds it between two frames:

    >>> from titop_plant.interface import MEASUREMENTS
    >>> D = np.zeros((2, MEASUREMENTS)); D[:, COLUMNS["camera_los"]] = np.eye(2)
    >>> k = SampledSystem([], [], [], D, K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
    >>> estimator, y, los = LosEstimator(k), np.zeros(MEASUREMENTS), np.zeros(2)
    >>> y[COLUMNS["camera_los"]] = 1e-6, -2e-6
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    >>> y[COLUMNS["camera_los"]] = np.nan
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    """

    def __init__(self, k_fsm: SampledSystem, sensors: Sequence[Port] = ()) -> None:
        inputs = (*K_FSM_INPUTS, *sensors)
        k_fsm = k_fsm.with_inputs(inputs)
        k_fsm.require(inputs, K_FSM_OUTPUTS, DT)
        self.k_fsm = k_fsm
        self._u = np.zeros(total_size(inputs))
        self._held = np.zeros(HELD.size)
        self._start: tuple[FloatArray, FloatArray] = (np.zeros(k_fsm.order), np.zeros(HELD.size))

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Say where the next reset leads to, for a run that starts in its steady state.

        Parameters
        ----------
        state : ndarray, shape (order of K_FSM,)
        camera : ndarray, shape (h,)
            Values that are held, of a camera [rad], in the order of the measurement.

        Raises
        ------
        ValueError
            Another shape.
        """
        for name, given, kept in zip(("state", "camera"), (state, camera), self._start):
            if np.shape(given) != kept.shape:
                raise InputError(f"{name} must have shape {kept.shape}, got {np.shape(given)}")
        self._start = np.array(state, dtype=float), np.array(camera, dtype=float)

    @property
    def design_basis(self) -> Mapping[str, Any]:
        """What K_FSM was made for."""
        return self.k_fsm.design_basis

    @property
    def held(self) -> FloatArray:
        """The values that are held (h,), for compiled loops, which write them."""
        return self._held

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """Write the estimate of this tick into `out` (2,) [rad]; `measurement` (22,) is left alone.

        Values of further sensors stand behind the 22.
        """
        u = self._u
        u[:] = measurement
        hold_values(measurement, self._held)
        u[HELD] = self._held
        self.k_fsm.step(u, out)

    def steps(self, measurements: FloatArray) -> FloatArray:
        """Estimates (k, 2) [rad] of the ticks with these measurements (k, 22): bit for bit those of :meth:`step`."""
        u = measurements.copy()
        for name, kept in HELD_PARTS.items():
            seen = np.vstack([self._held[kept], measurements[:, COLUMNS[name]]])
            fresh = np.isfinite(seen).all(axis=1)
            newest = np.maximum.accumulate(np.where(fresh, np.arange(len(seen)), 0))
            u[:, COLUMNS[name]] = seen[newest[1:]]
            self._held[kept] = seen[newest[-1]]
        return self.k_fsm.steps(u)

    def reset(self) -> None:
        """Back to the start: the zero state and a held values of zero, or those of :meth:`start_at`."""
        self.k_fsm.reset(self._start[0])
        self._held[:] = self._start[1]
