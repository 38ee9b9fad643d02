"""Revolute joint with stiffness and damping: a body that rotates about one axis.

The joint is massless. Its angle phi follows from the balance of torques about the axis: the torque of
the child on the joint plus ``-k phi - d phi' + torque`` is zero. The child is a block from acceleration
to wrench, so phi'' is obtained by inverting that one channel (the paper's "invertibility of all of its
12 input-output channels").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lftkit import Port, System, connect, invert, state_space, transform
from titop_plant import ports
from titop_plant.blocks.rotation import _unit


def on_revolute_joint(
    child: System,
    point: str,
    axis: ArrayLike,
    *,
    stiffness: float,
    damping: float,
    angle: str = "joint_angle",
    torque: str = "joint_torque",
) -> System:
    """A block mounted on a revolute joint at its attachment point.

    Parameters
    ----------
    child : System
        Has ``accel_<point>`` as input and ``wrench_<point>`` as output; other ports stay.
    point : str
        Attachment point; its name is kept on the parent's side.
    axis : array_like, shape (3,)
        Joint axis in the child's frame.
    stiffness, damping : float
        k [Nm/rad] and d [Nm s/rad], not negative.
    angle, torque : str
        Names of the new output (joint angle [rad], **positive: the child is rotated about +axis**) and the
        new input (**motor torque on the child about +axis** [Nm]; the opposite torque acts on the parent).

    Returns
    -------
    System
        Two more states (angle and rate) than the child.

    Raises
    ------
    ValueError
        Negative stiffness or damping; a child without inertia about the axis.

    Examples
    --------
    A constant torque rotates the child against the spring; the static torque on the parent is zero:

    >>> from titop_plant.blocks.flexible_body import rigid_body
    >>> wheel = rigid_body("wheel", "P", np.eye(6))
    >>> joint = on_revolute_joint(wheel, "P", [0, 0, 1], stiffness=4.0, damping=0.1)
    >>> dc = joint[("joint_angle", "wrench_P"), "joint_torque"].nominal()(0).real
    >>> round(float(dc[0, 0]), 12), round(abs(float(dc[-1, 0])), 12)
    (0.25, 0.0)
    """
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        if not value >= 0.0:
            raise ValueError(f"revolute joint at {point}: {name} must not be negative, got {value}")
    u = _unit(axis)
    accel, wrench = ports.accel(point), ports.wrench(point)
    turn = np.concatenate([np.zeros(3), u])[:, None]
    # States phi, phi'; inputs accel_P 6, phi'' 1, wrench by the child 6, torque 1.
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    B = np.zeros((2, 14))
    B[1, 6] = 1.0
    C = np.zeros((14, 2))
    D = np.zeros((14, 14))
    D[:6, :6], D[:6, 6:7] = np.eye(6), turn  # acceleration of the child
    D[6:12, 7:13] = np.eye(6)  # a massless joint transmits the child's wrench to the parent
    C[12] = [-stiffness, -damping]
    D[12, 7:13], D[12, 13] = turn[:, 0], 1.0  # torque balance, set to zero by the inversion below
    C[13] = [1.0, 0.0]
    swing, balance = Port("swing", 1, "rad/s2"), Port("balance", 1, "Nm")
    reaction, moved = Port("reaction", 6, ports.WRENCH_UNIT), Port("moved", 6, ports.TWIST_UNIT)
    joint = state_space(
        A,
        B,
        C,
        D,
        [accel, swing, reaction, Port(torque, 1, "Nm")],
        [moved, wrench, balance, Port(angle, 1, "rad")],
    )
    others_in = [p for p in child.inputs if p.name != accel.name]
    others_out = [p for p in child.outputs if p.name != wrench.name]
    both = connect(
        {"joint": joint, "child": child},
        [
            (accel.name, f"joint.{accel.name}"),
            (swing.name, "joint.swing"),
            (f"child.{wrench.name}", "joint.reaction"),
            (torque, f"joint.{torque}"),
            ("joint.moved", f"child.{accel.name}"),
            *((p.name, f"child.{p.name}") for p in others_in),
        ],
        inputs=[accel, Port(torque, 1, "Nm"), *others_in, swing],
        outputs={
            wrench.name: f"joint.{wrench.name}",
            angle: f"joint.{angle}",
            **{p.name: f"child.{p.name}" for p in others_out},
            balance.name: "joint.balance",
        },
    )
    try:
        free = invert(both, {swing.name: balance.name})
    except ValueError:
        raise ValueError(f"revolute joint at {point}: child must have inertia about the axis, got none") from None
    return free.select(
        inputs=[p.name for p in free.inputs if p.name != balance.name],
        outputs=[p.name for p in free.outputs if p.name != swing.name],
    )


def position_commanded(block: System, torque: str, command: str, stiffness: float) -> System:
    """Drive a joint by a commanded angle [rad], ``torque = stiffness * command``, as with a piezo stack."""
    return transform(block, inputs={torque: (np.array([[stiffness]]), Port(command, 1, "rad"))})
