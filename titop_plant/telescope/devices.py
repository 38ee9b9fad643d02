"""Further sensors and actuators of a parameter file: tables ``[[sensor]]`` and ``[[actuator]]``.

The stored controllers measure with the sensors of :mod:`titop_plant.sensors` and act with mirror and proof-mass
actuators. This module has those besides them: a further sensor is recorded, and read by a controller of the user that
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
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant.sensors import Sensor, SensorMount
from titop_plant.telescope.actuators import Actuator, ActuatorMount
from titop_plant.telescope.sections import OscillatorTable

SENSOR, ACTUATOR = "sensor", "actuator"
"""Tables of a parameter file."""

ACCELEROMETER, ANGULAR = "accelerometer", "angular_accelerometer"
SENSOR_UNITS: Mapping[str, str] = {ACCELEROMETER: "m/s2", ANGULAR: "rad/s2"}
"""Kinds of sensors, each with its unit."""

PLACED_SENSORS, ACTUATOR_FORCE = "placed_sensors", "actuator_force"
"""Output of the telescope with the values of all further sensors; input with the forces of all further actuators."""

PROOF_MASSES = "pma"
MECHANICS = ("moving_mass", "casing_mass", "inertia", "stiffness", "damping", "authority")
"""Values of an actuator that are those of ``[pma]`` where its table does not give them."""


def read_sensors(tables: Mapping[str, Any]) -> tuple[Sensor, ...]:
    """Further sensors of the tables of a parameter file, in its order, behind the washout of the reference's."""
    return tuple(_sensor(table, tables) for table in tables.get(SENSOR, ()))


def read_actuators(tables: Mapping[str, Any]) -> tuple[Actuator, ...]:
    """Further actuators of the tables of a parameter file, in its order."""
    return tuple(_actuator(table, tables[PROOF_MASSES]) for table in tables.get(ACTUATOR, ()))


def usual_values(table: Mapping[str, Any]) -> tuple[str, ...]:
    """Values of ``[pma]`` that an actuator takes: those that its table does not give, and the authority as a scale."""
    return tuple(key for key in MECHANICS if key not in table or key == "authority")


def _actuator(table: Mapping[str, Any], usual: Mapping[str, Any]) -> Actuator:
    mechanics = OscillatorTable.of_part({**usual, **table})
    authority = float(mechanics.authority)
    mount = ActuatorMount(str(table["place"]), _unit(table["axis"]), _position(table), mechanics)
    return Actuator(Port(str(table["name"]), 1, "N"), authority, authority / float(usual["authority"]), mount)


def _sensor(table: Mapping[str, Any], tables: Mapping[str, Any]) -> Sensor:
    kind = str(table.get("kind", ACCELEROMETER))
    usual = tables["sensors"]["accelerometer_noise"][3 if kind == ANGULAR else 0]
    axes = np.array([_unit(axis) for axis in table.get("axes", np.eye(3))])
    each = np.ones(len(axes))
    return Sensor(
        Port(str(table["name"]), len(axes), SENSOR_UNITS[kind]),
        noise=float(table.get("noise", usual)) * each,
        bias=float(table.get("bias", 0.0)) * each,
        washout=float(tables["sensors"]["washout"]),
        step=float(table.get("step", 0.0)),
        range=float(table.get("range", math.inf)),
        mount=SensorMount(str(table["place"]), axes, _position(table), angular=kind == ANGULAR),
    )


def _unit(axis: Any) -> FloatArray:
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def _position(table: Mapping[str, Any]) -> FloatArray:
    return np.array(table.get("position", [0.0, 0.0, 0.0]), dtype=float)
