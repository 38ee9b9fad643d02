"""Attitude of the spacecraft and its control law.

``attitude`` integrates the angular acceleration of the root point G to the rate and the rate to the
angle. These are the only absolute integrators of a spacecraft model. Translation is not integrated:
no measured or controlled variable depends on it.

``attitude_control`` is the paper's proportional-derivative law with the stable sign::

    u = -Gamma^+ (K_d rate + K_p angle),   K_p = omega^2 J,   K_d = 2 zeta omega J

**u > 0 is a torque on the structure along the spin axis.** (The paper prints the angle term with the
opposite sign, which is unstable for a positive angle.) J is the diagonal of the total inertia, the
inverse of the low-frequency gain from external torque to angular acceleration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit import Port, System, state_space, static_gain
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant import ports


def attitude(point: str = "G") -> System:
    """Integrate ``accel_<point>`` to ``rate_<point>`` [rad/s] and ``angle_<point>`` [rad]; 6 states."""
    Z, I3 = np.zeros((3, 3)), np.eye(3)
    A = np.block([[Z, I3], [Z, Z]])
    B = np.zeros((6, 6))
    B[3:, 3:] = I3
    return state_space(A, B, np.eye(6), np.zeros((6, 6)), [ports.accel(point)], [ports.angle(point), ports.rate(point)])


def attitude_control(
    inertia: ArrayLike, spin_axes: ArrayLike, *, bandwidth: float, damping: float, point: str = "G"
) -> System:
    """Proportional-derivative attitude law (equation and signs: see the module).

    Parameters
    ----------
    inertia : array_like, shape (3,)
        Total inertia about x, y, z [kg m2].
    spin_axes : array_like, shape (3, n)
        Gamma: one column per wheel.
    bandwidth : float
        omega [rad/s].
    damping : float
        zeta.

    Returns
    -------
    System
        ``angle_<point>``, ``rate_<point>`` -> ``wheel_torque`` (n).

    Examples
    --------
    A positive angle gives a restoring (negative) torque:

    >>> law = attitude_control([10.0, 10.0, 10.0], np.eye(3), bandwidth=0.1, damping=0.7)
    >>> round(float(law["wheel_torque", "angle_G"].nominal().D[0, 0]), 12)
    -0.1
    """
    J, Gamma = np.asarray(inertia, dtype=float), np.asarray(spin_axes, dtype=float)
    if J.shape != (3,) or not np.all(J > 0.0):
        raise InputError(f"attitude control: inertia must be three positive moments, got {J.tolist()}")
    rank = 3 - linalg.null_space(Gamma.T).shape[1] if Gamma.ndim == 2 and Gamma.shape[0] == 3 else 0
    if rank < 3:
        raise InputError(
            f"attitude control: spin_axes must be a 3 x n matrix of rank 3, got shape {Gamma.shape} of rank {rank}"
        )
    allocation = linalg.pinv(Gamma)
    gain = -allocation @ np.hstack([np.diag(bandwidth**2 * J), np.diag(2.0 * damping * bandwidth * J)])
    wheels = Port("wheel_torque", Gamma.shape[1], "Nm")
    return static_gain(gain, [ports.angle(point), ports.rate(point)], [wheels])


def total_inertia(torque_to_acceleration: System) -> FloatArray:
    """Total inertia matrix (3, 3) from the low-frequency gain external torque -> angular acceleration.

    Parameters
    ----------
    torque_to_acceleration : System
        Three inputs [Nm], three outputs [rad/s2]; all states stable, attitude not integrated.
    """
    s = torque_to_acceleration.at({})
    gain = s.D - s.C @ linalg.solve(s.A, s.B) if s.A.size else s.D
    inertia = linalg.inv(gain)
    return np.asarray(0.5 * (inertia + inertia.T))
