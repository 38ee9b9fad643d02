"""The whole spacecraft by kinematic elimination: an oracle for the assembly from TITOP blocks.

Generalised coordinates: rigid motion of G (6), modes of the central body, isolator (6), modes of the
payload, mirror angles (2), strokes of the proof masses (6), gearbox angles (2), modes of both arrays. Every body's
twist is a Jacobian times their rates, kinetic energy gives one mass matrix, springs and dampers
one stiffness and one damping matrix (the gyroscopic terms of the wheels and the attitude law in it)::

    M q'' + D q' + K q = B u,     y = Ca q'' + Cv q' + Cp q + F u

Derived from the equations of motion and the paper. Its inputs are the modal data of the bodies and the numbers of
the parameter file; it shares no code with the project and imports numpy and scipy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

INPUTS = {
    "wheel_imbalance": 20,
    "sadm_torque": 2,
    "external_wrench": 6,
    "wheel_torque": 4,
    "fsm_command": 2,
    "pma_force": 6,
}
OUTPUTS = {
    "accel_Ip": 6,
    "accel_M1": 6,
    "accel_M2": 6,
    "los": 2,
    "los_controlled": 2,
    "fsm_angle": 2,
    "pma_stroke": 6,
    "attitude": 3,
    "attitude_rate": 3,
    "accel_G": 6,
    "sadm_angle": 2,
    "wheel_accel": 4,
}


def index_slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Slice of each name in the stacked vector."""
    result, start = {}, 0
    for name, size in sizes.items():
        result[name] = slice(start, start + size)
        start += size
    return result


def cross_matrix(v: Any) -> np.ndarray:
    """v x . as a matrix."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def carry(lever: Any) -> np.ndarray:
    """Twist of a point at `lever` from the base: velocity v + omega x lever, same omega."""
    matrix = np.eye(6)
    matrix[:3, 3:] = -cross_matrix(lever)
    return matrix


def about_point(mass: float, inertia: Any, center: Any) -> np.ndarray:
    """Mass matrix of a rigid body for the twist of a point, its centre of mass at `center` from there."""
    to_center = carry(center)
    return to_center.T @ linalg.block_diag(mass * np.eye(3), np.asarray(inertia, dtype=float)) @ to_center


def turn(axis: Any, angle: float) -> np.ndarray:
    """Rotation by `angle` about a unit axis (exponential map)."""
    return np.asarray(linalg.expm(angle * cross_matrix(np.asarray(axis, dtype=float))))


@dataclass(frozen=True)
class SecondOrder:
    """M q'' + D q' + K q = B u and its outputs; the first three coordinates are the translation of G."""

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    B: np.ndarray
    Ca: np.ndarray
    Cv: np.ndarray
    Cp: np.ndarray
    F: np.ndarray

    def frequency_response(self, omega: Any) -> np.ndarray:
        """Response at each frequency, shape (k, outputs, inputs).

        Translation has no stiffness: its unknown is the acceleration (column not multiplied by s^2), which
        keeps the equations regular at any frequency. Rows and columns have the same scaling.
        """
        response = np.empty((len(omega), *self.F.shape), dtype=complex)
        for i, w in enumerate(omega):
            s = 1j * w
            power = np.full(len(self.M), s**2)
            power[:3] = 1.0
            impedance = self.M * power + s * self.D + self.K
            scale = 1.0 / np.sqrt(np.abs(np.diag(impedance)))
            scaled = scale[:, None] * impedance * scale
            factors = linalg.lu_factor(scaled)
            right = scale[:, None] * self.B.astype(complex)
            x = linalg.lu_solve(factors, right)
            x += linalg.lu_solve(factors, right - scaled @ x)
            x *= scale[:, None]
            outputs = self.Ca * power + s * self.Cv + self.Cp
            response[i] = outputs @ x + self.F
        return response

    def state_matrix(self) -> np.ndarray:
        """A of the first-order form without the translation of G."""
        M = self.M[3:, 3:] - self.M[3:, :3] @ linalg.solve(self.M[:3, :3], self.M[:3, 3:])
        n = len(M)
        low = -linalg.solve(M, np.hstack([self.K[3:, 3:], self.D[3:, 3:]]))
        return np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), low])


