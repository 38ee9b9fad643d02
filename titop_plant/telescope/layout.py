"""What is mounted on the spacecraft: solar arrays, reaction wheels and flexible appendages of a parameter file.

Any number of each may be there. A file gives solar arrays and wheels in one of two forms:

=========================  ==========================================================================================
``[solar_array]``          one kind of array, one at each point P that has a ``dcm_P``; they share their parameters
``[[solar_array]]``        one table an array, each with its own data, drive and parameters
``[reaction_wheel]``       one kind of wheel, in a pyramid of as many as there are ``azimuths_deg``
``[[reaction_wheel]]``     one table a wheel, each with its axis
``[[appendage]]``          one table a flexible body without a drive, such as an antenna
=========================  ==========================================================================================

The rest of the project asks the functions of this module how many there are, where, and with which parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant import ports
from titop_plant.blocks.pyramid import pyramid_axes
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES, STAGES

ARRAYS, WHEELS, APPENDAGES = "solar_array", "reaction_wheel", "appendage"
"""Tables of a parameter file."""

ANGLE = f"{ARRAYS}.tau"
"""Parameter tan(theta / 4) of all arrays that turn: they follow the Sun together."""

BEARING, BROADBAND, STEPPER = "bearing", "broadband", "stepper"
"""Optional tables: in that of a wheel the first two, in that of a drive or an array the third."""

DENSITIES = ("radial_force", "axial_force", "radial_torque", "axial_torque")
"""Spectral densities of a wheel's broadband noise."""

SOURCE_OF_STEPPER = (
    *("rate", "micro_steps", "detent_torque", "current_offset", "gain_mismatch", "third_harmonic"),
    *("quadrature_error", "gear_errors"),
)
"""Values of a stepper that make its torques and are not in the plant."""

WHEEL_IMBALANCE, WHEEL_TORQUE, SADM_TORQUE = "wheel_imbalance", "wheel_torque", "sadm_torque"
"""Names of the input ports whose size depends on what is mounted."""

IMBALANCE_CHANNELS = 5
"""Forces x, y, z and torques x, y of one wheel."""

DRIVE = ("gearbox_stiffness", "gearbox_damping", "torque_bound")
"""Values of a drive, which a table of an array may give in place of those of ``[sadm]``."""


@dataclass(frozen=True)
class MountedBody:
    """A flexible body at a point of the central body.

    Parameters
    ----------
    name : str
    point : str
        Of the central body.
    parameters : str
        Beginning of the names of its uncertain parameters; bodies with the same one share them.
    table : mapping
        Its data, see docs/your_spacecraft.md.
    dcm : ndarray, shape (3, 3)
        From the spacecraft's frame to the body's own.
    """

    name: str
    point: str
    parameters: str
    table: Mapping[str, Any] = field(repr=False)
    dcm: FloatArray = field(repr=False)

    @property
    def driven(self) -> bool:
        """Whether it turns on a drive, whose torque disturbs and whose gearbox is elastic."""
        return bool(self.table.get("driven", True)) and "drive_axis" in self.table

    @property
    def stepper(self) -> Mapping[str, Any] | None:
        """Values of the motor of its drive, where the file has them."""
        return self.table.get(STEPPER) if self.driven else None

    @property
    def turns(self) -> bool:
        """Whether its angle is the parameter `ANGLE`."""
        low, high = self.table.get("theta_range", (0.0, 0.0))
        return self.driven and low < high


@dataclass(frozen=True)
class WheelOnBoard:
    """A reaction wheel of the assembly at the point ``I_w``.

    Parameters
    ----------
    name : str
    mass, axial_inertia, radial_inertia : float
        kg, kg m2.
    axis : ndarray, shape (3,)
        Of the spin, in the spacecraft's frame, a unit vector.
    position : ndarray, shape (3,)
        Its centre, from ``I_w`` [m].
    maximum_speed, default_speed : float
        rad/s.
    bearing, broadband : mapping, optional
        See :mod:`titop_plant.telescope.tables.mechanisms`.
    """

    name: str
    mass: float
    axial_inertia: float
    radial_inertia: float
    axis: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    maximum_speed: float
    default_speed: float
    bearing: Mapping[str, float] | None = field(default=None, repr=False)
    broadband: Mapping[str, list[float]] | None = field(default=None, repr=False)


