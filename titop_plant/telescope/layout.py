"""Layout of the spacecraft: solar arrays, reaction wheels and flexible appendages of a parameter file.

Any number of each may be there. A file gives solar arrays and wheels in one of two forms:

=========================  ==========================================================================================
``[solar_array]``          one kind of array, one at each point P that has a ``dcm_P``; they share their parameters
``[[solar_array]]``        one table an array, each with its own data, drive and parameters
``[reaction_wheel]``       one kind of wheel, in a pyramid of as many as there are ``azimuths_deg``
``[[reaction_wheel]]``     one table a wheel, each with its axis
``[[appendage]]``          one table a flexible body without a drive, such as an antenna
=========================  ==========================================================================================

The rest of the project asks :class:`titop_plant.telescope.telescope.Telescope`, which reads them once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant import ports
from titop_plant.blocks.pyramid import pyramid_axes
from titop_plant.telescope.places import BUS, PAYLOAD
from titop_plant.telescope.sections import BodyTable, Broadband, Drive, PrintedModes, Vector, WheelKind

if TYPE_CHECKING:
    from titop_plant.blocks.stepper import Stepper
    from titop_plant.blocks.wheel_bearing import WheelBearing

ARRAYS, WHEELS, APPENDAGES = "solar_array", "reaction_wheel", "appendage"
"""Tables of a parameter file."""

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

DRIVES = "sadm"
"""Table of the values of a drive, in place of which a table of an array may give its own."""


@dataclass(frozen=True)
class MountedBody:
    """A flexible body at a point of the central body.

    Parameters
    ----------
    name, kind : str
        Bodies of one kind share their modal data.
    point : str
        Of the central body.
    parameters : str
        Beginning of the names of its uncertain parameters; bodies with the same one share them.
    dcm : ndarray, shape (3, 3)
        From the spacecraft's frame to the body's own.
    modes : PrintedModes, optional
        None where `modal_data` names a file.
    modal_data : str
    relative_uncertainty : float
        Half-width of its frequencies, relative.
    uncertain_modes : int, optional
        How many of its frequencies are uncertain; None: all.
    axis : tuple of float, optional
        Of its rotation, in the spacecraft's frame; None of an appendage.
    theta_range : tuple of float
        Smallest and largest angle [rad]; equal: the angle at which it is fixed.
    drive : Drive, optional
        What turns it, whose torque disturbs and whose gearbox is elastic.
    """

    name: str
    kind: str
    point: str
    parameters: str
    dcm: FloatArray = field(repr=False)
    modes: PrintedModes | None = field(repr=False)
    modal_data: str
    relative_uncertainty: float
    uncertain_modes: int | None
    axis: Vector | None
    theta_range: tuple[float, float]
    drive: Drive | None

    @property
    def turns(self) -> bool:
        """Whether its angle is the parameter `ANGLE`."""
        low, high = self.theta_range
        return self.drive is not None and low < high

    @property
    def stepper(self) -> Stepper | None:
        """Motor of its drive, where the file has one."""
        return None if self.drive is None else self.drive.stepper


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
    speed_range : tuple of float
        Smallest and largest speed [rad/s]; equal: its only speed.
    default_speed : float
        Of a run that names none [rad/s].
    bearing, broadband : WheelBearing, Broadband, optional
        See :mod:`titop_plant.telescope.sections`.
    """

    name: str
    mass: float
    axial_inertia: float
    radial_inertia: float
    axis: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    speed_range: tuple[float, float]
    default_speed: float
    bearing: WheelBearing | None = field(default=None, repr=False)
    broadband: Broadband | None = field(default=None, repr=False)

    @property
    def varies(self) -> bool:
        """Whether its speed is a parameter."""
        return self.speed_range[0] < self.speed_range[1]

    @property
    def turns(self) -> bool:
        """Whether it is not always at rest, as a spare wheel is, which is a mass."""
        return any(self.speed_range)


