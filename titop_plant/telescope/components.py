"""The components of the telescope that its parameter file describes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lftkit import System
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.blocks.flexible_body import flexible_body
from titop_plant.blocks.isolator import MountedActuator
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator
from titop_plant.blocks.reaction_wheel import MountedWheel, ReactionWheel
from titop_plant.blocks.revolute_joint import DriveRotor
from titop_plant.blocks.solar_array import SolarArray, solar_array
from titop_plant.physical_settings import ANGLE
from titop_plant.ports import AXES
from titop_plant.structures.modal_data import ModalData, from_inertia
from titop_plant.structures.modal_file import read_modal_data
from titop_plant.structures.residual_mass import (
    ResidualMode,
    add_residual_modes,
    check_residual_mass,
    repair_residual_mass,
)
from titop_plant.telescope.layout import MountedBody
from titop_plant.telescope.tables.uncertain import factors_of_modes
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.uncertain_parameters import wheel_speeds

_ROUNDING = 1e-3
"""Part of the rigid mass that may be missing by rounding of the printed participation."""


def body_modes(body: MountedBody) -> ModalData:
    """Modal data of a solar array or an appendage, clamped at its root A: of its file, or of printed numbers.

    The printed participation of few modes may take more than the rigid mass by rounding: it is scaled by
    the smallest factor that leaves none negative. Then come the further modes.

    Raises
    ------
    ValueError
        More is missing than rounding explains (a thousandth of the rigid mass); names axis and amount. A file that
        cannot be read or has points for other bodies.
    """
    table, name = body.modes, body.kind.replace("_", " ")
    if table is None:
        path = body.modal_data
        try:
            data = read_modal_data(path)
        except OSError as error:
            raise InputError(f"{body.name}: modal_data must be a readable file, got {path}: {error.strerror}") from None
        if data.children or not data.n_modes:
            got = f"{len(data.children)} points and {data.n_modes} modes"
            raise InputError(
                f"{body.name}: modal_data must hold modes and no points for other bodies, got {got} in {path}"
            )
        return replace(data, name=name)
    mass = from_inertia(table.mass, table.inertia_at_cg, table.center_of_mass, name)
    frequencies, participation = np.array(table.frequencies, dtype=float), np.array(table.participation)
    damping = np.full(len(frequencies), table.damping)
    printed = ModalData(name, "A", np.zeros(3), mass, frequencies, damping, participation)
    check_residual_mass(printed, tolerance=_ROUNDING)
    modes = [
        ResidualMode(m.frequency, table.damping, np.eye(6)[AXES.index(m.direction)], m.share)
        for m in table.further_modes
    ]
    return add_residual_modes(repair_residual_mass(printed).data, modes)


def uncertain_modes(body: MountedBody, telescope: Telescope, modes: int) -> Mapping[str, Any]:
    """Uncertain modes of a mounted body with so many, as arguments of its block: frequencies [rad/s], and factors."""
    known = telescope.uncertain
    names = ((i, f"{body.parameters}.omega_{i + 1}") for i in range(modes))
    frequencies = {i: known[name] for i, name in names if name in known}
    factors = factors_of_modes(telescope.factors, body.parameters, modes)
    return {**factors, "frequencies": {**factors["frequencies"], **frequencies}}


def array_block(telescope: Telescope, array: MountedBody) -> System:
    """Solar array on its drive; one that is fixed has neither gearbox nor torque.

    Returns
    -------
    System
        Ports of :mod:`titop_plant.blocks.solar_array`; without a drive ``accel_<P>`` and ``wrench_<P>`` alone.
    """
    modes, fixed = body_modes(array), array.theta_range[0]
    uncertain = uncertain_modes(array, telescope, modes.n_modes)
    axis, dcm, drive = np.array(array.axis, dtype=float), array.dcm, array.drive
    if not array.turns and fixed:
        dcm = dcm @ Rotation.from_rotvec(fixed * axis / math.sqrt(axis @ axis)).as_matrix().T
    if drive is None:
        return _clamped(modes, array.point, dcm, uncertain)
    rotor = drive_rotor(array)
    data = SolarArray(modes, axis, dcm, drive.gearbox_stiffness, drive.gearbox_damping, rotor)
    tau = telescope.uncertain[ANGLE] if array.turns else None
    return solar_array(data, array.point, tau, **uncertain)


def drive_rotor(array: MountedBody) -> DriveRotor | None:
    """Rotor of the motor of an array's drive, where it has a stepper."""
    motor = array.stepper
    if motor is None:
        return None
    return DriveRotor(motor.rotor_inertia, motor.gear_ratio, motor.stiffness, motor.motor_damping)


def appendage_block(telescope: Telescope, body: MountedBody) -> System:
    """Flexible appendage, clamped at its point: ``accel_<P>`` -> ``wrench_<P>``."""
    modes = body_modes(body)
    return _clamped(modes, body.point, body.dcm, uncertain_modes(body, telescope, modes.n_modes))


def _clamped(modes: ModalData, point: str, dcm: FloatArray, uncertain: Mapping[str, Any]) -> System:
    return mounted(flexible_body(modes, **uncertain), modes.parent, point, dcm=dcm)


def wheel_components(telescope: Telescope) -> list[MountedWheel]:
    """The wheels around I_w, axes parallel to the body's frame."""
    return [
        MountedWheel(
            ReactionWheel(one.mass, one.axial_inertia, one.radial_inertia, one.bearing), one.axis, one.position, speed
        )
        for one, speed in zip(telescope.wheels, wheel_speeds(telescope.wheels))
    ]


def platform_mass(telescope: Telescope) -> FloatArray:
    """Mass matrix of the isolator's platform at I_p, shape (6, 6)."""
    table = telescope.isolator
    return from_inertia(table.mass, table.inertia_at_cg, table.center_of_mass, "isolator platform")


def actuator_components(telescope: Telescope) -> list[MountedActuator]:
    """Proof-mass actuators on the platform: at each azimuth one axial, one tangential; none without azimuths.

    Axial ones push along +z, tangential ones along increasing azimuth.
    """
    table = telescope.pma
    actuator = ProofMassActuator(
        table.moving_mass, table.casing_mass, np.diag(table.inertia), table.stiffness, table.damping
    )
    result = []
    for azimuth in np.radians(table.azimuths_deg):
        radial = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        tangent = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        position = table.mounting_radius * radial + table.height * up
        result.append(MountedActuator(actuator, position, np.vstack([radial, tangent, up])))
        result.append(MountedActuator(actuator, position, np.vstack([up, radial, tangent])))
    return result
