"""Rotation by a varying angle, rational in tau = tan(theta / 4).

In the plane of rotation ``R(theta/2) = (I + tau J)(I - tau J)^-1`` is a Cayley map with tau repeated
twice, and ``R(theta)`` is its square: 4 occurrences for a vector, 8 for a twist or a wrench, 16 for a
rotated body (8 for the twist towards the body, 8 for the wrench back).
``tau = 0`` is theta = 0, ``tau = 1`` is theta = pi; theta in (-2 pi, 2 pi) is regular.

Source: the paper, "Full spacecraft assembly" (Delta_tau); Sanfedino et al. (2022), doi 10.1016/j.ymssp.2021.108168.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit import Port, RealParameter, System, connect
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant import ports

_VECTOR = Port("v", 3)


def rotation(axis: ArrayLike, tau: RealParameter, port: Port = _VECTOR, *, sign: float = 1.0) -> System:
    """``v_out = R(sign theta) v_in`` for each 3-vector of a port, 4 occurrences of tau per vector.

    Parameters
    ----------
    axis : array_like, shape (3,)
        Axis of rotation.
    tau : RealParameter
        tan(theta / 4) with any nominal value.
    port : Port
        3 signals per vector; the port of both input and output.
    sign : {1.0, -1.0}
        -1 gives the inverse rotation.

    Examples
    --------
    tau = 1 is a rotation by pi:

    >>> turn = rotation([0, 1, 0], RealParameter("tau", 0.0, -1.0, 1.0))
    >>> bool(np.allclose(turn.at({"tau": 1.0}).D, np.diag([-1.0, 1.0, -1.0])))
    True
    """
    u = _unit(axis)
    e1 = np.cross(np.eye(3)[int(np.argmin(np.abs(u)))], u)
    e1 /= np.sqrt(e1 @ e1)
    plane = np.column_stack([e1, np.cross(u, e1)])  # (e1, e2, u) is right-handed
    J, I2 = sign * np.array([[0.0, -1.0], [1.0, 0.0]]), np.eye(2)
    # Rotation by theta / 2, p -> q, with w = tau z: z = J (p + w), q = p + 2 w. Two in series:
    Dzw, Dzp = np.block([[J, np.zeros((2, 2))], [2.0 * J, J]]), np.vstack([J, J])
    Dqw, Dqp = np.hstack([2.0 * I2, 2.0 * I2]), I2
    # Around the nominal value: w = tau_0 z + w', w' = (tau - tau_0) z.
    shift = linalg.inv(np.eye(4) - tau.nominal * Dzw)
    Dzw, Dzp = shift @ Dzw, shift @ Dzp
    Dqw, Dqp = Dqw + tau.nominal * Dqw @ Dzw, Dqp + tau.nominal * Dqw @ Dzp
    each = np.eye(port.size // 3)
    D = np.block(
        [
            [np.kron(each, Dzw), np.kron(each, Dzp @ plane.T)],
            [np.kron(each, plane @ Dqw), np.kron(each, plane @ Dqp @ plane.T + np.outer(u, u))],
        ]
    )
    empty = np.zeros((0, 0))
    channels = (tau.name,) * (4 * len(each))
    return System(empty, empty, empty, D, (port,), (port,), channels=channels, elements=(tau,))


def turned(block: System, point: str, axis: ArrayLike, tau: RealParameter) -> System:
    """A block rotated by theta about an axis through its attachment point (16 occurrences of tau).

    Parameters
    ----------
    block : System
        Has ``accel_<point>`` as input and ``wrench_<point>`` as output; other ports stay as they are.
    point : str
        Attachment point.
    axis : array_like, shape (3,)
        In the frame of the parent. **Positive theta rotates the block about +axis.**
    tau : RealParameter
        tan(theta / 4).

    Examples
    --------
    A rod along x, rotated by pi / 2 about z, is along y:

    >>> from titop_plant.blocks.flexible_body import rigid_body
    >>> from titop_plant.structures.modal_data import from_inertia
    >>> rod = rigid_body("rod", "P", from_inertia(1.0, np.zeros((3, 3)), [2.0, 0.0, 0.0]))
    >>> tau = RealParameter("tau", 0.0, -1.0, 1.0)
    >>> D = turned(rod, "P", [0, 0, 1], tau).at({"tau": np.tan(np.pi / 8)}).D
    >>> [round(float(-D[i, i]), 9) + 0.0 for i in (3, 4)]
    [4.0, 0.0]
    """
    accel, wrench = ports.accel(point), ports.wrench(point)
    others_in = [p for p in block.inputs if p.name != accel.name]
    others_out = [p for p in block.outputs if p.name != wrench.name]
    # A vector of the parent's frame has the coordinates R(-theta) v in the rotated frame.
    return connect(
        {
            "out": rotation(axis, tau, accel, sign=-1.0),
            "block": block,
            "back": rotation(axis, tau, wrench),
        },
        [
            (accel.name, f"out.{accel.name}"),
            (f"out.{accel.name}", f"block.{accel.name}"),
            (f"block.{wrench.name}", f"back.{wrench.name}"),
            *((p.name, f"block.{p.name}") for p in others_in),
        ],
        inputs=[accel, *others_in],
        outputs={
            wrench.name: f"back.{wrench.name}",
            **{p.name: f"block.{p.name}" for p in others_out},
        },
    )


def _unit(axis: ArrayLike) -> FloatArray:
    vector = np.asarray(axis, dtype=float)
    if vector.shape != (3,) or not np.sqrt(vector @ vector) > 0:
        raise InputError(f"axis must be a nonzero vector of length 3, got {axis!r}")
    return np.asarray(vector / np.sqrt(vector @ vector))