def read_arrays(tables: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Solar arrays of the tables of a parameter file, in its order."""
    listed = tables[ARRAYS]
    drive = {key: value for key, value in tables[DRIVES].items() if key in Drive.SETTINGS}
    if not isinstance(listed, Mapping):
        return tuple(_mounted({**drive, **table}) for table in listed)
    points = [key.removeprefix("dcm_") for key in listed if key.startswith("dcm_")]
    shared = {**drive, **listed, "kind": ARRAYS, "parameters": ARRAYS}
    return tuple(
        _mounted({**shared, "name": f"array_{i}", "point": point, "dcm": listed[f"dcm_{point}"]})
        for i, point in enumerate(points, start=1)
    )


def read_appendages(tables: Mapping[str, Any]) -> tuple[MountedBody, ...]:
    """Flexible bodies without a drive, in the order of the file."""
    return tuple(_mounted(table) for table in tables.get(APPENDAGES, ()))


def _mounted(table: Mapping[str, Any]) -> MountedBody:
    """A body of its table, which for a solar array has the values of the drive."""
    name, axis = str(table["name"]), table.get("drive_axis")
    low, high = table.get("theta_range", (0.0, 0.0))
    return MountedBody(
        name,
        str(table.get("kind", name)),
        str(table["point"]),
        str(table.get("parameters", name)),
        np.array(table.get("dcm", np.eye(3)), dtype=float),
        None if table.get("modal_data") else PrintedModes.of_part(table),
        str(table.get("modal_data", "")),
        float(table.get("relative_uncertainty", 0.0)),
        table.get("uncertain_modes"),
        None if axis is None else tuple(axis),
        (float(low), float(high)),
        None if axis is None or not table.get("driven", True) else Drive.of_part(table),
    )


def read_wheels(tables: Mapping[str, Any]) -> tuple[WheelOnBoard, ...]:
    """Reaction wheels of the tables of a parameter file, in its order."""
    listed = tables[WHEELS]
    if isinstance(listed, Mapping):
        # Wheels of one kind about +z
        azimuths = np.radians(listed["azimuths_deg"])
        axes = pyramid_axes(math.radians(listed["cant_deg"]), azimuths.tolist()).T
        wheels = []
        for i, (azimuth, axis, speed) in enumerate(zip(azimuths, axes, listed["default_speed"]), start=1):
            position = listed["mounting_radius"] * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            wheels.append(_wheel(listed, f"wheel_{i}", axis, position, speed))
        return tuple(wheels)
    return tuple(
        _wheel(table, str(table["name"]), _direction(table["axis"]), table["position"], table.get("default_speed"))
        for table in listed
    )


def _wheel(
    table: Mapping[str, Any], name: str, axis: FloatArray, position: ArrayLike, speed: float | None
) -> WheelOnBoard:
    """A wheel of the kind that a table describes."""
    kind, place = WheelKind.of_part(table), np.array(position, dtype=float)
    inertias = kind.mass, kind.axial_inertia, kind.radial_inertia
    default = kind.range[0] if speed is None else float(speed)
    return WheelOnBoard(name, *inertias, axis, place, kind.range, default, kind.bearing, kind.broadband)


def read_nodes(tables: Mapping[str, Any]) -> dict[str, str]:
    """Nodes of the structure beside the bus's reference point, by the names of places."""
    arrays, others = read_arrays(tables), read_appendages(tables)
    nodes = {**BUS, **{f"array_{i}": one.point for i, one in enumerate(arrays, start=1)}, **PAYLOAD}
    nodes |= {one.name: one.point for one in (*arrays, *others)}
    points = () if tables["body"].get("modal_data") else frame_points(tables["body"]["ports"])
    return nodes | {point: point for point in points if point not in nodes.values()}


def device_nodes(nodes: Mapping[str, str]) -> dict[str, str]:
    """Nodes where a device may be, by the names of their places and by their own."""
    return {**nodes, **{node: node for node in nodes.values()}}


def frame_points(ports: Iterable[str]) -> tuple[str, ...]:
    """Points of the central body's frame: its own, then those that the parameter file adds."""
    return (*BodyTable.POINTS, *(name for name in ports if name not in BodyTable.POINTS))


def read_source_tables(tables: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Tables of broadband noise and of steppers that make disturbances, each with the name of its wheel or array."""
    wheels, arrays = read_wheels(tables), read_arrays(tables)
    listed = [
        table if isinstance(table, list) else [table] * len(mounted)
        for table, mounted in ((tables[WHEELS], wheels), (tables[ARRAYS], arrays))
    ]
    noisy = [(wheel.name, table.get(BROADBAND)) for wheel, table in zip(wheels, listed[0])]
    of_all = tables["sadm"].get(STEPPER)
    stepping = [
        (one.name, table.get(STEPPER, of_all)) for one, table in zip(arrays, listed[1]) if one.drive is not None
    ]
    return [(name, table) for name, table in (*noisy, *stepping) if table is not None]


def _direction(axis: Sequence[float]) -> FloatArray:
    """Unit vector."""
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def speed_names(count: int) -> tuple[str, ...]:
    """Names of the parameters of so many wheels.

    Examples
    --------
    >>> speed_names(2)
    ('wheel_1.speed', 'wheel_2.speed')
    """
    return tuple(f"wheel_{i}.speed" for i in range(1, count + 1))


def imbalance_port(wheels: int) -> Port:
    """Port of the imbalance of so many wheels."""
    unit = ",".join([ports.IMBALANCE_UNIT] * wheels)
    return Port(WHEEL_IMBALANCE, IMBALANCE_CHANNELS * wheels, unit)


def without_bearings(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with rigid wheels."""
    return _with_each(tables, (WHEELS,), lambda table: _without(table, BEARING))


def without_steppers(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with drives whose gearbox ends at the body, with fixed harmonics."""
    return _with_each(tables, (DRIVES, ARRAYS), lambda table: _without(table, STEPPER))


def without_sources(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables without what only makes disturbances: broadband noise of wheels, torques of steppers."""

    def silent(table: Mapping[str, Any]) -> dict[str, Any]:
        motor = {STEPPER: _without(table[STEPPER], *SOURCE_OF_STEPPER)} if STEPPER in table else {}
        return {**_without(table, BROADBAND), **motor}

    return _with_each(tables, (ARRAYS, WHEELS, DRIVES), silent)


def _with_each(
    tables: Mapping[str, Any], names: Sequence[str], change: Callable[[Mapping[str, Any]], dict[str, Any]]
) -> dict[str, Any]:
    """The tables, those of these names changed, alone or in lists."""
    changed = {name: tables[name] for name in names if name in tables}
    return {**tables, **{k: change(v) if isinstance(v, Mapping) else list(map(change, v)) for k, v in changed.items()}}


def _without(table: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def present(names: Sequence[str], available: Sequence[Port]) -> tuple[str, ...]:
    """Those of some ports that a system has: one without drives has no ``sadm_torque``."""
    have = {port.name for port in available}
    return tuple(name for name in names if name in have)
