"""The Kalman observer of the line of sight: first guess of K_FSM.

Model per axis, with ``c = C_a a`` the acceleration of the line of sight as the three accelerometer triads see
it and the camera (less the mirror's share) as the measurement::

    [LOS]'      [0 1] [LOS]      [0]
    [rate]  =   [0 0] [rate]  +  [1] (C_a a + w),     y = camera - S_FSM theta = LOS + v

    C_a = rotation of I_p + S_M1 (a_M1 - tau a_Ip) + S_M2 (a_M2 - tau a_Ip)

w is the accelerometers' noise seen through C_a, v the camera's noise times ``K_LOS`` = 1e5, which tells the
observer not to trust a camera whose low-pass is not in the model. The flexible detector and mirror mount are not
sensed. Source: the paper, "Hybrid control of LOS with FSM" (Kalman model).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import linalg

from los_estimator.runtime import DT, INPUTS, OUTPUTS
from lti import SampledSystem, UncertainSystem, state_space
from lti.filters import high_pass, with_input_filter
from lti.sampling import sampled
from titop_plant.structures.kinematics import FloatArray, tau
from titop_plant.structures.modal_data import ModalData
from titop_plant.telescope.parameters import Parameters, optics_component

CAMERA_DISTRUST = 1e5
"""The paper's K_LOS."""

ACCELEROMETERS = ("accel_Ip", "accel_M1", "accel_M2")


def acceleration_sensitivity(parameters: Parameters, payload: ModalData) -> FloatArray:
    """C_a: acceleration of the line of sight [rad/s2] by the 18 accelerometer signals, shape (2, 18).

    Parameters
    ----------
    parameters : mapping
        Of the telescope (table ``optics``).
    payload : ModalData
        For the places of M1 and M2.

    Examples
    --------
    A rigid rotation moves the line of sight with it:

    >>> from titop_plant.simulation import telescope
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> payload = telescope().bodies[1]
    >>> C_a = acceleration_sensitivity(load_parameters(), payload)
    >>> spin = np.array([0, 0, 0, 1.0, 0, 0])
    >>> everywhere = np.concatenate([spin, payload.child_tau("M1") @ spin, payload.child_tau("M2") @ spin])
    >>> np.round(C_a @ everywhere, 12).tolist()
    [1.0, 0.0]
    """
    optics = optics_component(parameters)
    rotation = np.hstack([np.zeros((2, 3)), np.eye(2), np.zeros((2, 1))])
    base, mirrors = rotation, []
    for name in ("M1", "M2"):
        S = optics.sensitivity(name)
        base = base - S @ tau(payload.child(name).position, payload.parent_position)
        mirrors.append(S)
    return np.hstack([base, *mirrors])


def kalman_observer(parameters: Parameters, payload: ModalData, *, lead: float = 0.0) -> UncertainSystem:
    """Continuous observer K_est of order 4: 22 measurements to the line of sight.

    Parameters
    ----------
    parameters : mapping
        Of the telescope (tables ``optics``, ``sensors``, ``fsm``).
    payload : ModalData
    lead : float
        The output is the estimate this much ahead, ``LOS + lead * rate`` [s]: makes up for the delay of
        the loop at the price of more noise. 0: the paper's observer.

    Returns
    -------
    UncertainSystem
        Inputs as in :data:`los_estimator.runtime.INPUTS`, output ``los_estimate``; no washout.
    """
    C_a = acceleration_sensitivity(parameters, payload)
    sensors = parameters["sensors"]
    noise = np.tile(sensors["accelerometer_noise"], 3)
    Q = np.zeros((4, 4))
    Q[2:, 2:] = (C_a * noise**2) @ C_a.T * DT
    R = (CAMERA_DISTRUST * sensors["camera_noise"]) ** 2 * DT * np.eye(2)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 4))]])
    C = np.hstack([np.eye(2), np.zeros((2, 2))])
    P = linalg.solve_continuous_are(A.T, C.T, Q, R)
    L = P @ C.T @ linalg.inv(R)
    S_fsm = parameters["fsm"]["los_sensitivity"]
    B = np.hstack([np.vstack([np.zeros((2, 18)), C_a]), L, -S_fsm * L])
    out = np.hstack([np.eye(2), lead * np.eye(2)])
    return state_space(A - L @ C, B, out, np.zeros((2, 22)), INPUTS, OUTPUTS)


def sampled_observer(
    observer: UncertainSystem, washout: float, *, name: str, provenance: Mapping[str, Any] | None = None
) -> SampledSystem:
    """Sampled observer with the washout F_w on each accelerometer channel (18 more states).

    Parameters
    ----------
    observer : UncertainSystem
        Continuous, ports of K_FSM.
    washout : float
        Corner of F_w [rad/s].
    """
    filters = {port.name: high_pass(port, washout) for port in INPUTS if port.name in ACCELEROMETERS}
    return sampled(with_input_filter(observer, filters), DT, name=name, provenance=provenance)
