"""The line-of-sight observer as it flies: one `step` per millisecond (numpy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lti.ports import Port
from lti.sampled_system import SampledSystem

FloatArray = NDArray[np.float64]

DT = 1e-3
"""Sampling period of the loop [s]."""

INPUTS = (
    Port("accel_Ip", 6, "m/s2,m/s2,m/s2,rad/s2,rad/s2,rad/s2"),
    Port("accel_M1", 6, "m/s2,m/s2,m/s2,rad/s2,rad/s2,rad/s2"),
    Port("accel_M2", 6, "m/s2,m/s2,m/s2,rad/s2,rad/s2,rad/s2"),
    Port("camera_los", 2, "rad"),
    Port("fsm_angle", 2, "rad"),
)
"""Ports of K_FSM in the order of the measurement vector (22 signals)."""

OUTPUTS = (Port("los_estimate", 2, "rad"),)

CAMERA = slice(18, 20)
"""Place of the camera in the measurement vector."""


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
    An observer that believes the camera keeps its value between two frames:

    >>> D = np.zeros((2, 22)); D[:, CAMERA] = np.eye(2)
    >>> k = SampledSystem([], [], [], D, INPUTS, OUTPUTS, DT)
    >>> estimator, y, los = LosEstimator(k), np.zeros(22), np.zeros(2)
    >>> y[CAMERA] = 1e-6, -2e-6
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    >>> y[CAMERA] = np.nan
    >>> estimator.step(y, los); los.tolist()
    [1e-06, -2e-06]
    """

    def __init__(self, k_fsm: SampledSystem) -> None:
        k_fsm.require(INPUTS, OUTPUTS, DT)
        self.k_fsm = k_fsm
        self._u = np.zeros(22)
        self._camera = np.zeros(2)

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """Write the estimate of this tick into `out` (2,) [rad]; `measurement` (22,) is left alone."""
        u = self._u
        u[:] = measurement
        x, y = measurement[18], measurement[19]
        # x - x is 0 for a finite number only: cheaper than np.isfinite on two elements
        if x - x == 0.0 and y - y == 0.0:
            self._camera[0] = x
            self._camera[1] = y
        u[CAMERA] = self._camera
        self.k_fsm.step(u, out)

    def reset(self) -> None:
        """Back to the zero state; the held camera value is forgotten."""
        self.k_fsm.reset()
        self._camera[:] = 0.0
