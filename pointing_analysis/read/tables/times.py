"""Times of a table: which column has them, and what its numbers mean.

A column of dates (Parquet timestamps, ``datetime64``, ISO 8601 text in CSV) is read as ``datetime64[ns]``, UTC where
it has an offset. The unit of a column of numbers is at the end of its name (``time_ms``, ``t [us]``) or in an attribute
of it. Without one, times that are close to each other are in seconds; others may be milliseconds, and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.read.series import ORIGIN, stamps_of
from pointing_analysis.read.tables.table import Column, split_unit

NAMES = ("t", "time", "timestamp", "stamp", "seconds", "zeit", "temps", "tiempo", "tempo")
"""Names of time columns, without a unit at their end, in any case."""
UNITS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
FARTHEST = 0.05
"""Usual step of numbers without a unit from which on they may be other than seconds: of 20 kHz in milliseconds."""
CLOSEST = 1.2e-5
"""Usual step of numbers without a unit below which they may be other than seconds: of 1 Hz in days."""
FEWEST = 0.5
"""Part of the times that must differ: fewer have lost their digits."""
_DATE = re.compile(r"\s*(\d{4}-(?:\d\d-\d\d|\d{3}))[T ](\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)\s*(Z|[+-]\d\d:?\d\d)?\s*")
"""ISO 8601, or day of the year as CCSDS writes it, with a time of day."""


def dates(cells: Sequence[str]) -> NDArray[np.datetime64]:
    """Times from ISO 8601 text, also with the day of the year; an offset from UTC is subtracted.

    Raises
    ------
    ValueError
        A cell that is no date with a time of day.

    Examples
    --------
    >>> dates(["2026-11-20T12:00:00.001953125+01:00"])
    array(['2026-11-20T11:00:00.001953125'], dtype='datetime64[ns]')
    >>> dates(["2026-324T11:00:00Z"])
    array(['2026-11-20T11:00:00.000000000'], dtype='datetime64[ns]')
    """
    found = [_DATE.fullmatch(cell) for cell in cells]
    if not cells or any(match is None for match in found):
        raise ValueError("cells must be dates with a time of day")
    matches = [match for match in found if match is not None]
    moments = np.array([f"{_day(match[1])}T{match[2]}" for match in matches], "datetime64[ns]")
    return np.asarray(moments - np.array([_offset(match[3]) for match in matches], "timedelta64[m]"))


def _day(text: str) -> str:
    """Year, month and day; also from the day of the year."""
    year, _, rest = text.partition("-")
    if len(rest) != 3:
        return text
    number, first = int(rest), np.datetime64(f"{year}-01-01", "D")
    day = first + np.timedelta64(number - 1, "D")
    if not number or str(day)[:4] != year:
        raise ValueError("cells must be dates with a time of day")
    return str(day)


def _offset(text: str | None) -> int:
    """Minutes by which a local time is ahead of UTC."""
    if text is None or text == "Z":
        return 0
    return int(text[0] + "1") * (60 * int(text[1:3]) + int(text[-2:]))


def time_column(columns: Mapping[str, Column], los: Sequence[str]) -> str | None:
    """Name of the column that has the times, or None.

    The only dates, else a usual name, else the only column with a unit of time, else the first of three.

    Parameters
    ----------
    columns : of the table, by name
    los : names of the columns of the line of sight, empty if they were not named
    """
    rest = [name for name in columns if name not in los]
    of_dates = [name for name in rest if columns[name].dtype.kind == "M"]
    if len(of_dates) == 1:
        return of_dates[0]
    usual = {split_unit(name)[0].rpartition(".")[2].lower(): name for name in reversed(rest)}
    for name in NAMES:
        if name in usual:
            return usual[name]
    of_time = [name for name in rest if split_unit(name)[1] in UNITS and split_unit(name)[1]]
    if len(of_time) == 1:
        return of_time[0]
    if len(columns) != 3 or not rest or rest[0] != next(iter(columns)):
        return None
    return rest[0] if not los or np.mean(np.diff(columns[rest[0]].astype(float)) > 0) > 0.9 else None


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
    missing = int(np.isnat(column).sum()) if column.dtype.kind == "M" else int((~np.isfinite(column)).sum())
    if missing:
        raise ValueError(f"time must be given for every row, got {missing} missing in column {name}")
    if column.dtype.kind == "M":
        whole = column.astype("datetime64[ns]").astype(np.int64)
    elif unit not in UNITS:
        raise ValueError(f"unit of the time must be one of {', '.join(u for u in UNITS if u)}, got {unit!r} of {name}")
    elif unit == "ns":
        whole = column.astype(np.int64) if column.dtype.kind in "iu" else np.rint(column.astype(float)).astype(np.int64)
    else:
        if not unit and rate is None and split_unit(name)[0].rpartition(".")[2].lower() != "seconds":
            _check_seconds(name, column.astype(float))
        return stamps_of(column.astype(float) * UNITS[unit], len(column), rate)
    return np.asarray((whole - whole.min() if whole.size else whole) + ORIGIN)


def _check_seconds(name: str, times: FloatArray) -> None:
    """Refuse numbers without a unit that may be milliseconds, or days, as well."""
    step = float(np.median(np.diff(np.sort(times)))) if times.size > 1 else 0.0
    if 0.0 < step < CLOSEST:
        raise ValueError(
            f"unit of the times must be known where they are {step:.3g} apart, as days are: {name} (d) or {name} (s) "
            f"as the name of the column, or --time {name}_d, --time {name}_s; got {name!r} without one"
        )
    if step >= FARTHEST * (1 - 1e-9):
        raise ValueError(
            f"unit of the times must be known where they are {step:g} apart: {name} (s), {name} (ms) or the like as "
            f"the name of the column, or --time {name}_s, --time {name}_ms; got {name!r} without one"
        )
