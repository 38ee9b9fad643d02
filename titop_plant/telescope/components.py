"""The components of the telescope that its parameter file describes."""

from __future__ import annotations

import math

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror
from titop_plant.blocks.isolator import Isolator, MountedActuator
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator
from titop_plant.blocks.reaction_wheel import MountedWheel, ReactionWheel, pyramid_axes
from titop_plant.blocks.solar_array import SolarArray
from titop_plant.ports import AXES
from titop_plant.structures.modal_data import ModalData, from_inertia
from titop_plant.structures.residual_mass import (
    ResidualMode,
    add_residual_modes,
    check_residual_mass,
    repair_residual_mass,
)
from titop_plant.telescope.optics import TwoMirrorTelescope
from titop_plant.telescope.parameters import Parameters, uncertain_parameters

_ROUNDING = 1e-3
"""Part of the rigid mass that may be missing by rounding of the printed participation."""


def array_modes(parameters: Parameters) -> ModalData:
    """Modal data of one solar array, clamped at its root A.

    The printed participation of two modes takes more than the rigid mass by rounding: it is scaled by
    the smallest factor that leaves none negative. Then come the further modes.

    Raises
    ------
    ValueError
        More is missing than rounding explains (a thousandth of the rigid mass); names axis and amount.
    """
    table = parameters["solar_array"]
    mass = from_inertia(table["mass"], table["inertia_at_cg"], table["center_of_mass"], "solar array")
    damping = np.full(2, table["damping"])
    printed = ModalData(
        "solar array", "A", np.zeros(3), mass, table["frequencies"], damping, np.array(table["participation"])
    )
    check_residual_mass(printed, tolerance=_ROUNDING)
    modes = [
        ResidualMode(m["frequency"], table["damping"], np.eye(6)[AXES.index(m["direction"])], m["share"])
        for m in table["further_modes"]
    ]
    return add_residual_modes(repair_residual_mass(printed).data, modes)


def array_component(parameters: Parameters, side: str) -> SolarArray:
    """Solar array with its drive; side "A1" (+y) or "A2" (-y)."""
    table, sadm = parameters["solar_array"], parameters["sadm"]
    return SolarArray(
        array_modes(parameters),
        np.array(table["drive_axis"], dtype=float),
        np.array(table[f"dcm_{side}"], dtype=float),
        sadm["gearbox_stiffness"],
        sadm["gearbox_damping"],
    )


def wheel_axes(parameters: Parameters) -> FloatArray:
    """Spin axes Gamma, shape (3, 4), body frame."""
    table = parameters["reaction_wheel"]
    return pyramid_axes(math.radians(table["cant_deg"]), np.radians(table["azimuths_deg"]).tolist())


def wheel_components(parameters: Parameters) -> list[MountedWheel]:
    """The four wheels around I_w, axes parallel to the body's frame."""
    table = parameters["reaction_wheel"]
    wheel = ReactionWheel(table["mass"], table["axial_inertia"], table["radial_inertia"])
    speeds = uncertain_parameters(parameters)
    result = []
    for i, (azimuth, axis) in enumerate(zip(np.radians(table["azimuths_deg"]), wheel_axes(parameters).T), start=1):
        position = table["mounting_radius"] * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        result.append(MountedWheel(wheel, axis, position, speeds[f"wheel_{i}.speed"]))
    return result


def platform_mass(parameters: Parameters) -> FloatArray:
    """Mass matrix of the isolator's platform at I_p, shape (6, 6)."""
    table = parameters["isolator"]
    return from_inertia(table["mass"], table["inertia_at_cg"], table["center_of_mass"], "isolator platform")


def isolator_component(parameters: Parameters) -> Isolator:
    """The 6-dof isolator."""
    table = parameters["isolator"]
    return Isolator(platform_mass(parameters), np.diag(table["stiffness"]), np.diag(table["damping"]))


def actuator_components(parameters: Parameters) -> list[MountedActuator]:
    """Six proof-mass actuators on the platform: at each of three azimuths one axial, one tangential.

    Axial ones push along +z, tangential ones along increasing azimuth.
    """
    table = parameters["pma"]
    actuator = ProofMassActuator(
        table["moving_mass"], table["casing_mass"], np.diag(table["inertia"]), table["stiffness"], table["damping"]
    )
    result = []
    for azimuth in np.radians(table["azimuths_deg"]):
        radial = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        tangent = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        position = table["mounting_radius"] * radial + table["height"] * up
        result.append(MountedActuator(actuator, position, np.vstack([radial, tangent, up])))
        result.append(MountedActuator(actuator, position, np.vstack([up, radial, tangent])))
    return result


def mirror_component(parameters: Parameters) -> FastSteeringMirror:
    """The fast steering mirror at I_f."""
    table = parameters["fsm"]
    return FastSteeringMirror(table["mass"], np.diag(table["inertia"]), table["stiffness"], table["damping"])


def optics_component(parameters: Parameters) -> TwoMirrorTelescope:
    """Paraxial data of the telescope."""
    table = parameters["optics"]
    return TwoMirrorTelescope(table["primary_focal_length"], table["mirror_distance"], table["back_focal_distance"])
