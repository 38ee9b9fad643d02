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
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant.sensors import TICKS_PER_SECOND, Sensor, SensorMount, divided_ticks
from titop_plant.telescope.actuators import Actuator, ActuatorMount
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.sections import OscillatorTable

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
MECHANICS = ("moving_mass", "casing_mass", "inertia", "stiffness", "damping", "authority")
"""Values of an actuator that are those of ``[pma]`` where its table does not give them."""


def read_sensors(tables: Mapping[str, Any]) -> tuple[Sensor, ...]:
    """Sensors of the tables ``[[sensor]]``, in their order; accelerometers have the washout of ``[sensors]``."""
    return tuple(_sensor(table, tables) for table in tables.get(SENSOR, ()))


def read_actuators(tables: Mapping[str, Any]) -> tuple[Actuator, ...]:
    """Actuators of the tables ``[[actuator]]``, in their order."""
    return tuple(_actuator(table, tables[PROOF_MASSES]) for table in tables.get(ACTUATOR, ()))


def usual_values(table: Mapping[str, Any]) -> tuple[str, ...]:
    """Values of ``[pma]`` that an actuator takes: those that its table does not give, and the authority as a scale."""
    known = MECHANICS if table.get("kind", PROOF_MASS) == PROOF_MASS else ()
    return (*(key for key in known if key not in table and key != "authority"), "authority")


def _actuator(table: Mapping[str, Any], usual: Mapping[str, Any]) -> Actuator:
    kind = str(table.get("kind", PROOF_MASS))
    mechanics = OscillatorTable.of_part({**usual, **table}) if kind == PROOF_MASS else None
    authority = float(table.get("authority", usual["authority"]))
    place, axis = str(table["place"]), _unit(table["axis"])
    mount = ActuatorMount(place, axis, _position(table), mechanics, torque=kind == TORQUE)
    port = Port(str(table["name"]), 1, ACTUATOR_UNITS[kind])
    return Actuator(port, authority, authority / float(usual["authority"]), mount)


def _sensor(table: Mapping[str, Any], tables: Mapping[str, Any]) -> Sensor:
    name = str(table.get("kind", ACCELEROMETER))
    kind, angular = SENSOR_KINDS[name], name == ANGULAR
    usual = 0.0 if kind.source else tables["sensors"]["accelerometer_noise"][3 if angular else 0]
    axes = np.eye(2) if name == LINE_OF_SIGHT else np.array([_unit(axis) for axis in table.get("axes", np.eye(3))])
    each, ticks = np.ones(len(axes)), divided_ticks(float(table.get("rate", TICKS_PER_SECOND)), "rate")
    mount = SensorMount(
        str(table.get("place", REFERENCE_POINT)),
        axes,
        _position(table),
        angular,
        not kind.source,
        float(table.get("scale", 0.0)),
    )
    return Sensor(
        Port(str(table["name"]), len(axes), kind.unit),
        noise=float(table.get("noise", usual)) * each,
        bias=float(table.get("bias", 0.0)) * each,
        framed=ticks > 1,
        ticks=ticks,
        washout=0.0 if kind.source else float(tables["sensors"]["washout"]),
        step=float(table.get("step", 0.0)),
        range=float(table.get("range", math.inf)),
        random_walk=float(table.get("random_walk", 0.0)),
        mount=mount,
        measures=kind.source,
    )


def _unit(axis: Any) -> FloatArray:
    vector = np.array(axis, dtype=float)
    return np.asarray(vector / math.sqrt(vector @ vector))


def _position(table: Mapping[str, Any]) -> FloatArray:
    return np.array(table.get("position", [0.0, 0.0, 0.0]), dtype=float)
