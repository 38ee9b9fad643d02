"""Line of sight in a table of any format.

Columns are chosen by name (``x,y``, or ``los`` for an array of two columns) or, without names, by position: two columns
are the line of sight; of three the first is the time. Times: `pointing_analysis.read.tables.times`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import TABLE
from pointing_analysis.arrays import FloatArray
from pointing_analysis.read.attitude import quaternion_of
from pointing_analysis.read.series import LOS, Provenance, Series, make_series, scale_of, stamps_of
from pointing_analysis.read.tables.arrays import read_numpy, read_parquet
from pointing_analysis.read.tables.dates import DATES
from pointing_analysis.read.tables.formats import Format, format_of
from pointing_analysis.read.tables.matlab import read_hdf5, read_mat
from pointing_analysis.read.tables.table import Column, Table, same_rate, split_unit, unit_name
from pointing_analysis.read.tables.text import read_text
from pointing_analysis.read.tables.times import (
    FEWEST,
    column_stamps,
    refuse_text_times,
    since_first_week,
    time_column,
)
from pointing_analysis.read.tables.times import UNITS as TIME_UNITS
from pointing_analysis.read.topic import NANO
from pointing_analysis.units import ANGLES, NAMES

READERS: Mapping[Format, Callable[[Path], Table]] = MappingProxyType(
    {
        Format.CSV: read_text,
        Format.PARQUET: read_parquet,
        Format.NUMPY: read_numpy,
        Format.MATLAB: read_mat,
        Format.HDF5: read_hdf5,
    }
)
"""Reader of each format but that of bags."""
NO_TIME = "none"
"""Value of the option ``--time`` for samples at a fixed rate, regardless of the columns."""
OTHER_RATE = 1e-3
"""Relative difference up to which a rate stated in the file and that of its time stamps are reported as equal."""
X_NAMES = (("los_x", "los_y"), ("los.x", "los.y"), ("error_x", "error_y"), ("error.x", "error.y"), ("x", "y"))
"""Names of the columns of the line of sight; the first ones that a table has are taken."""


def read_table(path: Path) -> Table:
    """Columns of a file, by its content.

    Raises
    ------
    InputError
        No such file, a bag or no format that is read, or a file that is damaged.
    """
    kind = format_of(path)
    if kind not in READERS:
        raise InputError(f"{path}: file must be a table, got a bag")
    try:
        check_file(path, TABLE)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    table = READERS[kind](path)
    if not table.columns:
        table.refuse_text(next(iter(table.texts), ""))
        raise InputError(f"{path}: table must have numeric columns, got none")
    return table


def read_los_table(
    path: Path, los: str | None = None, *, unit: str | None, rate: float | None = None, time: str | None = None
) -> Series:
    """Line of sight from a table.

    Parameters
    ----------
    path : CSV, Parquet, MATLAB, HDF5 or NumPy file
    los : names or numbers (from 1) of two columns, ``x,y``, or of an array; by default x, y or those that are left
        beside the time
    unit : of the line of sight; by default that of the header or of an attribute
    rate : sampling rate [Hz]; required without a time column and a rate in the file
    time : name of the time column, or ``none`` for samples at the rate; by default
        `pointing_analysis.read.tables.times.time_column`

    Raises
    ------
    InputError
        A file that cannot be read, or columns that are not there.
    ValueError
        Unknown unit, another one than that of the file, or neither times nor a rate.
    """
    try:
        return _series_of(read_table(path), los, unit, rate, time)
    except ValueError as error:
        raise InputError.of_file(path, error) from None


def _series_of(table: Table, los: str | None, unit: str | None, rate: float | None, time: str | None) -> Series:
    (x, y, when), unit_of_time = _chosen(table, los, time)
    columns = table.of_length(len(table.columns[x]))
    few = slice(None, None, max(len(columns[x]) // 1000, 1))
    numbers = {name: column[few].astype(float) for name, column in columns.items() if column.dtype.kind in "fiu"}
    if four := quaternion_of(numbers, (x, y)):
        raise InputError(
            f"{table.path}: los must be two angles, got {x} and {y} of the unit quaternion {', '.join(four)}: its "
            "angles are twice its vector part, relative to the mean attitude"
        )
    xy = np.column_stack([columns[x], columns[y]]).astype(float)
    xy, unit = _in_one_unit(table, xy, (x, y), unit)
    stated_rate, problems = table.rate((x, y)), list(table.left_out)
    unused = _others(table, x, y) if when is None else ""
    if when is not None and (lost := _lost_digits(when, columns[when])):
        if rate is None:
            raise InputError(f"{lost}; --rate HERTZ reads the rows in their order")
        _refuse_other_times(table, when, rate, unit_of_time or table.unit(when))
        when, problems = None, [*problems, f"{lost}: rows read at {rate:g} Hz in their order"]
    if when is None and stated_rate is not None:
        if rate is not None and not same_rate(rate, stated_rate):
            raise InputError(f"rate must be {stated_rate:.9g} Hz, stated in the file for {x}, got {rate:.9g}")
        rate = stated_rate
    stated = "" if when is None else table.unit(when)  # of a whole group the unit is that of the angles
    try:
        if when is None:
            if rate is None:
                refuse_text_times(table)
            stamps = stamps_of(None, len(xy), rate)
        else:
            unit_of_time = unit_of_time if stated in ("", *ANGLES) else stated
            times = since_first_week(when, columns, unit_of_time)
            stamps = column_stamps(when, times, rate, unit_of_time)
    except ValueError as error:
        raise InputError(f"{error}{unused}") from None
    # Refuse fewer than two samples, and two samples of one time that differ: of two records in one file
    count = int(np.isfinite(xy).all(axis=1).sum())
    if count < 2:
        raise InputError(f"{table.path}: line of sight must have two or more rows with both values, got {count}")
    order = np.argsort(stamps, kind="stable")
    same = np.diff(stamps[order]) == 0
    differ = same & ~(xy[order[1:]] == xy[order[:-1]]).all(axis=1)
    if differ.any():
        first = int(order[1:][differ].min())
        since = (int(stamps[first]) - int(stamps.min())) / NANO
        raise InputError(
            f"{table.path}: times must differ from row to row, got {int(differ.sum())} with the time of another row, "
            f"the first in sample {first + 1}, {since:g} s after the earliest one (two records in one file? too few "
            "digits? --time none --rate HERTZ reads the rows in their order)"
        )
    if unused:
        problems.append(f"no time column: {rate:g} Hz without gaps assumed{unused}")
    about = {"line_of_sight": f"{x}, {y}", "time": when or "none, from the rate", "format": table.kind}
    provenance = Provenance(table.path, table.kind, f"{x}, {y}", parameters=about, problems=problems)
    line_of_sight = make_series(stamps, xy, unit=unit, rate=rate, provenance=provenance)
    return line_of_sight if stated_rate is None else _with_rate_note(line_of_sight, stated_rate)


def _with_rate_note(read: Series, stated: float) -> Series:
    """A note if the time stamps have another rate than the file states."""
    by_times = 1.0 / read.topic.period
    if len(read.topic) < 2 or abs(by_times - stated) <= OTHER_RATE * by_times:
        return read
    note = f"the file states {stated:.6g} Hz for {read.label}, its time stamps {by_times:.6g} Hz: the stamps are used"
    return replace(read, problems=(*read.problems, note))


def _others(table: Table, x: str, y: str) -> str:
    """Columns that could be the times of the line of sight, or that would be with as many rows."""
    columns = table.of_length(rows := len(table.columns[x]))
    rest = [name for name in columns if name not in (x, y)]
    if rest:
        return f" (others, for --time: {', '.join(rest)})"
    other = time_column({name: column for name, column in table.columns.items() if name not in columns}, [])
    return f" ({other} has {len(table.columns[other])} rows, {x} {rows})" if other else ""


def _in_one_unit(table: Table, xy: FloatArray, names: tuple[str, str], asked: str | None) -> tuple[FloatArray, str]:
    """Samples in one unit, and that unit: the given one, or that of the file."""
    stated = [table.unit(name) for name in names]
    for name, unit in zip(names, stated):
        if unit and unit not in ANGLES:
            raise InputError(f"{table.path}: unit of {name} must be an angle, {NAMES}, got {unit!r} in the file")
    if asked is not None:
        asked = unit_name(asked)
        for name, unit in zip(names, stated):
            if unit and unit != asked:
                raise InputError(f"{table.path}: unit must be {unit}, stated in the file for {name}, got {asked!r}")
        scale_of(asked)
        return xy, asked
    if not all(stated):
        name = names[0] if not stated[0] else names[1]
        missing = f"which the file does not state for {name}, got none"
        raise InputError(f"{table.path}: unit must be given (--unit {NAMES}), {missing}")
    scales = [scale_of(unit) for unit in stated]
    return (xy, stated[0]) if stated[0] == stated[1] else (xy * np.array(scales), "rad")


def _chosen(table: Table, los: str | None, time: str | None) -> tuple[tuple[str, str, str | None], str]:
    """Names of the columns of the line of sight and of the time, and the unit that the option gives the time."""
    if time == NO_TIME and table.find(time) is None:
        x, y, _ = _columns(table, los, None)
        return (x, y, None), ""
    asked, unit = (None, "") if time is None else _asked_time(table, time)
    return _columns(table, los, asked), unit


def _lost_digits(name: str, column: Column) -> str:
    """Error of time stamps that are mostly equal; empty if they differ."""
    count, different = len(column), len(np.unique(column))
    if count < 3 or different >= FEWEST * count:
        return ""
    return (
        f"times must differ from row to row, got {different} different ones in {count} rows of {name}: too few digits"
    )


def _refuse_other_times(table: Table, when: str, rate: float, unit: str) -> None:
    """Refuse rows of a rate that do not fill the time between equal time stamps, or all of it."""
    column = table.columns[when]
    if column.dtype.kind not in "fiu":
        return
    times, first = np.unique(column.astype(float), return_index=True)
    rows, steps = np.diff(first), np.diff(times) * TIME_UNITS.get(unit, 1.0)
    if len(steps) < 3 or (rows <= 0).any():
        return  # out of order
    digit, span, count = float(np.median(steps)), float(steps.sum()), int(rows.sum())
    ratio = float(np.median(steps / rows)) * rate
    if not unit and not 1.0 / 30.0 < ratio < 30.0:
        return  # in another unit
    left = steps - rows / rate
    longest = int(np.argmax(left))
    must = f"rows of {when} must follow each other at {rate:g} Hz"
    anyway = "(--time none reads them all the same)"
    if 0.9 < ratio < 1.1 and left[longest] > 0.5 * digit:
        raise InputError(
            f"{table.path}: {must}, got {left[longest]:.4g} s without rows after row {first[longest + 1]} {anyway}"
        )
    if abs(span - count / rate) > max(1.5 * digit, OTHER_RATE * span):
        raise InputError(f"{table.path}: {must}, got {count} rows in {span:.6g} s {anyway}")


def _asked_time(table: Table, time: str) -> tuple[str, str]:
    """Column that an option ``--time`` means; a unit at its end, as in ``time_ms``, is that of a column without one."""
    base, unit = split_unit(time)
    if not unit:  # time_d is a name with a unit, mjd_d may be one without
        base, _, unit = time.rpartition("_")
    asked = table.find(time)
    if asked is None and unit in TIME_UNITS and (asked := table.find(base)) is not None:
        if (stated := table.unit(asked)) not in ("", *ANGLES, unit):
            raise InputError(f"{table.path}: time must be in {stated}, stated in the file for {asked}, got {time!r}")
        return asked, unit
    if asked is None and time.isdecimal() and 0 < int(time) <= len(every := table.names or tuple(table.columns)):
        asked = every[int(time) - 1]
    table.refuse_text(time if asked is None else asked, f"a number or {DATES}")
    if asked is None:
        raise InputError(f"{table.path}: time must be one of {table.listed()}, got {time!r}")
    return asked, ""


def _columns(table: Table, los: str | None, asked: str | None) -> tuple[str, str, str | None]:
    """Names of the columns of the line of sight, by default of the true one of an exported bag, and of the time."""
    if los is None and _of_topic(table, LOS) is not None:
        los = LOS
    if los is not None:
        x, y = _named(table, los)
        columns = table.of_length(len(table.columns[x]))
        return _time_first(columns, x, y, asked or time_column(columns, [x, y]))
    lengths = dict.fromkeys(len(column) for column in table.columns.values())
    possible = [chosen for n in lengths if (chosen := _by_names(table.of_length(n), asked)) is not None]
    if possible and _known_pair(possible[0][:2]) and _known_pair(list(table.columns)) is None:
        possible = []  # one of several of the same name: the others are of another length
    if len(possible) != 1 or not set(possible[0]) & set(_known_pair(list(table.columns)) or ()):
        # Columns of the line of sight, by unit or name, that were left out because of their cells
        usual = {name for pair in X_NAMES for name in pair}
        for name in table.texts:
            base, unit = split_unit(name)
            if unit in ANGLES or base.lower() in usual:
                table.refuse_text(name)
    if len(possible) != 1:
        others = f" ({'; '.join(table.left_out)})" if table.left_out else ""
        raise InputError(
            f"{table.path}: los must name two of the columns {table.listed()} (--los X,Y), got none{others}"
        )
    return possible[0]


def _of_topic(table: Table, name: str) -> str | None:
    """First part of the names of an array's columns, or of a topic's in a file that ``bag export`` wrote."""
    starts = f"{name} ", f"{name}.", f"{name.replace('/', '_')}.values."
    return next((start for start in starts if table.find(f"{start}x")), None)


def _named(table: Table, los: str) -> tuple[str, str]:
    parts = [part.strip() for part in los.split(",")]
    for part in parts:
        table.refuse_text(part)
    if len(parts) == 1:
        start = _of_topic(table, parts[0]) or f"{parts[0]}."
        parts = [f"{start}x", f"{start}y"]
    names, every = [table.find(part) for part in parts], table.names or tuple(table.columns)
    if all(name is None and part.isdecimal() and 0 < int(part) <= len(every) for name, part in zip(names, parts)):
        names = [every[int(part) - 1] for part in parts]
        if texts := [name for name in names if name not in table.columns]:
            raise InputError(f"{table.path}: los must be two columns of numbers, got {', '.join(map(str, texts))}")
    if len(names) != 2 or names[0] is None or names[1] is None:
        raise InputError(f"{table.path}: los must be two of the columns {table.listed()}, got {los!r}")
    if names[0] == names[1]:
        raise InputError(f"{table.path}: los must be two different columns, got {los!r}")
    if len(table.columns[names[0]]) != len(table.columns[names[1]]):
        raise InputError(f"{table.path}: los must be two columns of equal length, got {los!r}")
    return names[0], names[1]


def _by_names(columns: Mapping[str, Column], asked: str | None) -> tuple[str, str, str | None] | None:
    """The line of sight among columns of one length: a usual pair of names, or the two that are left."""
    pair = _known_pair(list(columns))
    when = asked if asked in columns else time_column(columns, list(pair or ()))
    rest = [name for name in columns if name != when and columns[name].dtype.kind != "M"]
    pair = _known_pair(rest) or ((rest[0], rest[1]) if len(rest) == 2 else None)
    return None if pair is None else _time_first(columns, *pair, when)


def _time_first(columns: Mapping[str, Column], x: str, y: str, when: str | None) -> tuple[str, str, str | None]:
    """Columns of an array of three whose first one is the time: it grows from row to row, and no other has times."""
    z = f"{x.rpartition('.')[0]}.z"
    if when in (None, z) and x.endswith(".x") and y == f"{z[:-1]}y" and z in columns and columns[x].dtype.kind in "fiu":
        steps = np.diff(columns[x].astype(float))
        if steps.size > 1 and (steps > 0).all() and np.ptp(steps) < steps.mean():
            return y, z, x
    return x, y, when


def _known_pair(names: Sequence[str]) -> tuple[str, str] | None:
    bases = {name: split_unit(name)[0].lower() for name in names}

    def named(wanted: str) -> list[str]:
        return [name for name, base in bases.items() if base == wanted or base.endswith((f".{wanted}", f" {wanted}"))]

    for pair in X_NAMES:
        x, y = map(named, pair)
        if len(x) == len(y) == 1:
            return x[0], y[0]
    return None
