"""The telescope's parameter file and the components that it describes."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lti import RealParameter
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror
from titop_plant.blocks.isolator import Isolator, MountedActuator
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator
from titop_plant.blocks.reaction_wheel import MountedWheel, ReactionWheel, pyramid_axes
from titop_plant.blocks.solar_array import SolarArray
from titop_plant.structures.kinematics import AXES, FloatArray
from titop_plant.structures.modal_data import ModalData, from_inertia
from titop_plant.structures.residual_mass import (
    ResidualMode,
    add_residual_modes,
    check_residual_mass,
    repair_residual_mass,
)
from titop_plant.telescope.optics import TwoMirrorTelescope
from titop_plant.telescope.parameter_check import ParameterFile

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Parameters = Mapping[str, Any]

REFERENCE = Path(__file__).with_name("reference.toml")
_OWN_BODIES = ("body", "payload")
_ROUNDING = 1e-3


def load_parameters(path: str | Path = REFERENCE) -> Parameters:
    """Read a parameter file.

    Parameters
    ----------
    path : str or Path
        TOML file of the form of ``reference.toml``; tables that are missing are taken from it, so that a
        user's file holds only what differs. A relative ``body.modal_data`` or ``payload.modal_data`` is looked
        for beside it.

    Raises
    ------
    ValueError
        File missing or not TOML; a key that the reference does not have, or a value of another kind, length or
        sign than the one in its place. The message names the file, the line and the key.
    """
    reference, _ = _read(REFERENCE)
    if Path(path) == REFERENCE:
        return MappingProxyType(reference)
    own, text = _read(Path(path))
    merged = ParameterFile(str(path), text).merged(reference, own)
    for name in _OWN_BODIES:
        file = merged[name]["modal_data"]
        if file:
            merged[name] = {**merged[name], "modal_data": str(Path(path).parent / file)}
    return MappingProxyType(merged)


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """Content of a TOML file, and its text."""
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except OSError as error:
        raise ValueError(f"cannot read the parameter file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a TOML file: expected UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path} is not a TOML file: {error}") from None


def parameters_hash(parameters: Parameters) -> str:
    """Twelve hexadecimal digits that name these parameter values; of a modal data file the content counts."""
    content = dict(parameters)
    for name in _OWN_BODIES:
        file = content[name].get("modal_data", "")
        if file:
            digest = hashlib.sha256(Path(file).read_bytes()).hexdigest()
            content[name] = {**content[name], "modal_data": digest}
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def uncertain_parameters(parameters: Parameters) -> dict[str, RealParameter]:
    """The varying and uncertain parameters of the telescope, in the order of Delta.

    ``wheel_1.speed`` .. ``wheel_4.speed`` [rad/s], ``solar_array.omega_1``, ``solar_array.omega_2``
    [rad/s], ``solar_array.tau`` = tan(theta / 4), one theta for both arrays.
    """
    top = float(parameters["reaction_wheel"]["maximum_speed"])
    result = {}
    for i in range(1, 5):
        name = f"wheel_{i}.speed"
        result[name] = RealParameter(name, 0.0, -top, top, "rad/s", f"speed of reaction wheel {i}")
    array = parameters["solar_array"]
    spread = array["relative_uncertainty"]
    for i in (1, 2):
        w, name = array["frequencies"][i - 1], f"solar_array.omega_{i}"
        about = f"clamped frequency of mode {i} of both arrays"
        result[name] = RealParameter(name, w, w * (1 - spread), w * (1 + spread), "rad/s", about)
    low, high = (math.tan(theta / 4) for theta in array["theta_range"])
    name = "solar_array.tau"
    result[name] = RealParameter(name, 0.0, low, high, "1", "tan(theta/4), theta the angle of both arrays")
    return result


def parameter_box(parameters: Parameters) -> dict[str, tuple[float, float]]:
    """Ranges of the uncertain parameters by name: (lowest, highest)."""
    return {name: (p.lower, p.upper) for name, p in uncertain_parameters(parameters).items()}


def parameter_corners(parameters: Parameters) -> list[dict[str, float]]:
    """All corners of the box of uncertain parameters (2^7)."""
    box = parameter_box(parameters)
    return [dict(zip(box, ends)) for ends in itertools.product(*box.values())]


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
        place = table["mounting_radius"] * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        result.append(MountedWheel(wheel, axis, place, speeds[f"wheel_{i}.speed"]))
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
        place = table["mounting_radius"] * radial + table["height"] * up
        result.append(MountedActuator(actuator, place, np.vstack([radial, tangent, up])))
        result.append(MountedActuator(actuator, place, np.vstack([up, radial, tangent])))
    return result


def mirror_component(parameters: Parameters) -> FastSteeringMirror:
    """The fast steering mirror at I_f."""
    table = parameters["fsm"]
    return FastSteeringMirror(table["mass"], np.diag(table["inertia"]), table["stiffness"], table["damping"])


def optics_component(parameters: Parameters) -> TwoMirrorTelescope:
    """Paraxial data of the telescope."""
    table = parameters["optics"]
    return TwoMirrorTelescope(table["primary_focal_length"], table["mirror_distance"], table["back_focal_distance"])
