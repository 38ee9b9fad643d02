"""The line-of-sight observer at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.sampled_system import SampledSystem
from titop_plant.interface import CAMERA, DT, K_FSM_INPUTS, K_FSM_OUTPUTS, MEASUREMENTS


def hold_camera(measurement: FloatArray, held: FloatArray) -> None:
    """Replace the camera value `held` (2,) [rad] by that of a measurement (22,) where both of its axes are finite."""
    x, y = measurement[CAMERA.start], measurement[CAMERA.start + 1]
    # x - x is 0 for a finite number only: cheaper than np.isfinite on two elements
    if x - x == 0.0 and y - y == 0.0:
        held[0] = x
        held[1] = y


class LosEstimator:
    """Observer K_FSM: 22 measurements to the estimated line of sight.

    ======== ============ ==== =========================================
    port     name         size content
    ======== ============ ==== =========================================
    input    accel_Ip     6    twist derivative of the payload base
    input    accel_M1     6    twist derivative of the primary mirror
    input    accel_M2     6    twist derivative of the secondary mirror
    input    camera_los   2    controlled LOS, measured [rad]
    input    fsm_angle    2    FSM angles, measured [rad]
    output   los_estimate 2    LOS without the mirror's share [rad]
    ======== ============ ==== =========================================

    **The estimate has the sign of the true line of sight; the mirror is driven to its negative.**
    The camera is slower than the loop: between frames, and when a frame was dropped, the measurement
    holds NaN and the last finite value is used (zero before the first frame).

    Parameters
    ----------
    k_fsm : SampledSystem
        Ports as in the table, period 1 ms.

    Raises
    ------
    ValueError
        Other ports or another period.

    Examples
    --------
    An observer that hands on the camera value holds it between two frames:

    >>> D = np.zeros((2, MEASUREMENTS)); D[:, CAMERA] = np.eye(2)
    >>> k = SampledSystem([], [], [], D, K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
    >>> estimator, y, los = LosEstimator(k), np.zeros(MEASUREMENTS), np.zeros(2)
    >>> y[CAMERA] = 1e-6, -2e-6
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    >>> y[CAMERA] = np.nan
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    """

    def __init__(self, k_fsm: SampledSystem) -> None:
        k_fsm.require(K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
        self.k_fsm = k_fsm
        self._u = np.zeros(MEASUREMENTS)
        self._camera = np.zeros(CAMERA.stop - CAMERA.start)
        self._start: tuple[FloatArray, FloatArray] = (np.zeros(k_fsm.order), np.zeros(CAMERA.stop - CAMERA.start))

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Say where the next reset leads to, for a run that starts in its steady state.

        Parameters
        ----------
        state : ndarray, shape (order of K_FSM,)
        camera : ndarray, shape (2,)
            Camera value that is held [rad].

        Raises
        ------
        ValueError
            Another shape.
        """
        for name, given, kept in zip(("state", "camera"), (state, camera), self._start):
            if np.shape(given) != kept.shape:
                raise ValueError(f"{name} must have shape {kept.shape}, got {np.shape(given)}")
        self._start = np.array(state, dtype=float), np.array(camera, dtype=float)

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """Write the estimate of this tick into `out` (2,) [rad]; `measurement` (22,) is left alone."""
        u = self._u
        u[:] = measurement
        hold_camera(measurement, self._camera)
        u[CAMERA] = self._camera
        self.k_fsm.step(u, out)

    def reset(self) -> None:
        """Back to the start: the zero state and a held camera value of zero, or those of :meth:`start_at`."""
        self.k_fsm.reset(self._start[0])
        self._camera[:] = self._start[1]
