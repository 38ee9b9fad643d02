"""Sensors and actuators at places of the structure: tables ``[[sensor]]`` and ``[[actuator]]``.

The stored controllers measure with the sensors of :mod:`titop_plant.sensors` and act with mirror and proof-mass
actuators. A sensor at a place is recorded, and read by a controller of the user that names it; an actuator at a place
is driven by a source of disturbance or by such a controller. A proof-mass actuator loads
the structure with its mass, its spring and its damper; a force and a torque act from outside, as those of a thruster or
of the motor of a wheel, whose speed follows its profile. The reference telescope has none of them.

A sensor at ``r`` from its point P measures along a unit vector n::

    accelerometer            n . (a_P + alpha_P x r)      [m/s2]
    angular_accelerometer    n . alpha_P                  [rad/s2]
    rate_gyro                n . omega                    [rad/s], of the bus
    star_tracker             n . theta                    [rad], of the bus
    line_of_sight            both axes of the controlled line of sight [rad]

**n and r are in the axes of the body; a value is positive along n.** With its scale error s, bias b, random walk w of
the bias and noise v, a sample is ``round(clip((1 + s) value + b + w + v))``; between its samples there is none.
Neglected: the mass of a sensor, the centripetal acceleration, which is of second order. The random walk is in runs, in
no prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from pointing_analysis.files.settings import (
    ANY,
    POSITIVE,
    STRICT,
    CheckedTable,
    Excluded,
    Refused,
    setting,
    settings_class,
)
from titop_plant.sensors import TICKS_PER_SECOND, Sensor, SensorMount, divided_ticks
from titop_plant.telescope.actuators import Actuator, ActuatorMount
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.sections import Matrix, OscillatorTable, Vector, refuse_other_rates

SENSOR, ACTUATOR = "sensor", "actuator"
"""Tables of a parameter file."""


class SensorKind(NamedTuple):
    """Unit of a kind of sensor, and the output of the assembled telescope that it measures; empty: an acceleration."""

    unit: str
    source: str = ""


ACCELEROMETER, ANGULAR, LINE_OF_SIGHT = "accelerometer", "angular_accelerometer", "line_of_sight"
SENSOR_KINDS: Mapping[str, SensorKind] = {
    ACCELEROMETER: SensorKind("m/s2"),
    ANGULAR: SensorKind("rad/s2"),
    "rate_gyro": SensorKind("rad/s", "attitude_rate"),
    "star_tracker": SensorKind("rad", "attitude"),
    LINE_OF_SIGHT: SensorKind("rad", "los_controlled"),
}
"""Kinds of sensors."""

PROOF_MASS, FORCE, TORQUE = "proof_mass", "force", "torque"
ACTUATOR_UNITS: Mapping[str, str] = {PROOF_MASS: "N", FORCE: "N", TORQUE: "Nm"}
"""Kinds of actuators, each with its unit: a proof mass that moves along an axis, a force or a torque from outside."""

PROOF_MASSES = "pma"
MECHANICS = tuple(OscillatorTable.SETTINGS)
"""Values of an actuator that are those of ``[pma]`` where its table does not give them."""

UNIT_WITHIN = 1e-3
"""Of the length of an axis from 1; it is brought to 1."""


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class DeviceTable(CheckedTable):
    """A sensor or an actuator at a place."""

    name: str = setting(..., "name")
    place: str = setting("", "point of the structure", absent="the bus")
    position: Vector | None = setting(None, "from the point", "m", length=3, absent="the point")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensorTable(DeviceTable):
    """A sensor; its standard deviations are those of a sample."""

    kind: str = setting(ACCELEROMETER, "kind", choices=tuple(SENSOR_KINDS))
    axes: Matrix | None = setting(None, "unit vectors along which it measures", length=(ANY, 3), absent="x, y, z")
    rate: float = setting(float(TICKS_PER_SECOND), "samples per second", "Hz", 1.0)
    noise: float | None = setting(None, "noise", "", 0.0, absent="that of [sensors], or 0")
    bias: float = setting(0.0, "bias")
    random_walk: float = setting(0.0, "random walk of the bias, over the root of a second", "", 0.0)
    scale: float = setting(0.0, "relative error of its scale", "", Excluded(-1.0))
    step: float = setting(0.0, "quantisation; 0: none", "", 0.0)
    range: float | None = setting(None, "largest value", "", POSITIVE, absent="any")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.of_kind.source and self.position is not None:
            raise Refused("position", f"must be absent for a {self.kind}, got {list(self.position)}")
        if self.kind == LINE_OF_SIGHT and self.axes is not None:
            raise Refused("axes", f"must be absent for a {self.kind}, got {list(map(list, self.axes))}")
        if not (self.place or self.of_kind.source):
            raise Refused("", "has no 'place'")
        _refuse_other_vectors("axes", self.axes or ())
        refuse_other_rates("rate", self.rate)

    @property
    def of_kind(self) -> SensorKind:
        """What its kind measures."""
        return SENSOR_KINDS[self.kind]


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ActuatorTable(DeviceTable):
    """An actuator; what a proof mass leaves out is that of ``[pma]``."""

    kind: str = setting(PROOF_MASS, "kind", choices=tuple(ACTUATOR_UNITS))
    axis: Vector = setting(..., "unit vector along which it acts", length=3)
    moving_mass: float | None = setting(None, "moving mass", "kg", POSITIVE)
    casing_mass: float | None = setting(None, "mass of the casing", "kg", POSITIVE)
    inertia: Vector | None = setting(None, "inertia, z along the motion", "kg m2", POSITIVE, length=3)
    stiffness: float | None = setting(None, "stiffness", "N/m", POSITIVE)
    damping: float | None = setting(None, "damping", "N s/m", 0.0)
    authority: float | None = setting(None, "largest force, or torque", "N, Nm", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.place:
            raise Refused("", "has no 'place'")
        _refuse_other_vectors("axis", (self.axis,))
        if self.kind != PROOF_MASS:
            for key in MECHANICS:
                if key != "authority" and (value := getattr(self, key)) is not None:
                    raise Refused(key, f"must be absent for a {self.kind}, got {value}")
            if self.authority is None:
                raise Refused("", "has no 'authority'")


def _refuse_other_vectors(key: str, axes: Sequence[Vector]) -> None:
    """Refuse more than three axes, and those that are no unit vectors."""
    if len(axes) > 3:
        raise Refused(key, f"must be one to three unit vectors, got {len(axes)}")
    for axis in axes:
        length = math.sqrt(sum(entry**2 for entry in axis))
        if abs(length - 1.0) > UNIT_WITHIN:
            raise Refused(key, f"must be a unit vector, got {list(axis)} of length {length:.4g}")


def read_sensors(tables: Mapping[str, Any]) -> tuple[Sensor, ...]:
    """Sensors of the tables ``[[sensor]]``, in their order; accelerometers have the washout of ``[sensors]``."""
    return tuple(_sensor(SensorTable.of_table(table), tables) for table in tables.get(SENSOR, ()))


def read_actuators(tables: Mapping[str, Any]) -> tuple[Actuator, ...]:
    """Actuators of the tables ``[[actuator]]``, in their order."""
    return tuple(_actuator(table, tables[PROOF_MASSES]) for table in tables.get(ACTUATOR, ()))


def usual_values(table: Mapping[str, Any]) -> tuple[str, ...]:
    """Values of ``[pma]`` that an actuator takes: those that its table does not give, and the authority as a scale."""
    known = MECHANICS if table.get("kind", PROOF_MASS) == PROOF_MASS else ()
    return (*(key for key in known if key not in table and key != "authority"), "authority")


def _actuator(values: Mapping[str, Any], usual: Mapping[str, Any]) -> Actuator:
    table = ActuatorTable.of_table(values)
    mechanics = OscillatorTable.of_part({**usual, **values}) if table.kind == PROOF_MASS else None
    authority = float(usual["authority"]) if table.authority is None else table.authority
    mount = ActuatorMount(table.place, _unit(table.axis), _position(table), mechanics, torque=table.kind == TORQUE)
    port = Port(table.name, 1, ACTUATOR_UNITS[table.kind])
    return Actuator(port, authority, authority / float(usual["authority"]), mount)


def _sensor(table: SensorTable, tables: Mapping[str, Any]) -> Sensor:
    kind, angular = table.of_kind, table.kind == ANGULAR
    usual = 0.0 if kind.source else tables["sensors"]["accelerometer_noise"][3 if angular else 0]
    stated = np.eye(3) if table.axes is None else np.array([_unit(axis) for axis in table.axes])
    axes = np.eye(2) if table.kind == LINE_OF_SIGHT else stated
    each, ticks = np.ones(len(axes)), divided_ticks(table.rate, "rate")
    place = table.place or REFERENCE_POINT
    mount = SensorMount(place, axes, _position(table), angular, not kind.source, table.scale)
    return Sensor(
        Port(table.name, len(axes), kind.unit),
        noise=(usual if table.noise is None else table.noise) * each,
        bias=table.bias * each,
        framed=ticks > 1,
        ticks=ticks,
        washout=0.0 if kind.source else float(tables["sensors"]["washout"]),
        step=table.step,
        range=math.inf if table.range is None else table.range,
        random_walk=table.random_walk,
        mount=mount,
        measures=kind.source,
    )


def _unit(axis: Any) -> FloatArray:
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def _position(table: DeviceTable) -> FloatArray:
    return np.array(table.position or (0.0, 0.0, 0.0), dtype=float)
