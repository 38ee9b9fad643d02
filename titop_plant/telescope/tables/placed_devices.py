"""Checks of the tables ``[[sensor]]`` and ``[[actuator]]`` of a user's file against the rest of the telescope."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from titop_plant.interface import COLUMNS
from titop_plant.ports import LOAD
from titop_plant.telescope.devices import ACCELEROMETER, ACTUATOR, SENSOR, SENSOR_KINDS
from titop_plant.telescope.layout import device_nodes, read_nodes
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.tables.parameter_check import ParameterFile

DEVICES = (SENSOR, ACTUATOR)

ASSEMBLED = (
    *("external_wrench", "motor_torque", "sadm_angle", "sadm_torque", "wheel_accel", "wheel_imbalance", "wheel_torque"),
    *("accel_G", "angle_G", "rate_G", "wrench_G", "attitude", "attitude_rate", "los", "pma_stroke"),
)
"""Other ports of the assembled telescope (:mod:`titop_plant.telescope.assembly`)."""


def check_devices(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Refuse names of other ports, and places that are none.

    Raises
    ------
    ValueError
        The message names file, line and key.
    """
    for kind in DEVICES:
        for i, table in enumerate(whole.get(kind, ())):
            name = f"{kind}[{i}]"
            own, others = str(table["name"]), (*COLUMNS, *ASSEMBLED)  # devices are known by their ports' names
            if own in others or own.startswith(LOAD):
                reserved = f"must not be one of {', '.join(others)}, nor begin with {LOAD}, got {own!r}"
                raise file.error(f"{name}.name", reserved)
            measured = SENSOR_KINDS[table.get("kind", ACCELEROMETER)].source if kind == SENSOR else ""
            places = (*([REFERENCE_POINT] if kind == SENSOR else []), *device_nodes(read_nodes(whole)))
            places = places[:1] if measured else places
            if table.get("place", REFERENCE_POINT) not in places:
                raise file.error(f"{name}.place", f"must be one of {', '.join(places)}, got {table['place']!r}")
