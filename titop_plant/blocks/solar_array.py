"""Solar array on its drive mechanism (SADM), rotated by theta.

From the spacecraft outwards: rotation by theta about the drive axis (tau = tan(theta/4), 16
occurrences), the gearbox as a revolute joint of stiffness k and damping d with the micro-stepping
torque as disturbance, and the flexible array with uncertain frequencies (2 occurrences each).

======================  ====  ==========================================================
port                    size  meaning
======================  ====  ==========================================================
in ``accel_<A>``        6     acceleration twist of the drive's interface
in ``sadm_torque``      1     disturbance torque **on the array** about the axis [Nm]
in ``motor_torque``     1     torque of the motor on its rotor, with a `DriveRotor` only [Nm]
out ``wrench_<A>``      6     by the array on the spacecraft
out ``sadm_angle``      1     elastic angle of the gearbox [rad]
======================  ====  ==========================================================

Slow disturbance torques twist the gearbox and are not transmitted to the spacecraft: the path is high-pass
with corner frequency sqrt(k / J). Source: the paper, "Full spacecraft assembly"; Sanfedino et al. (2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit import RealParameter, System
from lftkit.arrays import FloatArray
from titop_plant.blocks.flexible_body import flexible_body
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.revolute_joint import DriveRotor, on_revolute_joint
from titop_plant.blocks.rotation import turned
from titop_plant.structures.modal_data import ModalData


@dataclass(frozen=True)
class SolarArray:
    """Data of a solar array with its drive.

    Parameters
    ----------
    modes : ModalData
        Array in its own frame, clamped at its root; no child points.
    axis : ndarray, shape (3,)
        Drive axis in the spacecraft's frame; **positive theta rotates the array about +axis**.
    dcm : ndarray, shape (3, 3)
        From the spacecraft's frame to the array's at theta = 0.
    gearbox_stiffness, gearbox_damping : float
        k [Nm/rad], d [Nm s/rad].
    rotor : DriveRotor, optional
        Of the motor, on which the gearbox ends; None: at the spacecraft.
    """

    modes: ModalData
    axis: FloatArray
    dcm: FloatArray
    gearbox_stiffness: float
    gearbox_damping: float
    rotor: DriveRotor | None = None


def solar_array(
    data: SolarArray,
    point: str,
    tau: RealParameter | None,
    **uncertain: Any,
) -> System:
    """TITOP block of a solar array on its drive (ports: see the module).

    Parameters
    ----------
    data : SolarArray
    point : str
        Name of the interface on the spacecraft.
    tau : RealParameter or None
        tan(theta / 4); None for a drive that is held at the angle of `data`.
    **uncertain
        Uncertain frequencies and damping ratios, as :func:`titop_plant.blocks.flexible_body.flexible_body` takes them.
    """
    array = flexible_body(data.modes, **uncertain)
    attached = mounted(array, data.modes.parent, point, dcm=data.dcm)
    driven = on_revolute_joint(
        attached,
        point,
        data.axis,
        stiffness=data.gearbox_stiffness,
        damping=data.gearbox_damping,
        angle="sadm_angle",
        torque="sadm_torque",
        rotor=data.rotor,
    )
    return driven if tau is None else turned(driven, point, np.asarray(data.axis), tau)
