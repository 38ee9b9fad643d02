"""Checks of the layout tables of a user's file: ``[[solar_array]]`` and the like."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg

from pointing_analysis.files.settings import CheckedTable
from titop_plant.structures.kinematics import check_rotation
from titop_plant.structures.modal_file import read_modal_data
from titop_plant.telescope.devices import (
    ACTUATOR,
    PROOF_MASSES,
    SENSOR,
    ActuatorTable,
    SensorTable,
    usual_values,
)
from titop_plant.telescope.layout import APPENDAGES, ARRAYS, DRIVES, WHEELS, read_appendages, read_arrays, read_wheels
from titop_plant.telescope.sections import (
    ArrayTable,
    BodyOnBoardTable,
    Drive,
    PrintedModes,
    TurningTable,
    WheelKind,
    WheelTable,
)
from titop_plant.telescope.tables.parameter_check import REFERENCE_NAME, ParameterFile, without_alternatives
from titop_plant.telescope.tables.placed_devices import DEVICES, check_devices

Table = dict[str, Any]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NUMBERED = re.compile(r"(wheel|array|drive)_\d+")
RESERVED = frozenset(
    {"G", "bus", "body", "wheels", "isolator", "platform", "payload", "fsm", "optics", "steering", "sadm_split"}
    | {"sadm_join", "motor_split", "actuator_split", "sensors", "M1", "M2", "DET", "detector"}
)
"""Names of other bodies and places."""

KINDS: Mapping[str, type[CheckedTable]] = {
    ARRAYS: ArrayTable,
    APPENDAGES: BodyOnBoardTable,
    WHEELS: WheelTable,
    SENSOR: SensorTable,
    ACTUATOR: ActuatorTable,
}
"""Class of each kind of table."""


def _kind(base: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Table of the one kind of array or wheel of the base; empty where it has a list, or none."""
    table = base.get(name)
    return table if isinstance(table, Mapping) else {}


def take_mounted(content: Table) -> dict[str, Any]:
    """Take the lists of what is on board out of a user's file."""
    lists = {name: content[name] for name in (ARRAYS, WHEELS) if isinstance(content.get(name), list)}
    lists |= {name: content[name] for name in (APPENDAGES, *DEVICES) if name in content}
    for name in lists:
        del content[name]
    return lists


def note_unknown_keys(listed: Mapping[str, Any], file: ParameterFile) -> None:
    """Note the keys of the tables of `take_mounted` that are not known, see `ParameterFile.refuse_unknown`."""
    for kind, tables in listed.items():
        for i, table in enumerate(tables if isinstance(tables, list) else ()):
            file.note_unknown(f"{kind}[{i}]", table if isinstance(table, dict) else {}, KINDS[kind].SETTINGS)


def checked_layout(
    listed: Mapping[str, Any], merged: Mapping[str, Any], base: Mapping[str, Any], file: ParameterFile
) -> Table:
    """The lists of a user's file, complete.

    Parameters
    ----------
    listed : mapping
        What `take_mounted` found.
    merged : mapping
        The other tables of the file, merged with the base.
    base : mapping
        Tables of what the file builds on: kind of array and of wheel that entries may take values from.
    file : ParameterFile
        For the messages.

    Raises
    ------
    ValueError
        A key or value that does not fit, a missing one, a name used twice, an unknown point, an array without modes,
        bodies that share parameters of different values, wheels that do not span the space, values of drives where no
        array has one, and of proof-mass actuators where there are none; sensors and actuators as
        :func:`titop_plant.telescope.tables.placed_devices.check_devices`.
    """
    complete: Table = {}
    for kind, tables in listed.items():
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise file.error(kind, f"must be tables [[{kind}]], got {tables!r}")
        complete[kind] = _complete(kind, tables, merged, base, file)
    whole = {**merged, **complete}
    _check_names(whole, file)
    _check_points(whole, file)
    _check_shared(whole, file)
    _check_wheels(whole, file)
    check_devices(whole, file)
    if base:  # a file without one has whole tables
        _check_drives(whole, file)
        _check_proof_masses(whole, file)
    return complete


