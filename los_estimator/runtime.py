"""The line-of-sight observer at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.held_samples import HeldSamples
from titop_plant.interface import DT, K_FSM_OUTPUTS
from titop_plant.sensors import CAMERA_PORT

if TYPE_CHECKING:
    from titop_plant.telescope.loop_ports import LoopPorts


class LosEstimator:
    """Observer K_FSM: measurements to the estimated line of sight.

    ======== ============ ==== ========================================================================
    port     name         size content
    ======== ============ ==== ========================================================================
    input    of a sensor       one for each sensor of `ports`, in their order; a file may leave out some of
                               them, which then have no effect
    output   los_estimate 2    LOS without the mirror's share [rad]
    ======== ============ ==== ========================================================================

    **The estimate has the sign of the true line of sight; the mirror is driven to its negative.**
    A camera is slower than the loop: between its frames, and when a frame was dropped, the measurement
    holds NaN and the last finite value is used (zero before the first frame).

    Parameters
    ----------
    k_fsm : SampledSystem
        Ports as in the table, period 1 ms.
    ports : LoopPorts
        Rows of the telescope that it uses (:meth:`titop_plant.telescope.loop_ports.LoopPorts.of_system`).

    Raises
    ------
    ValueError
        Other ports or another period.

    Examples
    --------
    An observer that hands on the camera value holds it between two frames:

    >>> from titop_plant.telescope.load import load_telescope
    >>> rows = load_telescope().loop_ports.of_law("k_fsm")
    >>> D = np.zeros((2, rows.measurements)); D[:, rows.columns["camera_los"]] = np.eye(2)
    >>> k = SampledSystem([], [], [], D, rows.measured, K_FSM_OUTPUTS, DT)
    >>> estimator, y, los = LosEstimator(k, rows), np.zeros(rows.measurements), np.zeros(2)
    >>> y[rows.columns["camera_los"]] = 1e-6, -2e-6
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    >>> y[rows.columns["camera_los"]] = np.nan
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    """

    def __init__(self, k_fsm: SampledSystem, ports: LoopPorts) -> None:
        inputs = ports.measured
        k_fsm = k_fsm.with_inputs(inputs)
        k_fsm.require(inputs, K_FSM_OUTPUTS, DT)
        self.k_fsm, self.ports = k_fsm, ports
        self._u = np.zeros(total_size(inputs))
        self._held = HeldSamples(ports.sensors)
        self._camera = ports.held_parts.get(CAMERA_PORT, slice(0, 0))
        self._start: tuple[FloatArray, FloatArray] = (np.zeros(k_fsm.order), self._held.values[self._camera].copy())

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Say where the next reset leads to, for a run that starts in its steady state.

        Parameters
        ----------
        state : ndarray, shape (order of K_FSM,)
        camera : ndarray, shape (2,)
            Values of the camera that are held [rad]; those of other sensors are zero, as every one has a sample at the
            first tick.

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
    def held(self) -> HeldSamples:
        """The values that are held, for compiled loops, which write them."""
        return self._held

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """Write the estimate of this tick into `out` (2,) [rad]; `measurement`, the sensors' values, is left alone."""
        u = self._u
        u[:] = measurement
        self._held.fill(u)
        self.k_fsm.step(u, out)

    def steps(self, measurements: FloatArray) -> FloatArray:
        """Estimates (k, 2) [rad] of the ticks with these measurements (k, m): bit for bit those of :meth:`step`."""
        u = measurements.copy()
        self._held.fill_rows(u)
        return self.k_fsm.steps(u)

    def reset(self) -> None:
        """Back to the start: the zero state and a held values of zero, or those of :meth:`start_at`."""
        self.k_fsm.reset(self._start[0])
        self._held.values[:] = 0.0
        self._held.values[self._camera] = self._start[1]
