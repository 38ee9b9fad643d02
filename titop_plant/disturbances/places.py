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
an actuator at a place             the force of its motor on the structure along its axis, the source's force along z
=================================  ==================================================================================

With a compliant bearing forces and lateral torques at a wheel act on its rotor.
Arrays, wheels and appendages of a user's file go by their own names too. **A positive force acts on the structure along
the positive axis.**
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lftkit import Port
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import port_slices, total_size
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, load_port, motor_ports
from titop_plant.telescope.layout import SADM_TORQUE, WHEEL_IMBALANCE, WHEEL_TORQUE
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.telescope import Telescope


def wheel_places(telescope: Telescope) -> dict[str, int]:
    """Number, from 0 and among those that turn, of the wheel at each place of such a wheel."""
    turning, wheels = telescope.turning_wheels, telescope.wheels
    return {f"wheel_{i + 1}": k for k, i in enumerate(turning)} | {wheels[i].name: k for k, i in enumerate(turning)}


def drive_places(telescope: Telescope) -> tuple[str, ...]:
    """Places of the array drives, in the order of their torques."""
    return tuple(f"drive_{i}" for i in range(1, len(telescope.driven_arrays) + 1))


def actuator_places(telescope: Telescope) -> dict[str, Port]:
    """Input of each actuator at a place, by its name."""
    return {one.name: one.port for one in telescope.placed_actuators}


def all_places(telescope: Telescope) -> tuple[str, ...]:
    """Names of all places."""
    driven = (*drive_places(telescope), *actuator_places(telescope))
    return (REFERENCE_POINT, *telescope.nodes, *wheel_places(telescope), *driven)


def source_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Inputs of the structure that sources drive."""
    imbalance, *torques = telescope.disturbance_ports
    wheels = Port(WHEEL_TORQUE, len(telescope.turning_wheels), "Nm")
    loads = map(load_port, telescope.loaded_nodes)
    ports = (imbalance, wheels, *torques, EXTERNAL_WRENCH, *loads, *motor_ports(telescope))
    return tuple(port for port in ports if telescope.has_input(port.name))


def place_matrix(
    place: str, telescope: Telescope, frame: FloatArray | None = None, offset: FloatArray | None = None
) -> FloatArray:
    """Forces and torques (6) of a source to the inputs of :func:`source_ports`, shape (size, 6).

    Parameters
    ----------
    place : str
        One of :func:`all_places`.
    telescope : Telescope
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
    places, ports = all_places(telescope), source_ports(telescope)
    if place not in places:
        raise InputError(f"place must be one of {', '.join(places)}, got {place!r}")
    columns, drives, wheels = port_slices(ports), drive_places(telescope), wheel_places(telescope)
    whole = np.zeros((total_size(ports), 6))
    turn = np.eye(3) if frame is None else np.asarray(frame, dtype=float)
    right = turn.shape == (3, 3) and np.allclose(turn.T @ turn, np.eye(3), atol=1e-6)
    if not right or np.cross(*turn.T[:2]) @ turn.T[2] < 0:
        raise InputError("frame must be a rotation, three rows of three numbers, got another matrix")
    actuators = actuator_places(telescope)
    if place in drives or place in actuators:
        turns = place in drives or actuators[place].unit == "Nm"
        one, axis = ("torque about", 5) if turns else ("force along", 2)
        if offset is not None or frame is not None:
            raise InputError(f"frame and offset must be absent at {place}, which has a {one} its axis only")
        row = columns[SADM_TORQUE].start + drives.index(place) if place in drives else columns[place].start
        whole[row, axis] = 1.0
        return whole
    wrench = np.kron(np.eye(2), turn)
    if offset is not None:
        arm = np.eye(6)
        arm[3:, :3] = _cross(np.asarray(offset, dtype=float))
        wrench = wrench @ arm
    if place in wheels:
        i = wheels[place]
        if frame is not None:
            wrench = np.kron(np.eye(2), spin_frame(telescope.wheel_axes[:, telescope.turning_wheels[i]])) @ wrench
        _require_input(WHEEL_TORQUE, place, columns)
        first = columns[WHEEL_IMBALANCE].start + 5 * i
        whole[first : first + 5] = wrench[:5]
        whole[columns[WHEEL_TORQUE].start + i] = wrench[5]
        return whole
    loaded = EXTERNAL_WRENCH.name if place == REFERENCE_POINT else load_port(telescope.nodes[place]).name
    _require_input(loaded, place, columns)
    whole[columns[loaded]] = wrench
    return whole


def _require_input(name: str, place: str, columns: Mapping[str, slice]) -> None:
    """Refuse a place where a plant from a file has no input."""
    if name not in columns:
        raise InputError(f"the plant must have the input {name} for a source at {place}, got {', '.join(columns)}")


def _cross(arm: FloatArray) -> FloatArray:
    if arm.shape != (3,) or not np.isfinite(arm).all():
        raise InputError(f"offset must be three numbers [m], got {arm.tolist()}")
    x, y, z = arm
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
