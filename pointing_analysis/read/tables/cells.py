"""Cells of a text table: numbers with a decimal point or comma, dates, empty ones."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from lftkit.errors import InputError
from pointing_analysis.read.tables.dates import dates

DECIMAL_COMMA = re.compile(r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$")
DECIMAL_POINT = re.compile(r"^\s*[-+]?\d*\.\d+(?:[eE][-+]?\d+)?\s*$")
GROUP = re.compile(r"\s*[-+]?[1-9]\d{0,2},\d{3}\s*")
"""Thousands with a comma, or a number of three decimals."""
SHOWN = 60
"""Characters of a row in a message."""
SPREADSHEET_ERROR = re.compile(
    r'\s*"?#(?:N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!|SPILL!|CALC!|NV|WERT!|BEZUG!|ZAHL!)(?=$|[\s,;|"])'
)
"""Beginning of a cell that a spreadsheet writes in place of a number."""
_FORTRAN = re.compile(r"([\d.])[dD]([-+]?\d+)$")


def number(text: str) -> float:
    """Value of a cell; NaN of an empty one.

    Raises
    ------
    ValueError
        No number.

    Examples
    --------
    >>> number("1.5"), number(" -2.5D+01"), number("")
    (1.5, -25.0, nan)
    """
    text = text.strip()
    if not text:
        return math.nan
    if "_" in text:  # Python's own numbers may have it, no other program's
        raise InputError("number must be without underscores")
    try:
        return float(text)
    except ValueError:
        return float(_FORTRAN.sub(r"\1e\2", text))


def is_number(cell: str) -> bool:
    """Whether a cell is a number or empty."""
    try:
        number(cell)
    except ValueError:
        return False
    return True


def is_value(cell: str) -> bool:
    """Whether a cell is a number, empty, or a date with a time of day."""
    if is_number(cell):
        return True
    try:
        dates([cell])
    except ValueError:
        return False
    return True


def are_values(cells: Sequence[str]) -> bool:
    """Whether each cell is a value."""
    return all(map(is_value, cells))


def with_points(cells: Sequence[str]) -> list[str]:
    """Cells with a decimal point in place of a decimal comma."""
    return [DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in cells]


def check_decimal_mark(path: Path, numbers: Sequence[int], rows: Sequence[Sequence[str]]) -> None:
    """Refuse cells with a decimal comma beside cells with a decimal point: one of the two marks thousands.

    Also refused is a column whose commas are each in front of three digits, beside whole numbers below 1000.
    """
    comma: tuple[int, str] | None = None
    point: tuple[int, str] | None = None
    for row_number, row in zip(numbers, rows):
        for cell in row:
            if comma is None and "," in cell and DECIMAL_COMMA.match(cell):
                comma = row_number, cell.strip()
            if point is None and "." in cell and DECIMAL_POINT.match(cell):
                point = row_number, cell.strip()
        if comma and point:
            raise InputError(
                f"{path}: numbers must have one decimal mark and no marks of thousands, got {comma[1]!r} in row "
                f"{comma[0]} and {point[1]!r} in row {point[0]}"
            )
    if comma is None:
        return
    for column in zip(*(row for row in rows if len(row) == len(rows[-1]))):
        filled = [cell for cell in column if cell.strip()]
        groups = [cell for cell in filled if GROUP.fullmatch(cell)]
        whole = [cell for cell in filled if re.fullmatch(r"\s*[-+]?\d{1,3}\s*", cell)]
        if groups and whole and len(groups) + len(whole) >= len(filled) - 1 and len(filled) > 2:
            row_number = next(n for n, row in zip(numbers, rows) if groups[0] in row)
            raise InputError(
                f"{path}: row {row_number} must be without marks of thousands, got {groups[0].strip()!r} "
                f"in a column with {whole[0].strip()!r}"
            )
