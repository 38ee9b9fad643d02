"""A simple proof-mass law: sky-hook damping of the platform.

Above a corner the platform's acceleration is integrated to a velocity, and the six actuators together
oppose it with a wrench ``W = -G v``::

    v = s a / (s^2 + 1.4 corner s + corner^2),    u = Gamma^-1 W,    Gamma: wrench on the platform by forces u

Two states per axis. The integration begins above the corner only: below the actuators' own mode
(sqrt(70/2.5) = 5.3 rad/s) their force on the platform has the opposite sign, and a pure integrator would destabilise
the solar arrays, whose damping ratio is 0.001. Source: Preumont, Vibration Control of Active Structures, ch. 7
(sky-hook damper).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit import SampledSystem, UncertainSystem, state_space
from lftkit.arrays import FloatArray
from lftkit.systems.filters import high_pass, with_input_filter
from lftkit.systems.sampling import sampled
from titop_plant.interface import DT, K_PMA_INPUTS, K_PMA_OUTPUTS, DesignBasis
from titop_plant.structures.kinematics import tau
from titop_plant.telescope.components import actuator_components
from titop_plant.telescope.parameters import Parameters


def actuator_wrenches(parameters: Parameters) -> FloatArray:
    """Gamma: wrench on the platform at I_p by unit motor forces, shape (6, 6).

    **A positive force pushes the mass along its axis and the platform against it.**

    Examples
    --------
    The six actuators together produce wrenches in all six directions:

    >>> from titop_plant.telescope.parameters import load_parameters
    >>> bool(linalg.svdvals(actuator_wrenches(load_parameters()))[-1] > 0.1)
    True
    """
    columns = []
    for one in actuator_components(parameters):
        axis = np.concatenate([one.dcm[2], np.zeros(3)])
        columns.append(-tau(one.position, (0.0, 0.0, 0.0)).T @ axis)
    return np.array(columns).T


def skyhook(parameters: Parameters, damping: ArrayLike, corner: float) -> UncertainSystem:
    """Continuous sky-hook law, order 12: platform acceleration to actuator forces.

    Parameters
    ----------
    parameters : mapping
        Of the telescope (table ``pma``).
    damping : array_like, shape (6,)
        Diagonal of G [N s/m], [Nm s/rad], not negative.
    corner : float
        rad/s, positive.
    """
    G = np.asarray(damping, dtype=float)
    if G.shape != (6,) or np.any(G < 0.0):
        raise ValueError(f"sky-hook damping must be six numbers that are not negative, got {G.tolist()}")
    if not corner > 0.0:
        raise ValueError(f"sky-hook corner must be positive, got {corner} rad/s")
    allocation = -linalg.solve(actuator_wrenches(parameters), np.diag(G))
    A = np.kron(np.eye(6), [[0.0, 1.0], [-(corner**2), -1.4 * corner]])
    B, C = np.kron(np.eye(6), [[0.0], [1.0]]), np.kron(allocation, [[0.0, 1.0]])
    return state_space(A, B, C, np.zeros((6, 6)), K_PMA_INPUTS, K_PMA_OUTPUTS)


def sampled_controller(
    controller: UncertainSystem,
    washout: float,
    *,
    name: str,
    basis: DesignBasis | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sampled proof-mass law with the washout F_w on the accelerometer channels (6 more states)."""
    (port,) = K_PMA_INPUTS
    filtered = with_input_filter(controller, {port.name: high_pass(port, washout)})
    found = sampled(filtered, DT, name=name, provenance=provenance)
    return replace(found, design_basis=(basis or DesignBasis()).to_mapping())
