"""The steering-mirror and proof-mass laws as they fly: one `step` per millisecond (numpy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lti.ports import Port
from lti.sampled_system import SampledSystem

FloatArray = NDArray[np.float64]

DT = 1e-3
"""Sampling period of the loop [s]."""

MIRROR_GAIN = 0.1
"""LOS rotation per rotation of the fast steering mirror (paper, section on optics)."""

FSM_AUTHORITY = 5.3e-3
"""Largest FSM angle per axis [rad] (paper, table of actuators)."""

PMA_AUTHORITY = 31.6
"""Largest force of one proof-mass actuator [N] (paper, table of actuators)."""

LOOPS = ("none", "isolator", "fsm", "fsm+pma")
"""Stages of the paper: hard-mounted payload, isolator, and the two actuator loops on top."""

INPUTS = (Port("accel_Ip", 6, "m/s2,m/s2,m/s2,rad/s2,rad/s2,rad/s2"),)
OUTPUTS = (Port("pma_force", 6, "N"),)


class FsmPmaController:
    """Mirror law ``u_fsm = -LOS_hat / 0.1`` and proof-mass law ``u_pma = K_PMA accel_Ip``.

    ======== ============ ==== =========================================
    port     name         size content
    ======== ============ ==== =========================================
    input    los_estimate 2    output of the observer [rad]
    input    accel_Ip     6    twist derivative of the payload base
    output   fsm_command  2    mirror angles [rad]
    output   pma_force    6    forces of the proof-mass actuators [N]
    ======== ============ ==== =========================================

    **A positive LOS estimate drives the mirror to a negative angle.** Both outputs are saturated at
    the authority of their actuators. Stages without a loop give zeros on it.

    Parameters
    ----------
    k_pma : SampledSystem
        Input ``accel_Ip`` (6), output ``pma_force`` (6), period 1 ms.
    loop : {"none", "isolator", "fsm", "fsm+pma"}
        Stage: which of the loops are closed.
    fsm_authority, pma_authority : float
        Limits per channel [rad], [N].

    Raises
    ------
    ValueError
        Other ports, another period, unknown stage, limits that are not positive.

    Examples
    --------
    The mirror needs ten times the angle by which the line of sight is off, and stops at 5.3 mrad:

    >>> k = SampledSystem([], [], [], np.zeros((6, 6)), INPUTS, OUTPUTS, DT)
    >>> controller, u = FsmPmaController(k, "fsm"), np.zeros(8)
    >>> controller.step(np.array([1e-6, -1e-3]), np.zeros(6), u)
    >>> [round(float(x), 9) for x in u[:2]]
    [-1e-05, 0.0053]
    """

    def __init__(
        self,
        k_pma: SampledSystem,
        loop: str = "fsm+pma",
        fsm_authority: float = FSM_AUTHORITY,
        pma_authority: float = PMA_AUTHORITY,
    ) -> None:
        if loop not in LOOPS:
            raise ValueError(f"loop must be one of {', '.join(LOOPS)}, got {loop!r}")
        for name, limit in (("fsm_authority", fsm_authority), ("pma_authority", pma_authority)):
            if not (np.isfinite(limit) and limit > 0):
                raise ValueError(f"{name} must be positive and finite, got {limit}")
        k_pma.require(INPUTS, OUTPUTS, DT)
        self.k_pma = k_pma
        self.loop = loop
        self._fsm_closed = loop in ("fsm", "fsm+pma")
        self._pma_closed = loop == "fsm+pma"
        self._limit = np.array([fsm_authority] * 2 + [pma_authority] * 6)
        self._negative_limit = -self._limit
        self._force = np.zeros(6)

    def step(self, los_estimate: FloatArray, accel_Ip: FloatArray, out: FloatArray) -> None:
        """Write the command of this tick into `out` (8,): mirror angles [rad], forces [N]."""
        if self._fsm_closed:
            np.multiply(los_estimate, -1.0 / MIRROR_GAIN, out=out[:2])
        else:
            out[:2] = 0.0
        if self._pma_closed:
            self.k_pma.step(accel_Ip, self._force)
            out[2:] = self._force
        else:
            out[2:] = 0.0
        np.minimum(out, self._limit, out=out)
        np.maximum(out, self._negative_limit, out=out)

    def reset(self) -> None:
        """Back to the zero state."""
        self.k_pma.reset()