def solar_arrays(parameters: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Solar arrays of a parameter file, in its order.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> [(array.name, array.point, array.parameters) for array in solar_arrays(load_parameters())]
    [('array_1', 'A1', 'solar_array'), ('array_2', 'A2', 'solar_array')]
    """
    given = parameters[ARRAYS]
    drive = {key: parameters["sadm"][key] for key in (*DRIVE, STEPPER) if key in parameters["sadm"]}
    if not isinstance(given, Mapping):
        return tuple(_mounted(table, drive) for table in given)
    points = [key.removeprefix("dcm_") for key in given if key.startswith("dcm_")]
    table = {**drive, **given}
    return tuple(
        MountedBody(f"array_{i}", point, ARRAYS, table, np.array(given[f"dcm_{point}"], dtype=float))
        for i, point in enumerate(points, start=1)
    )


def appendages(parameters: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Flexible bodies without a drive, in the order of the file."""
    return tuple(_mounted(table, {}) for table in parameters.get(APPENDAGES, ()))


def _mounted(table: Mapping[str, Any], drive: Mapping[str, Any]) -> MountedBody:
    dcm = np.array(table.get("dcm", np.eye(3)), dtype=float)
    own = str(table.get("parameters", table["name"]))
    return MountedBody(str(table["name"]), str(table["point"]), own, {**drive, **table}, dcm)


def driven_arrays(parameters: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Solar arrays with a drive: one signal of ``sadm_torque`` each."""
    return tuple(array for array in solar_arrays(parameters) if array.driven)


def motors(parameters: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Driven arrays with a stepper motor."""
    return tuple(array for array in driven_arrays(parameters) if array.stepper is not None)


def arrays_turn(parameters: Mapping[str, Any]) -> bool:
    """Whether the telescope has the parameter `ANGLE`."""
    return any(array.turns for array in solar_arrays(parameters))


def mounted_points(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Points of the central body where arrays and appendages are, each once."""
    bodies = (*solar_arrays(parameters), *appendages(parameters))
    return tuple(dict.fromkeys(body.point for body in bodies))


def reaction_wheels(parameters: Mapping[str, Any]) -> tuple[WheelOnBoard, ...]:
    """Reaction wheels of a parameter file, in its order.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> len(reaction_wheels(load_parameters()))
    4
    """
    given = parameters[WHEELS]
    if isinstance(given, Mapping):
        return _pyramid(given)
    return tuple(
        _wheel(table, str(table["name"]), _direction(table["axis"]), table["position"], table["default_speed"])
        for table in given
    )


def _wheel(table: Mapping[str, Any], name: str, axis: FloatArray, position: ArrayLike, speed: float) -> WheelOnBoard:
    """A wheel of the kind that a table describes."""
    mass, axial, radial = (float(table[key]) for key in ("mass", "axial_inertia", "radial_inertia"))
    place = np.array(position, dtype=float)
    top, more = float(table["maximum_speed"]), (table.get(BEARING), table.get(BROADBAND))
    return WheelOnBoard(name, mass, axial, radial, axis, place, top, float(speed), *more)


def _direction(axis: Sequence[float]) -> FloatArray:
    """Unit vector."""
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def _pyramid(table: Mapping[str, Any]) -> tuple[WheelOnBoard, ...]:
    """Wheels of one kind about +z."""
    azimuths = np.radians(table["azimuths_deg"])
    axes = pyramid_axes(math.radians(table["cant_deg"]), azimuths.tolist()).T
    found = []
    for i, (azimuth, axis, speed) in enumerate(zip(azimuths, axes, table["default_speed"]), start=1):
        position = table["mounting_radius"] * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        found.append(_wheel(table, f"wheel_{i}", axis, position, speed))
    return tuple(found)


def wheel_axes(parameters: Mapping[str, Any]) -> FloatArray:
    """Spin axes Gamma, shape (3, n), body frame."""
    return np.array([wheel.axis for wheel in reaction_wheels(parameters)]).T


def speed_names(count: int) -> tuple[str, ...]:
    """Names of the parameters of so many wheels.

    Examples
    --------
    >>> speed_names(2)
    ('wheel_1.speed', 'wheel_2.speed')
    """
    return tuple(f"wheel_{i}.speed" for i in range(1, count + 1))


def control_stages(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Stages of the control that a telescope has: those with forces only where it has proof-mass actuators.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> reference = load_parameters()
    >>> control_stages(reference)
    ('none', 'isolator', 'fsm', 'fsm+pma')
    >>> control_stages({**reference, "pma": {**reference["pma"], "azimuths_deg": []}})
    ('none', 'isolator', 'fsm')
    """
    actuators = len(parameters["pma"]["azimuths_deg"]) > 0
    return tuple(stage for stage in STAGES if actuators or stage not in FORCE_STAGES)


def mirror_stages(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Those of them with the mirror's loop closed: the last one closes all loops that there are."""
    return tuple(stage for stage in control_stages(parameters) if stage in MIRROR_STAGES)


def wheel_count(parameters: Mapping[str, Any]) -> int:
    """Number of reaction wheels."""
    given = parameters[WHEELS]
    return len(given["azimuths_deg"]) if isinstance(given, Mapping) else len(given)


def default_speeds(parameters: Mapping[str, Any]) -> tuple[float, ...]:
    """Speeds of the wheels in the parameter file [rad/s]."""
    return tuple(wheel.default_speed for wheel in reaction_wheels(parameters))


def torque_bounds(parameters: Mapping[str, Any]) -> FloatArray:
    """Largest disturbance torque of each array drive [Nm], shape (drives,)."""
    return np.array([float(array.table["torque_bound"]) for array in driven_arrays(parameters)])


def imbalance_port(wheels: int) -> Port:
    """Port of the imbalance of so many wheels."""
    unit = ",".join([ports.IMBALANCE_UNIT] * wheels)
    return Port(WHEEL_IMBALANCE, IMBALANCE_CHANNELS * wheels, unit)


def disturbance_ports(parameters: Mapping[str, Any]) -> tuple[Port, ...]:
    """Inputs of micro-vibrations: imbalance of the wheels and, where there are drives, their torques."""
    drives = len(driven_arrays(parameters))
    found = [imbalance_port(wheel_count(parameters))]
    return (*found, Port(SADM_TORQUE, drives, "Nm")) if drives else tuple(found)


def channels(parameters: Mapping[str, Any]) -> int:
    """Number of micro-vibration inputs.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> channels(load_parameters())
    22
    """
    return IMBALANCE_CHANNELS * wheel_count(parameters) + len(driven_arrays(parameters))


def source_tables(parameters: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Tables of broadband noise and of steppers that make disturbances, each with the name of its wheel or array.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> source_tables(load_parameters())
    []
    """
    noisy = [(wheel.name, wheel.broadband) for wheel in reaction_wheels(parameters)]
    stepping = [(array.name, array.stepper) for array in motors(parameters)]
    return [(name, table) for name, table in (*noisy, *stepping) if table is not None]


def on_bearings(parameters: Mapping[str, Any]) -> bool:
    """Whether a wheel has a compliant bearing."""
    return any(wheel.bearing is not None for wheel in reaction_wheels(parameters))


def without_bearings(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters with rigid wheels."""
    given = parameters[WHEELS]
    tables = [given] if isinstance(given, Mapping) else given
    rigid = [{key: value for key, value in table.items() if key != BEARING} for table in tables]
    return {**parameters, WHEELS: rigid[0] if isinstance(given, Mapping) else rigid}


def without_steppers(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters with drives whose gearbox ends at the body, with fixed harmonics."""

    def stripped(table: Any) -> Any:
        if isinstance(table, (list, tuple)):
            return [stripped(entry) for entry in table]
        return {key: value for key, value in table.items() if key != STEPPER}

    return {**parameters, **{name: stripped(parameters[name]) for name in ("sadm", ARRAYS) if name in parameters}}


def without_sources(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters without what only makes disturbances: broadband noise of wheels, torques of steppers."""

    def stripped(table: Any) -> Any:
        if isinstance(table, (list, tuple)):
            return [stripped(entry) for entry in table]
        if not isinstance(table, Mapping) or not {BROADBAND, STEPPER} & set(table):
            return table
        kept = {key: value for key, value in table.items() if key != BROADBAND}
        if STEPPER in kept:
            kept[STEPPER] = {key: value for key, value in kept[STEPPER].items() if key not in SOURCE_OF_STEPPER}
        return kept

    names = (ARRAYS, WHEELS, "sadm")
    return {key: stripped(value) if key in names else value for key, value in parameters.items()}


def present(names: Sequence[str], available: Sequence[Port]) -> tuple[str, ...]:
    """Those of some ports that a system has: one without drives has no ``sadm_torque``."""
    have = {port.name for port in available}
    return tuple(name for name in names if name in have)
