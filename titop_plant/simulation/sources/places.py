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
from titop_plant.structures.reference import body_points
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, load_port, motor_ports
from titop_plant.telescope.layout import (
    SADM_TORQUE,
    WHEEL_IMBALANCE,
    WHEEL_TORQUE,
    appendages,
    disturbance_ports,
    driven_arrays,
    reaction_wheels,
    solar_arrays,
    wheel_axes,
    wheel_count,
)
from titop_plant.telescope.parameters import Parameters

BUS, PAYLOAD = (
    {"wheels": "I_w", "isolator": "I_p"},
    {
        "payload": "platform",
        "M1": "M1",
        "M2": "M2",
        "detector": "DET",
    },
)


def nodes(parameters: Parameters) -> dict[str, str]:
    """Nodes of the structure beside the bus's reference point, by the names of places.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> list(nodes(load_parameters()))
    ['wheels', 'isolator', 'array_1', 'array_2', 'payload', 'M1', 'M2', 'detector']
    """
    arrays, others = solar_arrays(parameters), appendages(parameters)
    found = {**BUS, **{f"array_{i}": one.point for i, one in enumerate(arrays, start=1)}, **PAYLOAD}
    found |= {one.name: one.point for one in (*arrays, *others)}
    points = () if parameters["body"]["modal_data"] else body_points(parameters)
    return found | {point: point for point in points if point not in found.values()}


def loaded_nodes(parameters: Parameters) -> tuple[str, ...]:
    """Nodes of all places, each once: the loads of a telescope that sources act on."""
    return tuple(dict.fromkeys(nodes(parameters).values()))


def wheel_places(parameters: Parameters) -> dict[str, int]:
    """Number of the wheel at each place of a wheel, from 0."""
    wheels = reaction_wheels(parameters)
    return {f"wheel_{i + 1}": i for i in range(len(wheels))} | {one.name: i for i, one in enumerate(wheels)}


def drive_places(parameters: Parameters) -> tuple[str, ...]:
    """Places of the array drives, in the order of their torques."""
    return tuple(f"drive_{i}" for i in range(1, len(driven_arrays(parameters)) + 1))


def all_places(parameters: Parameters) -> tuple[str, ...]:
    """Names of all places."""
    return ("bus", *nodes(parameters), *wheel_places(parameters), *drive_places(parameters))


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
        No such place, a frame that is no rotation, an offset at an array drive.
    """
    places, ports = all_places(parameters), source_ports(parameters)
    if place not in places:
        raise ValueError(f"place must be one of {', '.join(places)}, got {place!r}")
    columns, drives, wheels = port_slices(ports), drive_places(parameters), wheel_places(parameters)
    whole = np.zeros((total_size(ports), 6))
    turn = np.eye(3) if frame is None else _rotation(frame)
    if place in drives:
        if offset is not None or frame is not None:
            raise ValueError(f"frame and offset must be absent at {place}, which has a torque about its axis only")
        whole[columns[SADM_TORQUE].start + drives.index(place), 5] = 1.0
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
    port = EXTERNAL_WRENCH.name if place == "bus" else load_port(nodes(parameters)[place]).name
    whole[columns[port]] = wrench
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
