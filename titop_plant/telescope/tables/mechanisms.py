"""Checks of the optional tables of wheels and array drives: bearings, broadband noise, stepper motors.

==============================  =====================================================================================
``[reaction_wheel.bearing]``    of all wheels, or ``bearing`` in a ``[[reaction_wheel]]``; values of `WheelBearing`
``[reaction_wheel.broadband]``  of all wheels, or ``broadband`` in one: ``frequency`` [Hz] and one-sided densities
                                `DENSITIES` on the mount [N^2/Hz, Nm^2/Hz], interpolated on logarithmic axes
``[sadm.stepper]``              of all drives, or ``stepper`` in a ``[[solar_array]]``; values of `Stepper`
==============================  =====================================================================================

Each one is absent in the reference telescope. Bearings and rotors are in the plant and in the name of its parameters;
broadband noise and the torques of a stepper are sources, on which no design depends.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from titop_plant.blocks.stepper import Stepper
from titop_plant.blocks.wheel_bearing import WheelBearing
from titop_plant.telescope.layout import (
    ARRAYS,
    BEARING,
    BROADBAND,
    DENSITIES,
    GEAR_ERRORS,
    STEPPER,
    WHEELS,
    read_stepper,
)
from titop_plant.telescope.tables.parameter_check import ParameterFile

Table = dict[str, Any]

DRIVES = "sadm"
OF_TABLES: Mapping[str, tuple[str, ...]] = {WHEELS: (BEARING, BROADBAND), DRIVES: (STEPPER,)}
"""Tables inside of those of the reference file."""

WHOLE = ("full_steps", "micro_steps")


def take_mechanisms(own: Table) -> dict[str, Table]:
    """Take the tables of `OF_TABLES` out of a user's file, by the name of the table that they are in."""
    found: dict[str, Table] = {}
    for outer, names in OF_TABLES.items():
        if isinstance(own.get(outer), dict):
            found[outer] = {name: own[outer].pop(name) for name in names if name in own[outer]}
    return found


def with_mechanisms(whole: Mapping[str, Any], taken: Mapping[str, Table], file: ParameterFile) -> Table:
    """The tables that get what was taken out of them, checked.

    Parameters
    ----------
    whole : mapping
        The other tables of the file, complete.
    taken : mapping
        Of `take_mechanisms`.
    file : ParameterFile
        For the messages.

    Raises
    ------
    ValueError
        An unknown or missing key, a value out of its range, a rotor that is more than its wheel.
    """
    made: Table = {}
    for outer, tables in taken.items():
        if tables:
            made[outer] = {**whole[outer], **tables}
            check_mechanisms(outer, made[outer], file)
    return made


def check_mechanisms(name: str, table: Mapping[str, Any], file: ParameterFile) -> None:
    """Check the optional tables in that of a wheel, of an array or of all of them; `name` is for the messages."""
    for key, check in ((BEARING, _bearing), (BROADBAND, _broadband), (STEPPER, _stepper)):
        if key in table:
            where = f"{name}.{key}"
            if not isinstance(table[key], dict):
                raise file.error(where, f"must be a table, got {table[key]!r}")
            check(where, table[key], table, file)


def _bearing(where: str, bearing: Table, wheel: Mapping[str, Any], file: ParameterFile) -> None:
    _keys(where, bearing, WheelBearing, file)
    for key, value in bearing.items():
        _number(f"{where}.{key}", value, file)
    try:
        WheelBearing(**bearing)
    except ValueError as error:
        raise file.error(where, f"is not a valid bearing: {error}") from None
    for key, of_wheel in (("rotor_mass", "mass"), ("rotor_radial_inertia", "radial_inertia")):
        if bearing[key] > wheel[of_wheel]:
            raise file.error(
                f"{where}.{key}", f"must be at most {wheel[of_wheel]:g} of the wheel, got {bearing[key]:g}"
            )


def _stepper(where: str, stepper: Table, drive: Mapping[str, Any], file: ParameterFile) -> None:
    _keys(where, stepper, Stepper, file)
    for key, value in stepper.items():
        if key == GEAR_ERRORS:
            if not isinstance(value, list) or not all(isinstance(row, list) and len(row) == 2 for row in value):
                raise file.error(f"{where}.{key}", f"must be a list of [cycles, angle], got {value!r}")
            for row in value:
                for entry in row:
                    _number(f"{where}.{key}", entry, file)
        else:
            _number(f"{where}.{key}", value, file)
        if key in WHOLE and not isinstance(value, int):
            raise file.error(f"{where}.{key}", f"must be a whole number, got {value!r}")
    try:
        read_stepper(stepper)
    except ValueError as error:
        raise file.error(where, f"is not a valid stepper: {error}") from None
    if not drive.get("gearbox_stiffness", 1.0) > 0.0:
        raise file.error(where, "needs a gearbox_stiffness above zero, got 0")


def _broadband(where: str, table: Table, wheel: Mapping[str, Any], file: ParameterFile) -> None:
    known = ("frequency", *DENSITIES)
    for key, value in table.items():
        if key not in known:
            raise file.error(f"{where}.{key}", f"expected one of: {', '.join(known)}")
        if not isinstance(value, list):
            raise file.error(f"{where}.{key}", f"must be a list, got {value!r}")
        for entry in value:
            _number(f"{where}.{key}", entry, file)
    frequency = table.get("frequency", [])
    if len(frequency) < 2 or not frequency[0] > 0.0 or any(b <= a for a, b in itertools.pairwise(frequency)):
        raise file.error(
            f"{where}.frequency", f"must be two or more increasing frequencies above 0 Hz, got {frequency}"
        )
    given = [key for key in DENSITIES if key in table]
    if not given:
        raise file.error(where, f"must have a density, one of {', '.join(DENSITIES)}, got none")
    for key in given:
        if len(table[key]) != len(frequency) or not min(table[key]) >= 0.0:
            raise file.error(f"{where}.{key}", f"must be {len(frequency)} numbers from 0, got {table[key]}")


def _keys(where: str, table: Table, kind: Any, file: ParameterFile) -> None:
    """Refuse an unknown key, and a table without a value that has no default."""
    known = {field.name: field.default is MISSING for field in fields(kind)}
    for key in table:
        if key not in known:
            raise file.error(f"{where}.{key}", f"expected one of: {', '.join(known)}")
    for key, needed in known.items():
        if needed and key not in table:
            raise file.error(where, f"has no {key!r}")


def _number(where: str, value: Any, file: ParameterFile) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise file.error(where, f"must be a number, got {value!r}")


OF_LISTS: Mapping[str, tuple[str, ...]] = {WHEELS: (BEARING, BROADBAND), ARRAYS: (STEPPER,)}
"""Tables that an entry of a list may have."""
