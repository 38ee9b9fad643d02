"""Table in a text file: CSV with any usual separator, or columns separated by spaces."""

from __future__ import annotations

import contextlib
import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import TABLE
from pointing_analysis.read.tables.formats import text_encoding
from pointing_analysis.read.tables.table import Column, Table, TableError, split_unit, unit_name
from pointing_analysis.read.tables.times import UNITS as TIMES
from pointing_analysis.read.tables.times import dates
from pointing_analysis.units import ANGLES

DECIMAL_COMMA = re.compile(r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$")
COMMENT = ("#", "%")
UNIT_IN_COMMENT = re.compile(r"units?\s*[:=]\s*(.+)", re.IGNORECASE)
SHOWN = 60
"""Characters of a row in a message."""
MOST_TEXT = 0.5
"""Part of the cells of a column that are text from which on it is a column of text."""
Row = tuple[int, list[str]]
"""Line in the file and cells."""
_SEPARATOR_LINE = re.compile(r'^\ufeff?"?sep=(.)"?\s*$', re.IGNORECASE)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
_NO_UNIT = ("", "-", "1", "none")
_UNITS = frozenset((*_NO_UNIT, *ANGLES, *TIMES, "N", "Nm", "mN", "mNm", "rad/s", "deg/s", "px", "mm", "um", "m", "hz"))
"""Units that a row of units may have."""


def read_text(path: Path) -> Table:
    """Numeric columns; an empty cell is a missing sample.

    Lines that begin with # or % are comments. One in front of rows without a header is the header if it has as many
    names as they have cells, as ``numpy.savetxt(header=...)`` writes it; ``# unit: mas`` is the unit of the angles. A
    first line ``sep=;`` names the separator, as spreadsheets write it. A row of units may follow the header.

    Raises
    ------
    TableError
        Not text, no rows, rows of different length, columns of the same name, a cell of text among numbers.
    """
    text, notes = _decoded(path)
    every = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    named = _SEPARATOR_LINE.match(every[0][1]) if every else None
    every = every[1:] if named else every
    lines = [(number, line) for number, line in every if not line.lstrip().startswith(COMMENT)]
    if not lines:
        raise TableError(f"{path}: table must have rows, got none")
    comments = [line.lstrip().lstrip("".join(COMMENT)).strip() for number, line in every if number < lines[0][0]]
    names, rows = _names_and_rows(path, lines, comments, named[1] if named else None)
    stated_units = _row_of_units(rows[0][1]) if rows else None
    rows = rows[1:] if stated_units else rows
    empty = [not any(cell.strip() for cell in row) for _, row in rows]
    kept = [row for row, bare in zip(rows, empty) if not bare]
    columns = {name: _column(path, name, [(n, row[i]) for n, row in kept]) for i, name in enumerate(names)}
    notes += [f"{sum(empty)} empty rows skipped"] if any(empty) else []
    if texts := [name for name, column in columns.items() if column is None]:
        notes.append(f"text columns ignored: {', '.join(texts)}")
    units = {name: _units_in(comments) for name in names if split_unit(name)[1] in ("", *ANGLES)}
    for name, unit in zip(names, stated_units or ()):
        units[name] = [*units.get(name, ()), *filter(None, [unit])]
    kept_columns = {name: column for name, column in columns.items() if column is not None}
    return Table(path, "CSV", kept_columns, units, left_out=tuple(notes), names=tuple(names))


def _decoded(path: Path) -> tuple[str, list[str]]:
    """Text of a file in UTF-8, marked UTF-16 or Windows-1252, and a note of the last one."""
    try:
        content = read_bytes(path, TABLE)
    except OSError as error:
        raise TableError(f"{path}: table must be a readable file, got {error}") from None
    try:
        return content.decode(text_encoding(content[:4])), []
    except UnicodeDecodeError as error:
        if _CONTROL.search(content):
            raise TableError(f"{path}: table must be text, got {error.reason} at byte {error.start}") from None
    try:
        return content.decode("cp1252"), ["text that is not UTF-8 read as Windows-1252"]
    except UnicodeDecodeError as error:
        raise TableError(f"{path}: table must be text in UTF-8, UTF-16 or Windows-1252, got {error.reason}") from None


def _row_of_units(cells: Sequence[str]) -> list[str] | None:
    """Units of the columns in a row that has nothing else, empty where one has none; None for another row."""
    found = [unit_name(cell.strip().strip("[]()")) for cell in cells]
    if all(unit in _NO_UNIT for unit in found) or not all(unit in _UNITS for unit in found):
        return None
    return ["" if unit in _NO_UNIT else unit for unit in found]


def _units_in(comments: Sequence[str]) -> list[str]:
    """Units of angle that comments name."""
    found = [unit_name(match[1]) for line in comments if (match := UNIT_IN_COMMENT.fullmatch(line))]
    return [unit for unit in found if unit in ANGLES]


def _names_in(comments: Sequence[str], separator: str | None, count: int) -> list[str] | None:
    """Names of the columns in the last comment that has as many; None without one."""
    for line in reversed([comment for comment in comments if not UNIT_IN_COMMENT.fullmatch(comment)]):
        for mark in (separator, ",", ";", "\t", None):
            cells = [cell.strip() for cell in (line.split() if mark is None else line.split(mark))]
            if len(cells) == len(set(cells)) == count and all(any(map(str.isalpha, cell)) for cell in cells):
                return cells
    return None


def _names_and_rows(
    path: Path, lines: Sequence[tuple[int, str]], comments: Sequence[str], separator: str | None
) -> tuple[list[str], list[Row]]:
    """Names of the columns, and rows of cells with their lines in the file."""
    first = lines[0][1]
    separator = separator or _separator(first)
    texts = [line for _, line in lines]
    try:
        cells = list(csv.reader(texts, delimiter=separator)) if separator else [line.split() for line in texts]
    except csv.Error as error:
        raise TableError(f"{path}: table must have rows of numbers, got {error}") from None
    if separator != ",":
        cells = [_with_points(row) if "," in "".join(row) else row for row in cells]
    numbers = [number for number, _ in lines] if len(cells) == len(lines) else list(range(1, len(cells) + 1))
    rows = list(zip(numbers, cells))
    if _are_values(cells[0]):
        count = len(cells[0])
        names = _names_in(comments, separator, count) or [f"column_{i + 1}" for i in range(count)]
    else:
        names = [cell.strip() for cell in rows.pop(0)[1]]
        if not any(letter.isalpha() for name in names for letter in name):
            raise TableError(f"{path}: first row must be names or numbers, got {first.strip()[:SHOWN]!r}")
    if len(set(names)) < len(names):
        raise TableError(f"{path}: columns must have different names, got {', '.join(names)}")
    uneven = next(((number, len(row)) for number, row in rows if len(row) != len(names)), None)
    if uneven is not None:
        raise TableError(f"{path}: every row must have {len(names)} cells, got {uneven[1]} in row {uneven[0]}")
    return names, rows


def _separator(line: str) -> str | None:
    """Mark between the cells of the first line; None for spaces.

    Commas are decimal ones where only cells between spaces are numbers with them.

    Examples
    --------
    >>> _separator("0 0,5 -1,25"), _separator("0, 0.5, -1.25"), _separator("0,5;1,25"), _separator("t x y")
    (None, ',', ';', None)
    """
    found = next((mark for mark in (";", "\t", ",") if mark in line), None)
    if found == "," and not _are_values(line.split(",")) and _are_values(_with_points(line.split())):
        return None
    return found


def _with_points(cells: Sequence[str]) -> list[str]:
    """Cells with a decimal point in place of a decimal comma."""
    return [DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in cells]


def _are_values(cells: Sequence[str]) -> bool:
    """Whether each cell is a number, empty, or a date with a time of day."""
    return all(_is_number(cell) or _is_date(cell) for cell in cells)


def _is_number(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return False
    return True


def _is_date(cell: str) -> bool:
    try:
        dates([cell])
    except ValueError:
        return False
    return True


def _number(text: str) -> float:
    text = text.strip()
    return float(text) if text else math.nan


def _column(path: Path, name: str, cells: Sequence[tuple[int, str]]) -> Column | None:
    """Numbers or dates; None for other text.

    Raises
    ------
    TableError
        Most cells are numbers or dates, and another one is not: a column with text in it is no column of text.
    """
    texts = [cell for _, cell in cells]
    try:
        if name.endswith("_ns"):
            return np.array([int(cell) for cell in texts], np.int64)
    except (ValueError, OverflowError):
        pass
    for read in (lambda: np.array([_number(cell) for cell in texts]), lambda: dates(texts)):
        with contextlib.suppress(ValueError):
            return read()
    given = [(number, cell) for number, cell in cells if cell.strip()]
    others = [(number, cell) for number, cell in given if not _are_values([cell])]
    if 0 < len(others) < MOST_TEXT * len(given):
        number, cell = others[0]
        raise TableError(f"{path}: row {number}, column {name} must be a number, got {cell.strip()[:SHOWN]!r}")
    return None
