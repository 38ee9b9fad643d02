"""Dates with a time of day, as programs write them, as ``datetime64[ns]``.

========================================  ==================================================================
form                                      example
========================================  ==================================================================
ISO 8601, extended and basic              ``2026-11-20T12:00:00.5Z``, ``20261120T120000+01``
day of the year (CCSDS 301.0-B-4)         ``2026-324T12:00:00``, also ``2026:324:12:00:00`` of logs
year first                                ``2026/11/20 12:00:00 UTC``
day first, with points (DIN 5008)         ``20.11.2026 12:00:00,5``
time of day alone, in hours               ``12:00:00.5``; a step back by more than half a day begins the next day
========================================  ==================================================================

Dates with slashes that begin with day or month (``11/10/2026``) have two readings and are no dates here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError

DATES = "a date such as 2026-11-20T12:00:00"
"""What `dates` reads, for messages."""
_ZONE = r"\s*(?P<zone>Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?\s*"
_CLOCK = r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d(?:[.,]\d{1,9})?))?"
_DATE = tuple(
    re.compile(rf"\s*{day}{clock}{_ZONE}")
    for day, clock in (
        (r"(?P<year>\d{4})([-/])(?P<month>\d\d?)\2(?P<day>\d\d?)(?:T|\s+)", _CLOCK),
        (r"(?P<year>\d{4})[-/:](?P<number>\d{3})[T :-]\s*", _CLOCK),
        (r"(?P<day>\d\d?)\.(?P<month>\d\d?)\.(?P<year>\d{4})(?:T|\s+)", _CLOCK),
        (
            r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)T",
            r"(?P<hour>\d\d)(?P<minute>\d\d)(?P<second>\d\d(?:[.,]\d{1,9})?)",
        ),
    )
)
_TIME_OF_DAY = re.compile(r"\s*(\d\d?):(\d\d):(\d\d(?:[.,]\d{1,9})?)\s*")
_DAY = 86_400 * 10**9


def dates(cells: Sequence[str]) -> NDArray[np.datetime64]:
    """Times from text; an offset from UTC is subtracted, times of day count from 1970-01-01.

    Raises
    ------
    ValueError
        A cell that is no date with a time of day, or dates and times of day in one column.

    Examples
    --------
    >>> dates(["2026-11-20T12:00:00.001953125+01:00"])
    array(['2026-11-20T11:00:00.001953125'], dtype='datetime64[ns]')
    >>> dates(["2026-324T11:00:00Z", "20.11.2026 11:00:00,5"])
    array(['2026-11-20T11:00:00.000000000', '2026-11-20T11:00:00.500000000'],
          dtype='datetime64[ns]')
    >>> dates(["23:59:59.5", "00:00:00.0"])
    array(['1970-01-01T23:59:59.500000000', '1970-01-02T00:00:00.000000000'],
          dtype='datetime64[ns]')
    """
    if cells and _TIME_OF_DAY.fullmatch(cells[0]):
        return _times_of_day(cells)
    matches = [next((m for kind in _DATE if (m := kind.fullmatch(cell))), None) for cell in cells]
    if not cells or any(match is None for match in matches):
        raise InputError("cells must be dates with a time of day")
    parts = [match.groupdict() for match in matches if match is not None]
    moments = np.array([_moment(part) for part in parts], "datetime64[ns]")
    return np.asarray(moments - np.array([_offset(part["zone"]) for part in parts], "timedelta64[m]"))


def _moment(part: dict[str, str | None]) -> str:
    """ISO 8601 of the parts of a date."""
    if part.get("number"):
        year, number = str(part["year"]), int(str(part["number"]))
        day = str(np.datetime64(f"{year}-01-01", "D") + np.timedelta64(number - 1, "D"))
        if not number or day[:4] != year:
            raise InputError("cells must be dates with a time of day")
    else:
        day = f"{part['year']}-{int(str(part['month'])):02d}-{int(str(part['day'])):02d}"
    second = (part["second"] or "00").replace(",", ".")
    return f"{day}T{int(str(part['hour'])):02d}:{part['minute']}:{second}"


def _offset(text: str | None) -> int:
    """Minutes by which a local time is ahead of UTC."""
    if text is None or text in ("Z", "UTC", "GMT"):
        return 0
    digits = text[1:].replace(":", "").ljust(4, "0")
    return int(text[0] + "1") * (60 * int(digits[:2]) + int(digits[2:]))


def _times_of_day(cells: Sequence[str]) -> NDArray[np.datetime64]:
    """Times of day; each step back by more than half a day is one over midnight."""
    matches = [_TIME_OF_DAY.fullmatch(cell) for cell in cells]
    if any(match is None for match in matches):
        raise InputError("cells must be times of day")
    texts = [match.groups() for match in matches if match is not None]
    if any(int(h) > 23 or int(m) > 59 or float(s.replace(",", ".")) >= 60 for h, m, s in texts):
        raise InputError("cells must be times of day")
    moments = np.array([f"1970-01-01T{int(h):02d}:{m}:{s.replace(',', '.')}" for h, m, s in texts], "datetime64[ns]")
    days = np.concatenate([[0], np.cumsum(np.diff(moments.astype(np.int64)) < -_DAY // 2)])
    return np.asarray(moments + (days * _DAY).astype("timedelta64[ns]"))
