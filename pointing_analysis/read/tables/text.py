"""Table in a text file: CSV with any usual separator, or columns apart by spaces."""

from __future__ import annotations

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
from pointing_analysis.read.tables.times import dates
from pointing_analysis.units import ANGLES

DECIMAL_COMMA = re.compile(r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$")
COMMENT = ("#", "%")
UNIT_IN_COMMENT = re.compile(r"units?\s*[:=]\s*(.+)", re.IGNORECASE)
SHOWN = 60
"""Characters of a row in a message."""


def read_text(path: Path) -> Table:
    """Numeric columns; an empty cell is a missing sample.

    Lines that begin with # or % are comments. One in front of rows without a header is the header if it has as many
    names as they have cells, as ``numpy.savetxt(header=...)`` writes it; ``# unit: mas`` is the unit of the angles.

    Raises
    ------
    TableError
        Not text, no rows, rows of different length, columns of the same name.
    """
    try:
        content = read_bytes(path, TABLE)
        text = content.decode(text_encoding(content[:4]))
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: table must be UTF-8 text, got {error}") from None
    every = [line for line in text.splitlines() if line.strip()]
    lines = [line for line in every if not line.lstrip().startswith(COMMENT)]
    if not lines:
        raise TableError(f"{path}: table must have rows, got none")
    comments = [line.lstrip().lstrip("".join(COMMENT)).strip() for line in every[: every.index(lines[0])]]
    names, rows = _names_and_rows(path, lines, comments)
    empty = [not any(cell.strip() for cell in row) for row in rows]
    kept = [row for row, bare in zip(rows, empty) if not bare]
    columns = {name: _column(name, [row[i] for row in kept]) for i, name in enumerate(names)}
    notes = [f"{sum(empty)} rows without any value left out"] if any(empty) else []
    if texts := [name for name, column in columns.items() if column is None]:
        notes.append(f"columns of text left out: {', '.join(texts)}")
    units = {name: _units_in(comments) for name in names if split_unit(name)[1] in ("", *ANGLES)}
    return Table(path, "CSV", {n: c for n, c in columns.items() if c is not None}, units, left_out=tuple(notes))


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


def _names_and_rows(path: Path, lines: Sequence[str], comments: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    separator = _separator(lines[0])
    try:
        rows = list(csv.reader(lines, delimiter=separator)) if separator else [line.split() for line in lines]
    except csv.Error as error:
        raise TableError(f"{path}: table must have rows of numbers, got {error}") from None
    if separator != ",":
        rows = [_with_points(row) if "," in "".join(row) else row for row in rows]
    if _are_values(rows[0]):
        count = len(rows[0])
        names = _names_in(comments, separator, count) or [f"column_{i + 1}" for i in range(count)]
    else:
        names = [cell.strip() for cell in rows.pop(0)]
        if not any(letter.isalpha() for name in names for letter in name):
            raise TableError(f"{path}: first row must be names or numbers, got {lines[0].strip()[:SHOWN]!r}")
    if len(set(names)) < len(names):
        raise TableError(f"{path}: columns must have different names, got {', '.join(names)}")
    uneven = next((i for i, row in enumerate(rows) if len(row) != len(names)), None)
    if uneven is not None:
        raise TableError(f"{path}: every row must have {len(names)} cells, got {len(rows[uneven])} in row {uneven + 1}")
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


def _column(name: str, cells: Sequence[str]) -> Column | None:
    """Numbers or dates; None for other text."""
    try:
        if name.endswith("_ns"):
            return np.array([int(cell) for cell in cells], np.int64)
    except (ValueError, OverflowError):
        pass
    try:
        return np.array([_number(cell) for cell in cells])
    except ValueError:
        pass
    try:
        return dates(cells)
    except ValueError:
        return None