class Spacecraft:
    """Collects mass, damping, stiffness and inputs over the generalised coordinates.

    Parameters
    ----------
    telescope : Telescope
        The parameter file.
    body, payload, array : modal data
        name, positions, mass matrix, frequencies, damping, participation, child ports.
    values : mapping
        ``wheel_i.speed``, ``solar_array.omega_1``, ``solar_array.omega_2``, ``solar_array.tau``.
    isolated : bool
        False: the platform is fixed to the body.
    """

    def __init__(
        self, telescope: Any, body: Any, payload: Any, array: Any, values: Mapping[str, float], isolated: bool
    ) -> None:
        self.parameters, self.values = telescope, values
        self.body, self.payload, self.array = body, payload, array
        sizes = {
            "G": 6,
            "body": body.frequencies.size,
            "isolator": 6 if isolated else 0,
            "payload": payload.frequencies.size,
            "fsm": 2,
            "pma": 6,
            "sadm": 2,
            "A1": array.frequencies.size,
            "A2": array.frequencies.size,
        }
        self.reserve(sizes, INPUTS, OUTPUTS)

    def reserve(self, sizes: Mapping[str, int], inputs: Mapping[str, int], outputs: Mapping[str, int]) -> None:
        """Zeros for so many coordinates, inputs and outputs."""
        self.at = index_slices(sizes)
        n = sum(sizes.values())
        self.M, self.D, self.K = (np.zeros((n, n)) for _ in range(3))
        self.inputs, self.outputs = index_slices(inputs), index_slices(outputs)
        self.B = np.zeros((n, sum(inputs.values())))
        p = sum(outputs.values())
        self.Ca, self.Cv, self.Cp = (np.zeros((p, n)) for _ in range(3))
        self.F = np.zeros((p, self.B.shape[1]))
        self.twist_G = self.pick("G")
        self.platform = np.zeros((6, n))

    def pick(self, name: str) -> np.ndarray:
        """Rows that select the coordinates of this name."""
        return np.eye(self.M.shape[0])[self.at[name]]

    def add_flexible(self, data: Any, twist: np.ndarray, name: str, frequencies: np.ndarray) -> None:
        """Kinetic energy 1/2 [v; e']' [[M_rr, L'], [L, I]] [v; e'] and the springs of the modes."""
        L, modes = data.participation, self.pick(name)
        self.M += twist.T @ data.mass_matrix @ twist + modes.T @ modes
        coupling = modes.T @ L @ twist
        self.M += coupling + coupling.T
        self.D += modes.T @ np.diag(2.0 * data.damping * frequencies) @ modes
        self.K += modes.T @ np.diag(frequencies**2) @ modes

    def child_twist(self, data: Any, twist: np.ndarray, name: str, port: str) -> np.ndarray:
        """Jacobian of the twist of a child point."""
        child = next(c for c in data.children if c.name == port)
        return carry(child.position - data.parent_position) @ twist + child.shapes @ self.pick(name)

    def add_rigid(self, mass: np.ndarray, twist: np.ndarray) -> None:
        self.M += twist.T @ mass @ twist

    def add_body(self) -> None:
        self.add_flexible(self.body, self.twist_G, "body", self.body.frequencies)
        self.B[:, self.inputs["external_wrench"]] = self.twist_G.T
        self.Ca[self.outputs["accel_G"]] = self.twist_G
        self.Cp[self.outputs["attitude"]] = self.twist_G[3:]
        self.Cv[self.outputs["attitude_rate"]] = self.twist_G[3:]

    def add_wheels(self) -> None:
        """Each rotor rotates freely about its axis; about this axis it exerts the motor torque only."""
        table = self.parameters["reaction_wheel"]
        base = self.child_twist(self.body, self.twist_G, "body", "I_w")
        cant, J_w = math.radians(table["cant_deg"]), table["axial_inertia"]
        for i, azimuth in enumerate(np.radians(table["azimuths_deg"])):
            out = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            axis = math.cos(cant) * out + np.array([0.0, 0.0, math.sin(cant)])
            x = np.cross([0.0, 0.0, 1.0], axis)
            x = x / math.sqrt(x @ x)
            frame = np.array([x, np.cross(axis, x), axis])
            twist = linalg.block_diag(frame, frame) @ carry(table["mounting_radius"] * out) @ base
            J_r = table["radial_inertia"]
            self.add_rigid(np.diag([table["mass"]] * 3 + [J_r, J_r, 0.0]), twist)
            momentum = J_w * self.values[f"wheel_{i + 1}.speed"]
            # Torque that rotates the angular momentum h z at the rate omega: omega x h z = h (omega_y, -omega_x).
            self.D += momentum * (np.outer(twist[3], twist[4]) - np.outer(twist[4], twist[3]))
            first = self.inputs["wheel_imbalance"].start + 5 * i
            self.B[:, first : first + 5] = twist[:5].T
            motor = self.inputs["wheel_torque"].start + i
            self.B[:, motor] = twist[5]
            rotor = self.outputs["wheel_accel"].start + i
            self.Ca[rotor], self.F[rotor, motor] = -twist[5], -1.0 / J_w

    def add_arrays(self) -> None:
        """Body -> gearbox angle -> root rotated by theta -> modes."""
        table, sadm = self.parameters["solar_array"], self.parameters["sadm"]
        axis = np.asarray(table["drive_axis"], dtype=float)
        theta = 4.0 * math.atan(self.values["solar_array.tau"])
        frequencies = self.array.frequencies.copy()
        frequencies[0], frequencies[1] = (self.values[f"solar_array.omega_{i}"] for i in (1, 2))
        for i, side in enumerate(("A1", "A2")):
            angle = self.pick("sadm")[i]
            root = self.child_twist(self.body, self.twist_G, "body", side)
            root = root + np.outer(np.concatenate([np.zeros(3), axis]), angle)
            frame = np.asarray(table[f"dcm_{side}"], dtype=float) @ turn(axis, theta).T
            self.add_flexible(self.array, linalg.block_diag(frame, frame) @ root, side, frequencies)
            self.K += sadm["gearbox_stiffness"] * np.outer(angle, angle)
            self.D += sadm["gearbox_damping"] * np.outer(angle, angle)
            self.B[:, self.inputs["sadm_torque"].start + i] = angle
            self.Cp[self.outputs["sadm_angle"].start + i] = angle

    def add_platform(self) -> None:
        """The isolator's platform on its springs and dampers, with the proof-mass actuators."""
        table = self.parameters["isolator"]
        moved = self.pick("isolator")
        self.platform = self.child_twist(self.body, self.twist_G, "body", "I_p")
        if len(moved):
            self.platform = self.platform + moved
            self.K += moved.T @ np.diag(table["stiffness"]) @ moved
            self.D += moved.T @ np.diag(table["damping"]) @ moved
        own = about_point(table["mass"], table["inertia_at_cg"], table["center_of_mass"])
        self.add_rigid(own, self.platform)
        self.Ca[self.outputs["accel_Ip"]] = self.platform

    def add_proof_masses(self) -> None:
        """At each azimuth one along +z, then one along the tangent; its inertia is given with z along the stroke."""
        table = self.parameters["pma"]
        up = np.array([0.0, 0.0, 1.0])
        mounts = []
        for azimuth in np.radians(table["azimuths_deg"]):
            radial = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            tangent = np.cross(up, radial)
            position = table["mounting_radius"] * radial + table["height"] * up
            mounts += [(position, [radial, tangent, up]), (position, [up, radial, tangent])]
        for i, (position, axes) in enumerate(mounts):
            frame, stroke = np.array(axes), self.pick("pma")[i]
            twist = carry(position) @ self.platform
            inertia = frame.T @ np.diag(table["inertia"]) @ frame
            self.add_rigid(linalg.block_diag(table["casing_mass"] * np.eye(3), inertia), twist)
            moving = twist[:3] + np.outer(frame[2], stroke)
            self.M += table["moving_mass"] * moving.T @ moving
            self.K += table["stiffness"] * np.outer(stroke, stroke)
            self.D += table["damping"] * np.outer(stroke, stroke)
            self.B[:, self.inputs["pma_force"].start + i] = stroke
            self.Cp[self.outputs["pma_stroke"].start + i] = stroke

    def add_payload(self) -> None:
        self.add_flexible(self.payload, self.platform, "payload", self.payload.frequencies)
        for point in ("M1", "M2"):
            twist = self.child_twist(self.payload, self.platform, "payload", point)
            self.Ca[self.outputs[f"accel_{point}"]] = twist

    def add_mirror(self) -> None:
        """A rigid mirror that tips and tilts; a commanded angle acts through the joint's spring."""
        table, angles = self.parameters["fsm"], self.pick("fsm")
        twist = self.child_twist(self.payload, self.platform, "payload", "I_f")
        twist[3:5] += angles
        self.add_rigid(np.diag([table["mass"]] * 3 + list(table["inertia"])), twist)
        self.K += table["stiffness"] * angles.T @ angles
        self.D += table["damping"] * angles.T @ angles
        self.B[:, self.inputs["fsm_command"]] = table["stiffness"] * angles.T
        self.Cp[self.outputs["fsm_angle"]] = angles

    def add_line_of_sight(self) -> None:
        """Chief ray of a two-mirror telescope: displacement of the image by each element, over the focal length.

        About y: a tilt e of M1 rotates the ray by 2 e, a shift e of M1 along x is equivalent to a tilt e / (2 f1);
        M2 acts through the image of the primary, the detector through the full focal length.
        """
        optics, modes = self.parameters["optics"], self.pick("payload")
        f1, d, b = (optics[k] for k in ("primary_focal_length", "mirror_distance", "back_focal_distance"))
        gap = f1 - d
        f = f1 * (d + b) / gap
        tilt = {"M1": 2.0, "M2": -2.0 * gap / f1, "DET": 0.0}
        shift = {"M1": 1.0 / f1, "M2": 1.0 / f - 1.0 / f1, "DET": -1.0 / f}
        los = self.platform[3:5].copy()
        for child in self.payload.children:
            if child.name in tilt:
                los[0] += (tilt[child.name] * child.shapes[3] - shift[child.name] * child.shapes[1]) @ modes
                los[1] += (tilt[child.name] * child.shapes[4] + shift[child.name] * child.shapes[0]) @ modes
            if child.name == "I_f":
                los += self.parameters["fsm"]["los_sensitivity"] * child.shapes[3:5] @ modes
        self.Cp[self.outputs["los"]] = los
        mirror = self.parameters["fsm"]["los_sensitivity"] * self.pick("fsm")
        self.Cp[self.outputs["los_controlled"]] = los + mirror

    def wheel_axes(self) -> np.ndarray:
        """Unit vectors of the wheels' axes, shape (3, wheels)."""
        wheels = self.parameters["reaction_wheel"]
        cant = math.radians(wheels["cant_deg"])
        axes = [
            [math.cos(cant) * math.cos(a), math.cos(cant) * math.sin(a), math.sin(cant)]
            for a in np.radians(wheels["azimuths_deg"])
        ]
        return np.array(axes).T

    def close_attitude(self, inertia: np.ndarray) -> None:
        """u = -Gamma^+ (K_d rate + K_p angle) on the wheels' motors, J the diagonal of the total inertia."""
        table, J = self.parameters["attitude_control"], np.diag(np.diag(inertia))
        motors, rotors = self.inputs["wheel_torque"], self.outputs["wheel_accel"]
        Gamma = self.wheel_axes()
        allocation = Gamma.T @ linalg.inv(Gamma @ Gamma.T)
        attitude = self.twist_G[3:]
        position = -allocation @ (table["bandwidth"] ** 2 * J) @ attitude
        rate = -allocation @ (2.0 * table["damping"] * table["bandwidth"] * J) @ attitude
        self.K -= self.B[:, motors] @ position
        self.D -= self.B[:, motors] @ rate
        self.Cp[rotors] += self.F[rotors, motors] @ position
        self.Cv[rotors] += self.F[rotors, motors] @ rate


