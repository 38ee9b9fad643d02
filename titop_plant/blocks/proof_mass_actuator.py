"""Proof-mass actuator (PMA): a mass m that slides along v in a casing fixed to the structure.

The paper's equations, with ``a_G = tau_GP accel_P`` the twist of the centre of mass at rest::

    m (v' a_G + stroke'') = -k stroke - d stroke' + u
    wrench_P = -tau_GP' ( diag((m_c + m) I, J) a_G + m [v; 0] stroke'' )

**At low frequency the mount carries the mass m_c + m, at high frequency along v the casing mass m_c alone.
u > 0 is a force on the proof mass along +v and on the structure along -v.** (The paper writes M for the
total mass on the mount and lists 3.5 kg as "caging"; here ``casing_mass`` excludes the moving mass.)

=====================  ====  ============================================
port                   size  meaning
=====================  ====  ============================================
in ``accel_<P>``       6     acceleration twist of the mount
in ``pma_force``       1     force of the motor between casing and mass [N]
out ``wrench_<P>``     6     by the actuator on its mount
out ``pma_stroke``     1     displacement of the mass relative to the casing [m]
=====================  ====  ============================================

Source: the paper, "Proof-Mass Actuators", equations of the PMA. Neglected: end stops, friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit import Port, System, state_space
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant import ports
from titop_plant.structures.kinematics import tau


@dataclass(frozen=True)
class ProofMassActuator:
    """Data of a proof-mass actuator in its own frame, **v = +z**.

    Parameters
    ----------
    moving_mass, casing_mass : float
        m and m_c [kg].
    inertia : ndarray, shape (3, 3)
        Of the whole actuator at its centre of mass [kg m2].
    stiffness, damping : float
        k [N/m], d [N s/m].
    center_of_mass : tuple of float
        From the mount P [m].
    """

    moving_mass: float
    casing_mass: float
    inertia: FloatArray
    stiffness: float
    damping: float
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("moving_mass", "casing_mass", "stiffness"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"proof-mass actuator: {name} must be positive, got {getattr(self, name)}")
        if not self.damping >= 0.0:
            raise InputError(f"proof-mass actuator: damping must not be negative, got {self.damping}")


def proof_mass_actuator(data: ProofMassActuator, point: str = "P") -> System:
    """TITOP block of a proof-mass actuator (ports and equations: see the module).

    Examples
    --------
    A proof-mass actuator gives no steady force:

    >>> pma = proof_mass_actuator(ProofMassActuator(2.5, 3.5, 1e-3 * np.eye(3), 70.0, 10.0))
    >>> force = pma["wrench_P", "pma_force"].nominal()
    >>> abs(round(float(force(0)[2, 0].real), 12)), round(float(force(1e6j)[2, 0].real), 6)
    (0.0, -1.0)
    """
    m, v = data.moving_mass, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    T = tau(data.center_of_mass, (0.0, 0.0, 0.0))
    mass = np.zeros((6, 6))
    mass[:3, :3] = (data.casing_mass + m) * np.eye(3)
    mass[3:, 3:] = data.inertia
    along = v @ T  # acceleration of the mount along v
    A = np.array([[0.0, 1.0], [-data.stiffness / m, -data.damping / m]])
    B = np.vstack([np.zeros(7), np.concatenate([-along, [1.0 / m]])])
    slide = -m * (T.T @ v)[:, None]  # wrench per stroke''
    C = np.vstack([slide @ A[1:2], [[1.0, 0.0]]])
    D = np.vstack([slide @ B[1:2], np.zeros((1, 7))])
    D[:6, :6] -= T.T @ mass @ T
    return state_space(
        A,
        B,
        C,
        D,
        [ports.accel(point), Port("pma_force", 1, "N")],
        [ports.wrench(point), Port("pma_stroke", 1, "m")],
    )
