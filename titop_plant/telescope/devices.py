"""Further sensors and actuators of a parameter file: tables ``[[sensor]]`` and ``[[actuator]]``.

The stored controllers measure with the sensors of :mod:`titop_plant.sensor_table` and act with mirror and proof-mass
actuators. What stands here is beside them: a further sensor is recorded, and read by a controller of the user that
names it; a further actuator loads the structure with its mass, its spring and its damper, and is driven by a source of
disturbance or by such a controller. The reference telescope has none of them.

A sensor at ``r`` from its point P measures along a unit vector n::

    accelerometer            n . (a_P + alpha_P x r)      [m/s2]
    angular_accelerometer    n . alpha_P                  [rad/s2]

**n and r are in the axes of the body; an acceleration is positive along n.** Neglected: the mass of a sensor, the
centripetal acceleration, which is of second order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant.telescope.loop_ports import LoopActuator
from titop_plant.telescope.sections import OscillatorTable, frozen
from titop_plant.telescope.sensors import Sensor

SENSOR, ACTUATOR = "sensor", "actuator"
"""Tables of a parameter file."""

ACCELEROMETER, ANGULAR = "accelerometer", "angular_accelerometer"
SENSOR_UNITS: Mapping[str, str] = {ACCELEROMETER: "m/s2", ANGULAR: "rad/s2"}
"""Kinds of sensors, each with its unit."""

PLACED_SENSORS, ACTUATOR_FORCE = "placed_sensors", "actuator_force"
"""Output of the telescope with the values of all further sensors; input with the forces of all further actuators."""

MECHANICS = ("moving_mass", "casing_mass", "inertia", "stiffness", "damping", "authority")
"""Values of an actuator that are those of ``[pma]`` where its table does not give them."""


@dataclass(frozen=True)
class PlacedSensor:
    """A sensor at a point of the structure.

    Parameters
    ----------
    name, kind, place : str
    axes : ndarray, shape (k, 3)
        Unit vectors along which it measures, one to three, in the axes of the body.
    position : ndarray, shape (3,)
        From the point [m].
    noise, bias, step, range : float
        Standard deviation of a sample at 1 kHz, constant part, quantisation (0: none) and largest value (inf: none),
        each in its unit.
    """

    name: str
    kind: str
    place: str
    axes: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    noise: float
    bias: float
    step: float
    range: float

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return SENSOR_UNITS[self.kind]

    @property
    def port(self) -> Port:
        """Port of its values, an input of a controller."""
        return Port(self.name, len(self.axes), self.unit)

    def in_loop(self, washout: float) -> Sensor:
        """Its row among the sensors of the loop, behind a washout with this corner [rad/s]."""
        size = np.ones(len(self.axes))
        return Sensor(self.port, self.noise * size, self.bias * size, framed=False, washout=washout, low_pass=())

    @property
    def rows(self) -> FloatArray:
        """Its values from the twist of its point, shape (k, 6)."""
        none = np.zeros_like(self.axes)
        if self.kind == ANGULAR:
            return np.hstack([none, self.axes])
        return np.hstack([self.axes, np.cross(self.position, self.axes)])


@dataclass(frozen=True)
class PlacedActuator:
    """A proof-mass actuator at a point of the structure.

    Parameters
    ----------
    name, place : str
    axis : ndarray, shape (3,)
        Unit vector along which its mass moves, in the axes of the body. **A positive force acts on the structure along
        it, and on the mass against it.**
    position : ndarray, shape (3,)
        From the point [m].
    table : OscillatorTable
        Its mechanics.
    """

    name: str
    place: str
    axis: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    table: OscillatorTable = field(repr=False)

    @property
    def port(self) -> Port:
        """Port of its force, an output of a controller."""
        return Port(self.name, 1, "N")

    def in_loop(self, whole: float) -> LoopActuator:
        """Its row among the actuators of the loop, whose forces are over the authority `whole` [N]."""
        return LoopActuator(self.port, self.authority, self.authority / whole)

    @property
    def authority(self) -> float:
        """Largest force [N]."""
        return float(self.table.authority)


def read_sensors(tables: Mapping[str, Any]) -> tuple[PlacedSensor, ...]:
    """Further sensors of the tables of a parameter file, in its order."""
    return tuple(_sensor(table, tables) for table in tables.get(SENSOR, ()))


def read_actuators(tables: Mapping[str, Any]) -> tuple[PlacedActuator, ...]:
    """Further actuators of the tables of a parameter file, in its order."""
    return tuple(
        PlacedActuator(
            str(table["name"]),
            str(table["place"]),
            _unit(table["axis"]),
            _position(table),
            OscillatorTable(**{key: frozen(table.get(key, tables["pma"][key])) for key in MECHANICS}),
        )
        for table in tables.get(ACTUATOR, ())
    )


def _sensor(table: Mapping[str, Any], tables: Mapping[str, Any]) -> PlacedSensor:
    kind = str(table.get("kind", ACCELEROMETER))
    usual = tables["sensors"]["accelerometer_noise"][3 if kind == ANGULAR else 0]
    return PlacedSensor(
        str(table["name"]),
        kind,
        str(table["place"]),
        np.array([_unit(axis) for axis in table.get("axes", np.eye(3))]),
        _position(table),
        noise=float(table.get("noise", usual)),
        bias=float(table.get("bias", 0.0)),
        step=float(table.get("step", 0.0)),
        range=float(table.get("range", math.inf)),
    )


def _unit(axis: Any) -> FloatArray:
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def _position(table: Mapping[str, Any]) -> FloatArray:
    return np.array(table.get("position", [0.0, 0.0, 0.0]), dtype=float)
