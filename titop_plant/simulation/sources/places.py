"""Places of the structure where a source acts, and the axes of its forces and torques.

=================================  ==================================================================================
place                              what the wrench acts on; axes "own"
=================================  ==================================================================================
``bus``                            the bus at its reference point; body
``wheels``, ``isolator``           the nodes of the bus under the wheels and under the isolator; body
``array_1``, ``array_2``           the nodes of the bus at the array drives; body
``payload``                        the payload's platform, behind the isolator; body
``M1``, ``M2``, ``detector``       nodes of the payload; body
``wheel_1`` .. ``wheel_4``         the structure at a wheel; the wheel's frame, z along its spin axis
``drive_1``, ``drive_2``           the torque about the axis of an array drive, the source's last axis
=================================  ==================================================================================

**A positive force acts on the structure along the positive axis.**
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from lftkit import Port
from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices, total_size
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, SADM_TORQUE, WHEEL_IMBALANCE, WHEEL_TORQUE, load_port
from titop_plant.telescope.components import wheel_axes
from titop_plant.telescope.parameters import Parameters

NODES: Mapping[str, str] = MappingProxyType(
    {
        "wheels": "I_w",
        "isolator": "I_p",
        "array_1": "A1",
        "array_2": "A2",
        "payload": "platform",
        "M1": "M1",
        "M2": "M2",
        "detector": "DET",
    }
)
"""Nodes of the structure beside the bus's reference point, by the names of places."""
WHEELS = tuple(f"wheel_{i}" for i in range(1, 5))
DRIVES = ("drive_1", "drive_2")
ALL_PLACES = ("bus", *NODES, *WHEELS, *DRIVES)
"""Names of all places."""
PORTS: tuple[Port, ...] = (
    WHEEL_IMBALANCE,
    WHEEL_TORQUE,
    SADM_TORQUE,
    EXTERNAL_WRENCH,
    *(load_port(node) for node in NODES.values()),
)
"""Inputs of the structure that sources drive."""
COLUMNS = port_slices(PORTS)
SIZE = total_size(PORTS)


def place_matrix(
    place: str, parameters: Parameters, frame: FloatArray | None = None, offset: FloatArray | None = None
) -> FloatArray:
    """Forces and torques (6) of a source to the inputs of `PORTS`, shape (size, 6).

    Parameters
    ----------
    place : str
        One of `ALL_PLACES`.
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
    if place not in ALL_PLACES:
        raise ValueError(f"place must be one of {', '.join(ALL_PLACES)}, got {place!r}")
    whole = np.zeros((SIZE, 6))
    turn = np.eye(3) if frame is None else _rotation(frame)
    if place in DRIVES:
        if offset is not None or frame is not None:
            raise ValueError(f"frame and offset must be absent at {place}, which has a torque about its axis only")
        whole[COLUMNS[SADM_TORQUE.name].start + DRIVES.index(place), 5] = 1.0
        return whole
    wrench = np.kron(np.eye(2), turn)
    if offset is not None:
        arm = np.eye(6)
        arm[3:, :3] = _cross(np.asarray(offset, dtype=float))
        wrench = wrench @ arm
    if place in WHEELS:
        i = WHEELS.index(place)
        if frame is not None:
            wrench = np.kron(np.eye(2), spin_frame(wheel_axes(parameters)[:, i])) @ wrench
        first = COLUMNS[WHEEL_IMBALANCE.name].start + 5 * i
        whole[first : first + 5] = wrench[:5]
        whole[COLUMNS[WHEEL_TORQUE.name].start + i] = wrench[5]
        return whole
    port = EXTERNAL_WRENCH.name if place == "bus" else load_port(NODES[place]).name
    whole[COLUMNS[port]] = wrench
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
