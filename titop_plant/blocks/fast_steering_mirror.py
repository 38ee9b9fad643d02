"""Piezo-electric fast steering mirror (FSM): a rigid mirror on two revolute joints, x then y.

A commanded angle acts through the joint's stiffness: the static gain from command to angle is 1, and the
bandwidth is the natural frequency sqrt(k/J) of the mirror on its joint. Four states.

=================  ====  ==================================================================
port               size  meaning
=================  ====  ==================================================================
in ``accel_<P>``   6     acceleration twist of the mount
in ``fsm_command`` 2     commanded angles about x, y [rad]
out ``wrench_<P>`` 6     by the mirror on its mount
out ``fsm_angle``  2     angles of the mirror relative to its mount, x, y [rad]
=================  ====  ==================================================================

Source: the paper, "Fast Steering Mirror". Neglected: actuator hysteresis and electronics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit import Port, RealParameter, System, connect, static_gain
from lftkit.arrays import FloatArray
from titop_plant import ports
from titop_plant.blocks.flexible_body import rigid_body
from titop_plant.blocks.revolute_joint import on_revolute_joint, position_commanded
from titop_plant.blocks.uncertain_gain import uncertain_gain
from titop_plant.structures.modal_data import from_inertia


@dataclass(frozen=True)
class FastSteeringMirror:
    """Data of a fast steering mirror.

    Parameters
    ----------
    mass : float
        kg.
    inertia : ndarray, shape (3, 3)
        At the centre of mass, in the mirror's frame (z is the mirror's normal) [kg m2].
    stiffness, damping : float
        Of each joint [Nm/rad], [Nm s/rad].
    center_of_mass : tuple of float
        From the pivot, the intersection of both axes [m].
    """

    mass: float
    inertia: FloatArray
    stiffness: float
    damping: float
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)


def fast_steering_mirror(data: FastSteeringMirror, point: str = "If", stiffness: RealParameter | None = None) -> System:
    """TITOP block of a fast steering mirror (ports: see the module).

    `stiffness` is an uncertain factor k of that of both joints (2 occurrences): **the torque by a command stays, so
    that the static gain from command to angle is 1 / k.**

    Examples
    --------
    The static gain from commanded to actual angle is 1:

    >>> fsm = fast_steering_mirror(FastSteeringMirror(0.05, np.diag([3e-5, 3e-5, 6e-5]), 77.0, 0.015))
    >>> np.round(fsm["fsm_angle", "fsm_command"].nominal()(0).real, 12).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    mass = from_inertia(data.mass, data.inertia, data.center_of_mass, "fast steering mirror")
    block = rigid_body("mirror", point, mass)
    for name, axis in (("y", (0.0, 1.0, 0.0)), ("x", (1.0, 0.0, 0.0))):
        block = on_revolute_joint(
            block,
            point,
            axis,
            stiffness=data.stiffness,
            damping=data.damping,
            angle=f"angle_{name}",
            torque=f"torque_{name}",
        )
        block = position_commanded(block, f"torque_{name}", f"command_{name}", data.stiffness)
    command, angle = Port("fsm_command", 2, "rad"), Port("fsm_angle", 2, "rad")
    xy = [Port("x", 1, "rad"), Port("y", 1, "rad")]
    accel, wrench = ports.accel(point).name, ports.wrench(point).name
    known = {} if stiffness is None else {"springs": uncertain_gain(angle, stiffness)}
    return connect(
        {
            **known,
            "split": static_gain(np.eye(2), [command], xy),
            "mirror": block,
            "join": static_gain(np.eye(2), xy, [angle]),
        },
        [
            (accel, f"mirror.{accel}"),
            # a torque -(k - 1) K angle is that of the command -(k - 1) angle
            ((command.name, *(("join.fsm_angle", "-springs.fsm_angle") if known else ())), "split.fsm_command"),
            *([("join.fsm_angle", "springs.fsm_angle")] if known else []),
            ("split.x", "mirror.command_x"),
            ("split.y", "mirror.command_y"),
            ("mirror.angle_x", "join.x"),
            ("mirror.angle_y", "join.y"),
        ],
        inputs=[ports.accel(point), command],
        outputs={wrench: f"mirror.{wrench}", angle.name: "join.fsm_angle"},
    )
