"""Places of the structure where a source acts, and the axes of its forces and torques.

=================================  ==================================================================================
place                              what the wrench acts on; axes "own"
=================================  ==================================================================================
``bus``                            the bus at its reference point; body
``wheels``, ``isolator``           the nodes of the bus under the wheels and under the isolator; body
``array_1`` ..                     the nodes of the bus at the solar arrays; body
an appendage, a point              the node of the bus under an antenna, or any other point, by its name; body
``payload``                        the payload's platform, behind the isolator; body
``M1``, ``M2``, ``detector``       nodes of the payload; body
``wheel_1`` ..                     the structure at a wheel; the wheel's frame, z along its spin axis
``drive_1`` ..                     the torque about the axis of an array drive, the source's last axis
a further actuator                 the force of its motor on the structure along its axis, the source's force along z
=================================  ==================================================================================

With a compliant bearing forces and lateral torques at a wheel act on its rotor.
Arrays, wheels and appendages of a user's file go by their own names too. **A positive force acts on the structure along
the positive axis.**
"""

from __future__ import annotations

import numpy as np

from lftkit import Port
from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices, total_size
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, load_port, motor_ports
from titop_plant.telescope.layout import (
    SADM_TORQUE,
    WHEEL_IMBALANCE,
    WHEEL_TORQUE,
    disturbance_ports,
    driven_arrays,
    reaction_wheels,
    wheel_axes,
    wheel_count,
)
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.placed.devices import ACTUATOR_FORCE, placed_actuators
from titop_plant.telescope.placed.points import REFERENCE_POINT, loaded_nodes, nodes


def wheel_places(parameters: Parameters) -> dict[str, int]:
    """Number of the wheel at each place of a wheel, from 0."""
    wheels = reaction_wheels(parameters)
    return {f"wheel_{i + 1}": i for i in range(len(wheels))} | {one.name: i for i, one in enumerate(wheels)}


def drive_places(parameters: Parameters) -> tuple[str, ...]:
    """Places of the array drives, in the order of their torques."""
    return tuple(f"drive_{i}" for i in range(1, len(driven_arrays(parameters)) + 1))


def actuator_places(parameters: Parameters) -> tuple[str, ...]:
    """Names of the further actuators, in the order of their forces."""
    return tuple(one.name for one in placed_actuators(parameters))


def all_places(parameters: Parameters) -> tuple[str, ...]:
    """Names of all places."""
    driven = (*drive_places(parameters), *actuator_places(parameters))
    return (REFERENCE_POINT, *nodes(parameters), *wheel_places(parameters), *driven)


def source_ports(parameters: Parameters) -> tuple[Port, ...]:
    """Inputs of the structure that sources drive."""
    imbalance, *torques = disturbance_ports(parameters)
    wheels = Port(WHEEL_TORQUE, wheel_count(parameters), "Nm")
    loads = map(load_port, loaded_nodes(parameters))
    return (imbalance, wheels, *torques, EXTERNAL_WRENCH, *loads, *motor_ports(parameters))


def place_matrix(
    place: str, parameters: Parameters, frame: FloatArray | None = None, offset: FloatArray | None = None
) -> FloatArray:
    """Forces and torques (6) of a source to the inputs of :func:`source_ports`, shape (size, 6).

    Parameters
    ----------
    place : str
        One of :func:`all_places`.
    parameters : mapping
        Of the telescope.
    frame : ndarray, shape (3, 3), optional
        Columns: axes of the source in the body's frame. Default: the place's own axes.
    offset : ndarray, shape (3,), optional
        Point where the force acts, from the place, in the axes of the source [m].

    Raises
    ------
    ValueError
        No such place, a frame that is no rotation, an offset at an array drive or an actuator.
    """
    places, ports = all_places(parameters), source_ports(parameters)
    if place not in places:
        raise ValueError(f"place must be one of {', '.join(places)}, got {place!r}")
    columns, drives, wheels = port_slices(ports), drive_places(parameters), wheel_places(parameters)
    whole = np.zeros((total_size(ports), 6))
    turn = np.eye(3) if frame is None else _rotation(frame)
    actuators = actuator_places(parameters)
    if place in drives or place in actuators:
        one, port, axis = ("torque about", SADM_TORQUE, 5) if place in drives else ("force along", ACTUATOR_FORCE, 2)
        if offset is not None or frame is not None:
            raise ValueError(f"frame and offset must be absent at {place}, which has a {one} its axis only")
        whole[columns[port].start + (drives if place in drives else actuators).index(place), axis] = 1.0
        return whole
    wrench = np.kron(np.eye(2), turn)
    if offset is not None:
        arm = np.eye(6)
        arm[3:, :3] = _cross(np.asarray(offset, dtype=float))
        wrench = wrench @ arm
    if place in wheels:
        i = wheels[place]
        if frame is not None:
            wrench = np.kron(np.eye(2), spin_frame(wheel_axes(parameters)[:, i])) @ wrench
        first = columns[WHEEL_IMBALANCE].start + 5 * i
        whole[first : first + 5] = wrench[:5]
        whole[columns[WHEEL_TORQUE].start + i] = wrench[5]
        return whole
    loaded = EXTERNAL_WRENCH.name if place == REFERENCE_POINT else load_port(nodes(parameters)[place]).name
    whole[columns[loaded]] = wrench
    return whole


def _rotation(frame: FloatArray) -> FloatArray:
    turn = np.asarray(frame, dtype=float)
    if (
        turn.shape != (3, 3)
        or not np.allclose(turn.T @ turn, np.eye(3), atol=1e-6)
        or np.cross(*turn.T[:2]) @ turn.T[2] < 0
    ):
        raise ValueError("frame must be a rotation, three rows of three numbers, got another matrix")
    return turn


def _cross(arm: FloatArray) -> FloatArray:
    if arm.shape != (3,) or not np.isfinite(arm).all():
        raise ValueError(f"offset must be three numbers [m], got {arm.tolist()}")
    x, y, z = arm
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
