"""The line-of-sight observer at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.held_samples import HeldSamples
from titop_plant.interface import DT, HELD, K_FSM_INPUTS, K_FSM_OUTPUTS
from titop_plant.sensors import MEASURED_SENSORS, Sensor, port_alone


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
    sensors : sequence of Sensor
        Further inputs, of sensors of a telescope's file: their values follow the measurements.

    Raises
    ------
    ValueError
        Other ports or another period.

    Examples
    --------
    An observer that hands on the camera value holds it between two frames:

    >>> from titop_plant.interface import COLUMNS, MEASUREMENTS
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

    def __init__(self, k_fsm: SampledSystem, sensors: Sequence[Sensor] = ()) -> None:
        inputs = (*K_FSM_INPUTS, *(sensor.port for sensor in sensors))
        k_fsm = k_fsm.with_inputs(inputs)
        k_fsm.require(inputs, K_FSM_OUTPUTS, DT)
        self.k_fsm = k_fsm
        self._u = np.zeros(total_size(inputs))
        self._held = HeldSamples((*map(port_alone, MEASURED_SENSORS), *sensors))
        self._start: tuple[FloatArray, FloatArray] = (np.zeros(k_fsm.order), np.zeros(HELD.size))

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Say where the next reset leads to, for a run that starts in its steady state.

        Parameters
        ----------
        state : ndarray, shape (order of K_FSM,)
        camera : ndarray, shape (h,)
            Values that are held, of the reference's sensors [rad], in the order of the measurement; others are zero, as
            every sensor has a sample at the first tick.

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
        return self._held.values

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """Write the estimate of this tick into `out` (2,) [rad]; `measurement` (22,) is left alone.

        Values of further sensors stand behind the 22.
        """
        u = self._u
        u[:] = measurement
        self._held.fill(u)
        self.k_fsm.step(u, out)

    def steps(self, measurements: FloatArray) -> FloatArray:
        """Estimates (k, 2) [rad] of the ticks with these measurements (k, 22): bit for bit those of :meth:`step`."""
        u = measurements.copy()
        self._held.fill_rows(u)
        return self.k_fsm.steps(u)

    def reset(self) -> None:
        """Back to the start: the zero state and a held values of zero, or those of :meth:`start_at`."""
        self.k_fsm.reset(self._start[0])
        self._held.values[:] = 0.0
        self._held.values[: HELD.size] = self._start[1]
