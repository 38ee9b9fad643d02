"""Times of a table: which column has them, and what its numbers mean.

A column of dates (Parquet timestamps, ``datetime64``, text of `pointing_analysis.read.tables.dates`) is read as
``datetime64[ns]``, UTC where it has an offset. The unit of a column of numbers is at the end of its name (``time_ms``,
``t [us]``) or in an attribute of it. Without one, times that are close to each other are in seconds; others may be
milliseconds, and are refused. Sample numbers (``sample``, ``index``) are times with the sampling rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import IntArray
from pointing_analysis.read.series import ORIGIN, stamps_of
from pointing_analysis.read.tables.dates import DATES
from pointing_analysis.read.tables.table import Column, Table, split_unit

NAMES = ("t", "time", "timestamp", "stamp", "seconds", "zeit", "temps", "tiempo", "tempo", "x_value")
"""Names of time columns, without a unit at their end, in any case."""
OF_DATES = ("date", "datetime", "date_time", "utc")
"""Names of columns of dates, which are known by their cells where those can be read."""
SAMPLE_NUMBERS = ("sample", "samples", "sample number", "sample_number", "index", "idx", "n", "k", "frame")
"""Names of columns of sample numbers, in any case."""
WEEKS = ("week", "gps week", "gps_week", "gpsweek", "wn")
"""Names of columns of GPS weeks, which belong to the times of week (``tow``)."""
TIMES_OF_WEEK = ("tow", "gps tow", "gps_tow", "time of week", "time_of_week")
UNITS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
FARTHEST = 0.05
"""Usual step of numbers without a unit from which on they may be other than seconds: of 20 kHz in milliseconds."""
CLOSEST = 1.2e-5
"""Usual step of numbers without a unit below which they may be other than seconds: of 1 Hz in days."""
FEWEST = 0.5
"""Part of the times that must differ: fewer have lost their digits."""


def time_column(columns: Mapping[str, Column], los: Sequence[str]) -> str | None:
    """Name of the column that has the times, or None.

    The only dates, else a usual name, else the only column with a unit of time, else the first of three.

    Parameters
    ----------
    columns : of the table, by name
    los : names of the columns of the line of sight, empty if they were not named
    """
    rest = [name for name in columns if name not in los]
    group = los[0].rpartition(".")[0] if los else ""
    rest.sort(key=lambda name: name.rpartition(".")[0] != group)  # of several times those beside the line of sight
    of_dates = [name for name in rest if columns[name].dtype.kind == "M"]
    if len(of_dates) == 1:
        return of_dates[0]
    usual = {_base(name): name for name in reversed(rest)}
    for name in (*NAMES, *TIMES_OF_WEEK):
        if name in usual:
            return usual[name]
    of_time = [name for name in rest if split_unit(name)[1] in UNITS and split_unit(name)[1]]
    if len(of_time) == 1:
        return of_time[0]
    if len(columns) != 3 or not rest or rest[0] != next(iter(columns)):
        return None
    return rest[0] if not los or np.mean(np.diff(columns[rest[0]].astype(float)) > 0) > 0.9 else None


def refuse_text_times(table: Table) -> None:
    """Refuse a column with the name of a time that was left out because of its cells."""
    for name in table.texts:
        if _base(name) in (*NAMES, *OF_DATES):
            table.refuse_text(name, f"a number or {DATES}")


def column_stamps(name: str, column: Column, rate: float | None, unit: str = "") -> IntArray:
    """Stamps [ns] from a time column.

    Whole nanoseconds are taken as they are; other times go through `pointing_analysis.read.series.stamps_of`.

    Parameters
    ----------
    name : of the column, for messages
    column : (n,) numbers or dates
    rate : sampling rate [Hz], if it is known
    unit : of the numbers; by default s, where they can be nothing else

    Raises
    ------
    ValueError
        A time that is missing or not finite, another unit, or none where it must be known.
    """
    missing = np.flatnonzero(np.isnat(column) if column.dtype.kind == "M" else ~np.isfinite(column))
    if missing.size:
        which = f"the first in sample {missing[0] + 1}"
        raise InputError(f"time must be given for every row, got {missing.size} missing in column {name}, {which}")
    if column.dtype.kind == "M":
        whole = column.astype("datetime64[ns]").astype(np.int64)
    elif unit not in UNITS:
        raise InputError(f"unit of the time must be one of {', '.join(u for u in UNITS if u)}, got {unit!r} of {name}")
    elif not unit and rate is not None and _are_sample_numbers(name, column):
        return stamps_of((column.astype(float) - float(column.min())) / rate, len(column), rate)
    elif unit == "ns":
        whole = column.astype(np.int64) if column.dtype.kind in "iu" else np.rint(column.astype(float)).astype(np.int64)
    else:
        if not unit and rate is None and _base(name) != "seconds":
            # Refuse numbers without a unit that may be milliseconds, or days, as well
            times = column.astype(float)
            step = float(np.median(np.diff(np.sort(times)))) if times.size > 1 else 0.0
            if _are_sample_numbers(name, times):
                raise InputError(
                    f"rate must be given where the times are sample numbers (--rate HERTZ), got none for {name}"
                )
            if 0.0 < step < CLOSEST:
                raise InputError(
                    f"unit of the times must be known where they are {step:.3g} apart, as days are: {name} (d) or "
                    f"{name} (s) as the name of the column, or --time {name}_d, --time {name}_s; got {name!r} "
                    "without one"
                )
            if step >= FARTHEST * (1 - 1e-9):
                raise InputError(
                    f"unit of the times must be known where they are {step:g} apart: {name} (s), {name} (ms) or the "
                    f"like as the name of the column, or --time {name}_s, --time {name}_ms; got {name!r} without one"
                )
        return stamps_of(column.astype(float) * UNITS[unit], len(column), rate)
    return np.asarray((whole - whole.min() if whole.size else whole) + ORIGIN)


def _base(name: str) -> str:
    """Name of a column without its unit and its group, in small letters."""
    return split_unit(name)[0].rpartition(".")[2].lower()


def _are_sample_numbers(name: str, column: Column) -> bool:
    return _base(name) in SAMPLE_NUMBERS and bool((column == np.rint(column.astype(float))).all())


def since_first_week(name: str, columns: Mapping[str, Column], unit: str) -> Column:
    """Times of week with the GPS weeks of the rows, from the first week on; any other column as it is.

    Examples
    --------
    >>> columns = {"week": np.array([2392, 2393]), "tow": np.array([604_799.5, 0.0])}
    >>> since_first_week("tow", columns, "")
    array([604799.5, 604800. ])
    """
    column = columns[name]
    weeks = [other for other in columns if _base(other) in WEEKS and columns[other].dtype.kind in "fiu"]
    if _base(name) not in TIMES_OF_WEEK or len(weeks) != 1 or column.dtype.kind not in "fiu":
        return column
    since = columns[weeks[0]].astype(float) - float(columns[weeks[0]].min())
    return np.asarray(column.astype(float) + since * (7 * UNITS["d"] / UNITS.get(unit, 1.0)))