def _complete(
    kind: str, tables: list[Table], merged: Mapping[str, Any], base: Mapping[str, Any], file: ParameterFile
) -> list[Table]:
    """Tables of one kind with what they leave out."""
    for i, table in enumerate(tables):
        name = f"{kind}[{i}]"
        with file.refusals(name):
            if kind in DEVICES:
                KINDS[kind].of_table(table)
            else:
                KINDS[kind].check_given(table)
        stated = table.get("name")
        if not stated:
            raise file.error(name, "has no 'name'")
        if not _NAME.fullmatch(stated):
            raise file.error(f"{name}.name", f"must be letters, digits and _, a letter first, got {stated!r}")
    if kind in DEVICES:
        return tables
    return _wheels(tables, base, file) if kind == WHEELS else _bodies(kind, tables, merged, base, file)


def _bodies(
    kind: str, tables: list[Table], merged: Mapping[str, Any], base: Mapping[str, Any], file: ParameterFile
) -> list[Table]:
    """Tables of arrays or appendages with what ``like`` names, and files beside the parameter file."""
    by_name: dict[str, Table] = {}
    for i, table in enumerate(tables):
        name = f"{kind}[{i}]"
        if table["name"] in by_name:
            raise file.error(f"{name}.name", f"must be given once, got {table['name']!r} twice")
        if not table.get("point"):
            raise file.error(name, "has no 'point'")
        full = {**_model(kind, name, table, by_name, base, file), **table}
        full.pop("like", None)
        parts: list[type[CheckedTable]] = []
        if not full.get("modal_data"):
            if not (full.get("frequencies") and full.get("participation")):
                needed = "frequencies and participation or a modal_data file"
                raise file.error(name, f"must have modes, {needed}, got none")
            parts.append(PrintedModes)
        if kind == ARRAYS:
            full = {
                **{key: value for key, value in _kind(base, ARRAYS).items() if key in TurningTable.SETTINGS},
                **full,
            }
            parts += [TurningTable, *([Drive] if full.get("driven", True) else [])]
        for part in parts:
            with file.refusals(name):
                part.of_part({**merged[DRIVES], **full})
        if full.get("modal_data") and "modal_data" in table:
            full["modal_data"] = str(Path(file.path).parent / full["modal_data"])
            check_modal_file(name, full, file)
        if "dcm" in full:
            try:
                check_rotation(np.array(full["dcm"], dtype=float), "dcm")
            except ValueError as error:
                raise file.error(f"{name}.dcm", str(error).removeprefix("dcm ")) from None
        by_name[full["name"]] = full
    return list(by_name.values())


def _model(
    kind: str, name: str, table: Table, known: Mapping[str, Table], base: Mapping[str, Any], file: ParameterFile
) -> Table:
    """Values that the body takes from the one it is like."""
    if "like" not in table:
        return {}
    like = table["like"]
    if like in known:
        return {key: value for key, value in known[like].items() if key not in ("name", "parameters")}
    of_base = _kind(base, ARRAYS) if kind == ARRAYS else {}
    choices = [*known, *([REFERENCE_NAME] if of_base else [])]
    if like not in choices:
        raise file.error(f"{name}.like", f"must be one of {', '.join(choices) or 'the bodies before it'}, got {like!r}")
    values = {key: value for key, value in of_base.items() if not key.startswith("dcm_")}
    dcm = of_base.get(f"dcm_{table['point']}")
    return {**values, **({"dcm": dcm} if dcm else {})}


def check_modal_file(name: str, full: Table, file: ParameterFile) -> None:
    """Refuse a table of a body whose modal data file cannot be read.

    Raises
    ------
    ValueError
        With the file and the key.
    """
    try:
        read_modal_data(full["modal_data"])
    except OSError as error:
        raise file.error(
            f"{name}.modal_data", f"must be a readable file, got {full['modal_data']}: {error.strerror}"
        ) from None
    except ValueError as error:
        raise file.error(f"{name}.modal_data", f"must be modal data: {error}") from None


def _wheels(tables: list[Table], base: Mapping[str, Any], file: ParameterFile) -> list[Table]:
    """Tables of wheels; what they leave out is that of the wheels of the base."""
    kind = {key: value for key, value in _kind(base, WHEELS).items() if key in WheelKind.SETTINGS}
    wheels = [without_alternatives({**kind, "position": [0.0, 0.0, 0.0], **table}, table) for table in tables]
    for i, table in enumerate(wheels):
        with file.refusals(f"{WHEELS}[{i}]"):
            WheelTable.of_table(table)
    return wheels


