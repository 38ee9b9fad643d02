"""Revolute joint with stiffness and damping: a body that rotates about one axis.

The joint is massless. Its angle phi follows from the balance of torques about the axis: the torque of
the child on the joint plus ``-k phi - d phi' + torque`` is zero. The child is a block from acceleration
to wrench, so phi'' is obtained by inverting that one channel (the paper's "invertibility of all of its
12 input-output channels").

With a :class:`DriveRotor` the spring ends at the rotor of a motor behind a gear of ratio n, psi its angle at the
output, instead of at the parent. The rotor is held by the magnetic spring k_m, d_m of the motor, and turns n times as
fast, omega the rate of the parent about the axis::

    n J (omega' + n psi'') = -n^2 (k_m psi + d_m psi') + k (phi - psi) + d (phi' - psi') + n motor_torque
    wrench on the parent   = wrench of the child - axis J (omega' + n psi'')

Two states more. With J small and k_m large it is the joint above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lftkit import Port, System, connect, invert, state_space, transform
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant import ports
from titop_plant.blocks.rotation import _unit

SWING, BALANCE = Port("swing", 1, "rad/s2"), Port("balance", 1, "Nm")
REACTION, MOVED = Port("reaction", 6, ports.WRENCH_UNIT), Port("moved", 6, ports.TWIST_UNIT)
"""Inside of a joint: phi'' and the torques about the axis; wrench by the child and its motion."""

MOTOR = "motor_torque"
"""Input of a joint with a rotor: torque of the motor on its shaft, against the parent [Nm]."""


@dataclass(frozen=True)
class DriveRotor:
    """Rotor of a motor behind a gear, held by its magnetic field.

    Parameters
    ----------
    inertia : float
        J about the shaft, parallel to the joint's axis [kg m2].
    gear_ratio : float
        n.
    stiffness, damping : float
        k_m [Nm/rad], d_m [Nm s/rad] at the shaft.
    """

    inertia: float
    gear_ratio: float
    stiffness: float
    damping: float = 0.0


def on_revolute_joint(
    child: System,
    point: str,
    axis: ArrayLike,
    *,
    stiffness: float,
    damping: float,
    angle: str = "joint_angle",
    torque: str = "joint_torque",
    rotor: DriveRotor | None = None,
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
    rotor : DriveRotor, optional
        What the spring ends at; None: at the parent.

    Returns
    -------
    System
        Two more states (angle and rate) than the child, with a rotor four; with it also the input `MOTOR`.

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
            raise InputError(f"revolute joint at {point}: {name} must not be negative, got {value}")
    u = _unit(axis)
    accel, wrench = ports.accel(point), ports.wrench(point)
    joint = _joint(u, stiffness, damping, accel, wrench, Port(torque, 1, "Nm"), Port(angle, 1, "rad"))
    if rotor is not None:
        # The joint with two states more, psi and psi', and the input `MOTOR`
        n, (A, B, C, D) = rotor.gear_ratio, joint.matrices
        held = n**2 * np.array([rotor.stiffness, rotor.damping])
        spring = np.array([stiffness, damping])
        # Torque on the rotor at the output of the gear, of phi, phi', psi, psi'; then of the motor's torque.
        on_rotor, motor = np.concatenate([spring, -spring - held]), n
        whole = np.zeros((4, 4))
        whole[:2, :2], whole[2, 3], whole[3] = A, 1.0, on_rotor / (n**2 * rotor.inertia)
        inputs = np.zeros((4, B.shape[1] + 1))
        inputs[:2, :-1], inputs[3, 3:6] = B, -u / n
        inputs[3, -1] = motor / (n**2 * rotor.inertia)
        outputs, direct = np.hstack([C, np.zeros((len(C), 2))]), np.hstack([D, np.zeros((len(D), 1))])
        outputs[12, 2:] += spring  # the spring ends at the rotor
        outputs[9:12] -= np.outer(u, on_rotor / n)  # what changes the rotor's momentum acts on the parent
        direct[9:12, -1] -= u * motor / n
        joint = state_space(whole, inputs, outputs, direct, [*joint.inputs, Port(MOTOR, 1, "Nm")], list(joint.outputs))
    return _inverted(child, joint, point)


def _joint(
    u: FloatArray, stiffness: float, damping: float, accel: Port, wrench: Port, torque: Port, angle: Port
) -> System:
    """The joint alone, from the motion of its parent, phi'' and the wrench of the child."""
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
    return state_space(A, B, C, D, [accel, SWING, REACTION, torque], [MOVED, wrench, BALANCE, angle])


def _inverted(child: System, joint: System, point: str) -> System:
    """The child on its joint: phi'' is that at which the torques about the axis balance."""
    accel, wrench = ports.accel(point), ports.wrench(point)
    torques, angle = joint.inputs[3:], joint.outputs[3].name
    others_in = [p for p in child.inputs if p.name != accel.name]
    others_out = [p for p in child.outputs if p.name != wrench.name]
    both = connect(
        {"joint": joint, "child": child},
        [
            (accel.name, f"joint.{accel.name}"),
            (SWING.name, "joint.swing"),
            (f"child.{wrench.name}", "joint.reaction"),
            *((p.name, f"joint.{p.name}") for p in torques),
            ("joint.moved", f"child.{accel.name}"),
            *((p.name, f"child.{p.name}") for p in others_in),
        ],
        inputs=[accel, *torques, *others_in, SWING],
        outputs={
            wrench.name: f"joint.{wrench.name}",
            angle: f"joint.{angle}",
            **{p.name: f"child.{p.name}" for p in others_out},
            BALANCE.name: "joint.balance",
        },
    )
    try:
        free = invert(both, {SWING.name: BALANCE.name})
    except ValueError:
        raise InputError(f"revolute joint at {point}: child must have inertia about the axis, got none") from None
    return free.select(
        inputs=[p.name for p in free.inputs if p.name != BALANCE.name],
        outputs=[p.name for p in free.outputs if p.name != SWING.name],
    )


def position_commanded(block: System, torque: str, command: str, stiffness: float) -> System:
    """Drive a joint by a commanded angle [rad], ``torque = stiffness * command``, as with a piezo stack."""
    return transform(block, inputs={torque: (np.array([[stiffness]]), Port(command, 1, "rad"))})