def assemble(
    telescope: Any,
    body: Any,
    payload: Any,
    array: Any,
    values: Mapping[str, float],
    *,
    isolated: bool = True,
    controlled: bool = True,
    control_inertia: np.ndarray | None = None,
) -> SecondOrder:
    """The spacecraft at given parameter values.

    Parameters
    ----------
    control_inertia : ndarray, shape (3, 3), optional
        Total inertia used in the attitude law. Default: that of these parameter values.
    """
    craft = Spacecraft(telescope, body, payload, array, values, isolated)
    craft.add_body()
    craft.add_wheels()
    craft.add_arrays()
    craft.add_platform()
    craft.add_proof_masses()
    craft.add_payload()
    craft.add_mirror()
    craft.add_line_of_sight()
    if controlled:
        craft.close_attitude(total_inertia(craft.M) if control_inertia is None else control_inertia)
    return SecondOrder(craft.M, craft.D, craft.K, craft.B, craft.Ca, craft.Cv, craft.Cp, craft.F)


def total_inertia(M: np.ndarray) -> np.ndarray:
    """Inertia of the free rigid spacecraft about its centre of mass."""
    return np.asarray(M[3:6, 3:6] - M[3:6, :3] @ linalg.solve(M[:3, :3], M[:3, 3:6]))