def _check_names(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Each name is given once, and is none of another place."""
    seen: set[str] = set()
    for kind in (ARRAYS, WHEELS, APPENDAGES, ACTUATOR, SENSOR):
        tables = whole.get(kind)
        for i, table in enumerate(tables if isinstance(tables, list) else ()):
            key, name = f"{kind}[{i}].name", str(table["name"])
            if name in seen:
                raise file.error(key, f"must be given once, got {name!r} twice")
            of_place = {ARRAYS: f"array_{i + 1}", WHEELS: f"wheel_{i + 1}"}.get(kind)
            if name in RESERVED or (_NUMBERED.fullmatch(name) and name != of_place):
                raise file.error(key, f"must not be that of another place, got {name!r}")
            seen.add(name)


def _check_points(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Arrays and appendages are at points of the central body; a body from a file is checked when it is built."""
    if whole["body"].get("modal_data"):
        return
    known = list(whole["body"]["ports"])
    for kind, read in ((ARRAYS, read_arrays), (APPENDAGES, read_appendages)):
        for i, one in enumerate(read(whole)):
            if one.point not in known:
                key = f"{kind}[{i}].point" if isinstance(whole[kind], list) else kind
                raise file.error(key, f"must be one of {', '.join(known)}, got {one.point!r}")


def _check_shared(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Bodies with the same parameters have the same values of them."""
    alike = ("modal_data", "frequencies", "relative_uncertainty", "uncertain_modes")
    turning = [(i, array) for i, array in enumerate(read_arrays(whole)) if array.turns]
    for i, one in turning:
        other = turning[0][1]
        if one.theta_range != other.theta_range:
            raise file.error(
                f"{ARRAYS}[{i}].theta_range", f"must be that of {other.name!r}: arrays that turn have one angle"
            )
    first: dict[str, Table] = {}
    for kind in (ARRAYS, APPENDAGES):
        for i, table in enumerate(whole[kind] if isinstance(whole.get(kind), list) else ()):
            shared = str(table.get("parameters", table["name"]))
            if shared.partition("_")[0] == "wheel" or not _NAME.fullmatch(shared):
                raise file.error(f"{kind}[{i}].parameters", f"must be another name, got {shared!r}")
            like = first.setdefault(shared, table)
            for key in alike:
                if table.get(key) != like.get(key):
                    raise file.error(
                        f"{kind}[{i}].{key}",
                        f"must be that of {like['name']!r}, whose parameters it shares, got {table.get(key)!r}",
                    )


def _check_wheels(whole: Mapping[str, Any], file: ParameterFile) -> None:
    table, wheels = whole[WHEELS], read_wheels(whole)
    axes = np.array([wheel.axis for wheel in wheels if wheel.turns])
    rank = 3 - linalg.null_space(axes, rcond=1e-6).shape[1] if len(axes) else 0
    if rank < 3:
        got = f"{len(axes)} wheels with axes of rank {rank}"
        raise file.error(WHEELS, f"must have turning wheels with axes that span the space, got {got}")
    for i, wheel in enumerate(wheels):
        low, high = wheel.speed_range
        if not low <= wheel.default_speed <= high:
            key = f"{WHEELS}.default_speed" if isinstance(table, Mapping) else f"{WHEELS}[{i}].default_speed"
            raise file.error(key, f"must be between {low:g} and {high:g} rad/s, got {wheel.default_speed:g}")


def _check_drives(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Values of all drives act on one at least."""
    stated = [key for key in file.lines if key.startswith(f"{DRIVES}.")]
    if stated and all(array.drive is None for array in read_arrays(whole)):
        raise file.error(stated[0], "must be left out where no solar array is driven")


def _check_proof_masses(whole: Mapping[str, Any], file: ParameterFile) -> None:
    """Values of proof-mass actuators act on those of the platform, or on those ``[[actuator]]`` that state none."""
    if whole[PROOF_MASSES]["azimuths_deg"]:
        return
    used = {"azimuths_deg", *(key for one in whole.get(ACTUATOR, ()) for key in usual_values(one))}
    for key in file.lines:
        table, _, value = key.partition(".")
        if table == PROOF_MASSES and value and value not in used:
            raise file.error(key, "must be left out where no proof-mass actuator uses it (azimuths_deg is empty)")
