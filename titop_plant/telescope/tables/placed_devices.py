"""Checks of the tables ``[[sensor]]`` and ``[[actuator]]`` of a user's file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from titop_plant.interface import COLUMNS
from titop_plant.ports import LOAD
from titop_plant.sensors import TICKS_PER_SECOND
from titop_plant.telescope.devices import (
    ACCELEROMETER,
    ACTUATOR,
    ACTUATOR_UNITS,
    LINE_OF_SIGHT,
    MECHANICS,
    PROOF_MASS,
    SENSOR,
    SENSOR_KINDS,
)
from titop_plant.telescope.layout import device_nodes, read_nodes
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.sections import OscillatorTable
from titop_plant.telescope.tables.parameter_check import ParameterFile

DEVICES = (SENSOR, ACTUATOR)

_PLACE: Mapping[str, Any] = {"name": "", "place": "", "position": [0.0] * 3}
DEVICE_KEYS: Mapping[str, Mapping[str, Any]] = {
    SENSOR: {
        **_PLACE,
        "kind": "",
        "axes": [[0.0] * 3],
        **dict.fromkeys(("rate", "noise", "bias", "random_walk", "scale", "step", "range"), 0.0),
    },
    ACTUATOR: {**_PLACE, "kind": "", "axis": [0.0] * 3, **dict.fromkeys(MECHANICS, 0.0), "inertia": [0.0] * 3},
}
"""Keys of each kind of table, each with a value of the kind that it must have."""

ASSEMBLED = (
    *("external_wrench", "motor_torque", "sadm_angle", "sadm_torque", "wheel_accel", "wheel_imbalance", "wheel_torque"),
    *("accel_G", "angle_G", "rate_G", "wrench_G", "attitude", "attitude_rate", "los", "pma_stroke"),
)
"""Other ports of the assembled telescope (:mod:`titop_plant.telescope.assembly`)."""

UNIT_WITHIN = 1e-3
"""Of the length of an axis from 1; it is brought to 1."""


def check_device_keys(kind: str, name: str, table: Mapping[str, Any], file: ParameterFile) -> None:
    """Refuse values of another kind than those of `DEVICE_KEYS`.

    Raises
    ------
    ValueError
        The message names file, line and key.
    """
    known = DEVICE_KEYS[kind]
    for key, value in table.items():
        like = known[key] * len(value) if key == "axes" and isinstance(value, list) else known[key]
        file.check(f"{name}.{key}", key, like, value)
    with file.refusals(name):
        OscillatorTable.check_given({key: value for key, value in table.items() if key in MECHANICS})


def check_devices(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Refuse places that are none, axes that are no unit vectors, kinds and limits that cannot be.

    Raises
    ------
    ValueError
        The message names file, line and key.
    """
    for kind in DEVICES:
        for i, table in enumerate(whole.get(kind, ())):
            name = f"{kind}[{i}]"
            own, others = str(table.get("name", "")), (*COLUMNS, *ASSEMBLED)  # devices are known by their ports' names
            if own in others or own.startswith(LOAD):
                reserved = f"must not be one of {', '.join(others)}, nor begin with {LOAD}, got {own!r}"
                raise file.error(f"{name}.name", reserved)
            measured = SENSOR_KINDS[_kind(name, table, file)].source if kind == SENSOR else ""
            if not (table.get("place") or measured):
                raise file.error(name, "has no 'place'")
            places = (*([REFERENCE_POINT] if kind == SENSOR else []), *device_nodes(read_nodes(whole)))
            places = places[:1] if measured else places
            if table.get("place", REFERENCE_POINT) not in places:
                raise file.error(f"{name}.place", f"must be one of {', '.join(places)}, got {table['place']!r}")
            if kind == ACTUATOR and "axis" not in table:
                raise file.error(name, "has no 'axis'")
            axes = [table["axis"]] if kind == ACTUATOR else table.get("axes", [])
            if "axes" in table and not 1 <= len(axes) <= 3:
                raise file.error(f"{name}.axes", f"must be one to three unit vectors, got {len(axes)}")
            for axis in axes:
                length = math.sqrt(sum(entry**2 for entry in axis))
                if abs(length - 1.0) > UNIT_WITHIN:
                    key = f"{name}.{'axis' if kind == ACTUATOR else 'axes'}"
                    raise file.error(key, f"must be a unit vector, got {axis} of length {length:.4g}")
            if kind == SENSOR:
                _check_sensor(name, table, file)
            else:
                _check_actuator(name, table, file)


def _check_actuator(name: str, table: Mapping[str, Any], file: ParameterFile) -> None:
    kind = table.get("kind", PROOF_MASS)
    if kind not in ACTUATOR_UNITS:
        raise file.error(f"{name}.kind", f"must be one of {', '.join(ACTUATOR_UNITS)}, got {kind!r}")
    if any(not entry > 0.0 for entry in table.get("inertia", ())):
        raise file.error(f"{name}.inertia", f"must be positive, got {table['inertia']}")
    if kind == PROOF_MASS:
        return
    for key in MECHANICS:
        if key != "authority" and key in table:
            raise file.error(f"{name}.{key}", f"must be absent for a {kind}, got {table[key]}")
    if "authority" not in table:
        raise file.error(name, "has no 'authority'")


def _kind(name: str, table: Mapping[str, Any], file: ParameterFile) -> str:
    kind = str(table.get("kind", ACCELEROMETER))
    if kind not in SENSOR_KINDS:
        raise file.error(f"{name}.kind", f"must be one of {', '.join(SENSOR_KINDS)}, got {kind!r}")
    return kind


def _check_sensor(name: str, table: Mapping[str, Any], file: ParameterFile) -> None:
    kind = _kind(name, table, file)
    if SENSOR_KINDS[kind].source and "position" in table:
        raise file.error(f"{name}.position", f"must be absent for a {kind}, got {table['position']}")
    if kind == LINE_OF_SIGHT and "axes" in table:
        raise file.error(f"{name}.axes", f"must be absent for a {kind}, got {table['axes']}")
    file.check_rate(f"{name}.rate", table.get("rate", TICKS_PER_SECOND))
    if not table.get("scale", 0.0) > -1.0:
        raise file.error(f"{name}.scale", f"must be above -1, got {table['scale']}")
    for key in ("noise", "step", "random_walk"):
        if not table.get(key, 0.0) >= 0.0:
            raise file.error(f"{name}.{key}", f"must not be negative, got {table[key]}")
    if not table.get("range", 1.0) > 0.0:
        raise file.error(f"{name}.range", f"must be positive, got {table['range']}")
