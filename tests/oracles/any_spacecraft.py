"""The spacecraft by kinematic elimination with any arrays, wheels and appendages.

The equations are those of :mod:`oracles.kinematic_elimination`; what is mounted is given as plain data, each array with
its own modes, axis and gearbox, each wheel with its own axis. Nothing of the project is imported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from oracles.kinematic_elimination import SecondOrder, Spacecraft, carry, total_inertia, turn
from scipy import linalg


@dataclass(frozen=True)
class Wheel:
    """A wheel: its axis and its centre from ``I_w`` in the spacecraft's frame, its speed [rad/s].

    `rotor`, where it has bearings: mass, radial inertia, stiffness and damping of translation x, y, z, rotation x, y.
    """

    mass: float
    axial: float
    radial: float
    axis: Sequence[float]
    position: Sequence[float]
    speed: float
    rotor: tuple[float, float, Sequence[float], Sequence[float]] | None = None


@dataclass(frozen=True)
class Mounted:
    """An array or an appendage: modal data, DCM at angle 0, angle [rad] about an axis, gearbox (k, d) where driven."""

    modes: Any
    frequencies: np.ndarray
    point: str
    dcm: Any
    axis: Sequence[float] = (0.0, 1.0, 0.0)
    angle: float = 0.0
    gearbox: tuple[float, float] | None = None


class AnySpacecraft(Spacecraft):
    """Mass, damping, stiffness and inputs of the whole."""

    def __init__(
        self, parameters: Any, body: Any, payload: Any, wheels: Sequence[Wheel], mounted: Sequence[Mounted]
    ) -> None:
        self.parameters, self.body, self.payload = parameters, body, payload
        self.wheels, self.mounted = wheels, mounted
        self.driven = [i for i, one in enumerate(mounted) if one.gearbox]
        self.actuators = 2 * len(parameters["pma"]["azimuths_deg"])
        sizes = {
            "G": 6,
            "body": body.frequencies.size,
            "isolator": 6,
            "payload": payload.frequencies.size,
            "fsm": 2,
            "pma": self.actuators,
            "sadm": len(self.driven),
            **{f"mounted_{i}": one.modes.frequencies.size for i, one in enumerate(mounted)},
            **{f"rotor_{i}": 5 for i, wheel in enumerate(wheels) if wheel.rotor},
        }
        n, drives = len(wheels), {"sadm_torque": len(self.driven)} if self.driven else {}
        inputs = {"wheel_imbalance": 5 * n, **drives, "external_wrench": 6, "wheel_torque": n, "fsm_command": 2}
        outputs = {"accel_Ip": 6, "accel_M1": 6, "accel_M2": 6, "los": 2, "los_controlled": 2, "fsm_angle": 2}
        outputs |= {"pma_stroke": 6} if self.actuators else {}
        outputs |= {"attitude": 3, "attitude_rate": 3, "accel_G": 6}
        outputs |= {"sadm_angle": len(self.driven)} if self.driven else {}
        self.reserve(sizes, {**inputs, "pma_force": 6}, {**outputs, "wheel_accel": n})
        self.twist_G, self.platform = self.pick("G"), np.zeros((6, self.M.shape[0]))

    def add_wheels(self) -> None:
        """Each rotor turns freely; a change of the direction of its angular momentum takes a torque."""
        base = self.child_twist(self.body, self.twist_G, "body", "I_w")
        for i, wheel in enumerate(self.wheels):
            axis = np.asarray(wheel.axis, dtype=float) / math.sqrt(np.dot(wheel.axis, wheel.axis))
            x = np.cross([0.0, 0.0, 1.0], axis)
            x = x / math.sqrt(x @ x) if x @ x > 1e-12 else np.array([1.0, 0.0, 0.0])
            frame = np.array([x, np.cross(axis, x), axis])
            twist = linalg.block_diag(frame, frame) @ carry(np.asarray(wheel.position, dtype=float)) @ base
            whole, hub = np.array([wheel.mass] * 3 + [wheel.radial] * 2 + [0.0]), twist
            if wheel.rotor:
                mass, inertia, stiffness, damping = wheel.rotor
                moved, part = self.pick(f"rotor_{i}"), np.array([mass] * 3 + [inertia] * 2 + [0.0])
                self.add_rigid(np.diag(whole - part), hub)
                twist, whole = hub + np.vstack([moved, np.zeros((1, moved.shape[1]))]), part
                self.K += moved.T @ np.diag(stiffness) @ moved
                self.D += moved.T @ np.diag(damping) @ moved
            self.add_rigid(np.diag(whole), twist)
            momentum = wheel.axial * wheel.speed
            self.D += momentum * (np.outer(twist[3], twist[4]) - np.outer(twist[4], twist[3]))
            first = self.inputs["wheel_imbalance"].start + 5 * i
            self.B[:, first : first + 5] = twist[:5].T
            motor, rotor = self.inputs["wheel_torque"].start + i, self.outputs["wheel_accel"].start + i
            self.B[:, motor] = twist[5]
            self.Ca[rotor], self.F[rotor, motor] = -twist[5], -1.0 / wheel.axial

    def add_mounted(self) -> None:
        """Body -> gearbox angle, where there is one -> root turned by its angle -> modes."""
        for i, one in enumerate(self.mounted):
            root = self.child_twist(self.body, self.twist_G, "body", one.point)
            axis = np.asarray(one.axis, dtype=float) / math.sqrt(np.dot(one.axis, one.axis))
            if one.gearbox:
                k = self.driven.index(i)
                swing = self.pick("sadm")[k]
                root = root + np.outer(np.concatenate([np.zeros(3), axis]), swing)
                self.K += one.gearbox[0] * np.outer(swing, swing)
                self.D += one.gearbox[1] * np.outer(swing, swing)
                self.B[:, self.inputs["sadm_torque"].start + k] = swing
                self.Cp[self.outputs["sadm_angle"].start + k] = swing
            frame = np.asarray(one.dcm, dtype=float) @ turn(axis, one.angle).T
            self.add_flexible(one.modes, linalg.block_diag(frame, frame) @ root, f"mounted_{i}", one.frequencies)

    def wheel_axes(self) -> np.ndarray:
        """Unit vectors of the wheels' axes, shape (3, wheels)."""
        axes = np.array([np.asarray(wheel.axis, dtype=float) for wheel in self.wheels])
        return (axes / linalg.norm(axes, axis=1, keepdims=True)).T


def assemble_any(
    parameters: Mapping[str, Any],
    body: Any,
    payload: Any,
    wheels: Sequence[Wheel],
    mounted: Sequence[Mounted],
    control_inertia: np.ndarray | None = None,
) -> tuple[SecondOrder, dict[str, slice], dict[str, slice]]:
    """The isolated spacecraft with its attitude law at given speeds and angles; places of its inputs and outputs."""
    craft = AnySpacecraft(parameters, body, payload, wheels, mounted)
    craft.add_body()
    craft.add_wheels()
    craft.add_mounted()
    craft.add_platform()
    if craft.actuators:
        craft.add_proof_masses()
    craft.add_payload()
    craft.add_mirror()
    craft.add_line_of_sight()
    craft.close_attitude(total_inertia(craft.M) if control_inertia is None else control_inertia)
    made = SecondOrder(craft.M, craft.D, craft.K, craft.B, craft.Ca, craft.Cv, craft.Cp, craft.F)
    return made, craft.inputs, craft.outputs
