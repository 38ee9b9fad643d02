"""The Kalman observer of the line of sight: start of the tuner for K_FSM.

Model per axis, with ``c = C_a a`` the acceleration of the line of sight as the three accelerometer triads see
it and the camera (less the mirror's share) as the measurement::

    [LOS]'      [0 1] [LOS]      [0]
    [rate]  =   [0 0] [rate]  +  [1] (C_a a + w),     y = camera - S_FSM theta = LOS + v

    C_a = rotation of I_p + S_M1 (a_M1 - tau a_Ip) + S_M2 (a_M2 - tau a_Ip)

w is the accelerometers' noise through C_a, v the camera's noise times ``K_LOS`` = 1e5: the camera's low-pass is not in
the model, and the larger noise keeps the observer from following it. The flexible detector and mirror mount are not
measured. Source: the paper, "Hybrid control of LOS with FSM" (Kalman model).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System, state_space
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.systems.connection.filters import high_pass, with_input_filter
from lftkit.systems.sampling import sampled
from titop_plant.interface import (
    ACCELEROMETERS,
    CAMERA,
    COLUMNS,
    DT,
    FSM_ANGLE,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    DesignBasis,
)
from titop_plant.ports import accel
from titop_plant.structures.kinematics import tau
from titop_plant.structures.modal_data import ModalData
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.telescope import Telescope

CAMERA_NOISE_FACTOR = 1e5
"""The paper's K_LOS: the camera's noise in the model over that of the sensor."""

SEEN = tuple(accel(point).name for point in ("Ip", "M1", "M2"))
"""Accelerometers in the model."""

FITTED, FIT_POINTS, FIT_RANK = (5.0, 500.0), 60, 1e-6
"""Frequencies [rad/s] of the fit of :func:`fitted_sensitivity`, and what counts as no direction of it."""

MODELLED = np.concatenate([np.r_[COLUMNS[name]] for name in SEEN])
"""Columns of the accelerometers in the model; it leaves sensors aside that the paper does not have."""


def acceleration_sensitivity(telescope: Telescope, payload: ModalData) -> FloatArray:
    """C_a: acceleration of the line of sight [rad/s2] by the 18 accelerometer signals, shape (2, 18).

    Parameters
    ----------
    telescope : Telescope
        Of the telescope (table ``optics``).
    payload : ModalData
        For the positions of M1 and M2.

    Examples
    --------
    A rigid rotation moves the line of sight with it:

    >>> from titop_plant.telescope.assembly import assembled_telescope
    >>> from titop_plant.telescope.load import load_telescope
    >>> payload = assembled_telescope().bodies[1]
    >>> C_a = acceleration_sensitivity(load_telescope(), payload)
    >>> spin = np.array([0, 0, 0, 1.0, 0, 0])
    >>> everywhere = np.concatenate([spin, payload.child_tau("M1") @ spin, payload.child_tau("M2") @ spin])
    >>> np.round(C_a @ everywhere, 12).tolist()
    [1.0, 0.0]
    """
    optics = telescope.optics
    rotation = np.hstack([np.zeros((2, 3)), np.eye(2), np.zeros((2, 1))])
    base, mirrors = rotation, []
    for name in ("M1", "M2"):
        S = optics.sensitivity(name)
        base = base - S @ tau(payload.child(name).position, payload.parent_position)
        mirrors.append(S)
    return np.hstack([base, *mirrors])


def fitted_sensitivity(plant: System) -> FloatArray:
    """C_a of a plant whose bodies are not known: the least-squares fit to its responses, shape (2, 18).

    The nominal accelerations of the line of sight, without the mirror's own part, by those at the accelerometers, due
    to wheels and drives, at frequencies above the attitude control and below the structure's fast modes.

    Parameters
    ----------
    plant : System
        With the ports of :mod:`titop_plant.telescope.assembly`.
    """
    omega = np.geomspace(*FITTED, FIT_POINTS)
    response = frequency_response(plant[("los_controlled", *SEEN), disturbances_of(plant)].nominal(), omega)
    los = -(omega**2)[:, None, None] * response[:, :2]
    seen = response[:, 2:]
    scale = 1.0 / np.abs(los).max(axis=(1, 2), keepdims=True)  # each frequency counts alike
    rows = [np.moveaxis(part * scale, 1, 2).reshape(-1, part.shape[1]) for part in (seen, los)]
    a, b = (np.vstack([part.real, part.imag]) for part in rows)
    return np.asarray(linalg.lstsq(a, b, cond=FIT_RANK)[0].T)


def kalman_observer(telescope: Telescope, *, lead: float = 0.0) -> System:
    """Continuous observer K_est of order 4: measurements to the line of sight.

    Parameters
    ----------
    telescope : Telescope
        Of the telescope (tables ``optics``, ``sensors``, ``fsm``).
    lead : float
        The output is the estimate this much ahead, ``LOS + lead * rate`` [s]: it compensates
        the delay of the loop and adds noise. 0: the paper's observer.

    Returns
    -------
    System
        Ports :data:`titop_plant.interface.K_FSM_INPUTS` and ``K_FSM_OUTPUTS``; no washout.
    """
    assembled = assembled_telescope(telescope)
    if assembled.bodies:
        C_a = acceleration_sensitivity(telescope, assembled.bodies[1])
    else:
        C_a = fitted_sensitivity(assembled.system)
    sigma = telescope.loop_ports.of_law("k_fsm").noise
    noise, camera = sigma[MODELLED], float(sigma[CAMERA.start])
    Q = np.zeros((4, 4))
    Q[2:, 2:] = (C_a * noise**2) @ C_a.T * DT
    R = (CAMERA_NOISE_FACTOR * camera) ** 2 * DT * np.eye(2)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 4))]])
    C = np.hstack([np.eye(2), np.zeros((2, 2))])
    P = linalg.solve_continuous_are(A.T, C.T, Q, R)
    L = P @ C.T @ linalg.inv(R)
    S_fsm = telescope.fsm.los_sensitivity
    B = np.zeros((4, sigma.size))
    B[2:, MODELLED], B[:, CAMERA], B[:, FSM_ANGLE] = C_a, L, -S_fsm * L
    out = np.hstack([np.eye(2), lead * np.eye(2)])
    return state_space(A - L @ C, B, out, np.zeros((2, sigma.size)), K_FSM_INPUTS, K_FSM_OUTPUTS)


def sampled_observer(
    observer: System,
    washout: float,
    *,
    name: str,
    basis: DesignBasis | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sampled observer with the washout F_w on each accelerometer channel (18 more states).

    Parameters
    ----------
    observer : System
        Continuous, ports of K_FSM; behind them those of accelerometers at places.
    washout : float
        Corner of F_w [rad/s].
    name : str
    basis : DesignBasis, optional
        What it was made for.
    provenance : mapping, optional
    """
    known = {port.name for port in K_FSM_INPUTS} - set(ACCELEROMETERS)
    filters = {port.name: high_pass(port, washout) for port in observer.inputs if port.name not in known}
    found = sampled(with_input_filter(observer, filters), DT, name=name, provenance=provenance)
    return replace(found, design_basis=(basis or DesignBasis()).to_mapping())
