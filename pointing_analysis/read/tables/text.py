"""Table in a text file: CSV with any usual separator, or columns separated by spaces.

Around the rows of a table programs write titles, comments, a ``sep=`` line, rows of units, empty cells at the end of
each row, and the header once more. None of it changes a value; what is skipped is noted.
"""

from __future__ import annotations

import contextlib
import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import TABLE
from pointing_analysis.read.tables.cells import (
    SHOWN,
    SPREADSHEET_ERROR,
    are_values,
    check_decimal_mark,
    is_number,
    is_value,
    number,
    with_points,
)
from pointing_analysis.read.tables.dates import dates
from pointing_analysis.read.tables.formats import text_encoding
from pointing_analysis.read.tables.table import Column, Table, split_unit, unit_name
from pointing_analysis.read.tables.times import UNITS as TIMES
from pointing_analysis.units import ANGLES

MOST_TEXT = 0.5
"""Part of the cells of a column that are text from which on it is a column of text."""
COMMENT = ("#", "%")
COMMENT_IN_FRONT = (";", "!", "//", "--")
"""What begins a comment in front of the first row only, of other programs."""
TITLES = 200
"""Lines in front of the header that are searched for it."""
UNIT_IN_COMMENT = re.compile(r"units?\s*[:=]\s*(.+)", re.IGNORECASE)
ECSV_COLUMN = re.compile(r"-\s*\{\s*name:\s*([^,]+?)\s*,\s*unit:\s*([^,}]+?)\s*[,}].*")
"""A column in the header of astropy's ECSV format."""
_SEPARATOR_LINE = re.compile(r'^\ufeff?"?sep=(.)"?\s*$', re.IGNORECASE)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]")
_NO_UNIT = ("", "-", "1", "none")
_UNITS = frozenset((*_NO_UNIT, *ANGLES, *TIMES, "N", "Nm", "mN", "mNm", "rad/s", "deg/s", "px", "mm", "um", "m", "hz"))
"""Units that a row of units may have."""
Row = tuple[int, list[str]]
"""Line in the file and cells."""
Line = tuple[int, str]


def read_text(path: Path) -> Table:
    """Numeric columns; an empty cell is a missing sample.

    Lines that begin with # or % are comments. One in front of rows without a header is the header if it has as many
    names as they have cells, as ``numpy.savetxt(header=...)`` writes it; ``# unit: mas`` is the unit of the angles,
    ``# units: s, mas, mas`` has one for each column. A first line ``sep=;`` names the separator, as spreadsheets write
    it. A row of units may follow the header, titles may precede it.

    Raises
    ------
    InputError
        Not text, no rows, rows of different length, columns of the same name, a cell of text among numbers, two decimal
        marks.
    """
    names, rows, units_of_columns, units_of_all, notes = _rows_of(path)
    empty = [not any(cell.strip() for cell in row) for _, row in rows]
    kept = [row for row, bare in zip(rows, empty) if not bare]
    cells = {name: [(n, row[i]) for n, row in kept] for i, name in enumerate(names)}
    columns = {name: _column(path, name, column) for name, column in cells.items()}
    if any(empty):
        notes.append(f"{sum(empty)} empty rows skipped")
    texts = {name: _first_text(cells[name]) for name, column in columns.items() if column is None}
    if texts:
        notes.append(f"text columns ignored: {', '.join(texts)}")
    units: dict[str, list[str]] = {}
    for name, unit in zip(names, units_of_columns):
        for_all = units_of_all if split_unit(name)[1] in ("", *ANGLES) else ()
        units[name] = [*for_all, *filter(None, [unit])]
    kept_columns = {name: column for name, column in columns.items() if column is not None}
    return Table(path, "CSV", kept_columns, units, left_out=tuple(notes), names=tuple(names), texts=texts)


def _first_text(cells: Sequence[tuple[int, str]]) -> tuple[int, str]:
    """Line in the file and first cell that is no number."""
    row, cell = next((n, cell) for n, cell in cells if cell.strip() and not are_values([cell]))
    return row, cell.strip()[:SHOWN]


def _column(path: Path, name: str, cells: Sequence[tuple[int, str]]) -> Column | None:
    """Numbers or dates; None for other text.

    Raises
    ------
    InputError
        Most cells are numbers or dates, and another one is not: a column with text in it is no column of text. So it is
        for each error of a spreadsheet.
    """
    texts = [cell for _, cell in cells]
    try:
        if split_unit(name)[1] == "ns":
            return np.array([int(cell) for cell in texts], np.int64)
    except (ValueError, OverflowError):
        pass
    for read in (lambda: np.array([number(cell) for cell in texts]), lambda: dates(texts)):
        with contextlib.suppress(ValueError):
            return read()
    filled = [(row, cell) for row, cell in cells if cell.strip()]
    others = [(row, cell) for row, cell in filled if not are_values([cell])]
    errors = [(row, cell) for row, cell in others if SPREADSHEET_ERROR.match(cell)]
    if not others:  # numbers beside dates: the fewer ones
        kinds = [pair for pair in filled if is_number(pair[1])], [pair for pair in filled if not is_number(pair[1])]
        others = errors = min(kinds, key=len)
    if len(others) < MOST_TEXT * len(filled) or (errors and len(others) < len(filled)):
        row, cell = (errors or others)[0]
        raise InputError(f"{path}: row {row}, column {name} must be a number, got {cell.strip()[:SHOWN]!r}")
    return None


def _rows_of(path: Path) -> tuple[list[str], list[Row], list[str], list[str], list[str]]:
    """Names, rows and units of a table.

    Returns
    -------
    names : of the columns
    rows : line in the file and cells of each row, as many as names
    units : of the columns, empty where none is stated beside the names
    units_of_all : of angle, of all columns
    notes : what was skipped, one sentence each

    Raises
    ------
    InputError
        Not text, no rows, rows of different length, columns of the same name, two decimal marks.
    """
    # The text, in UTF-8, UTF-16, UTF-32 or Windows-1252
    try:
        content = read_bytes(path, TABLE)
    except OSError as error:
        raise InputError(f"{path}: table must be a readable file, got {error}") from None
    encoding, notes = text_encoding(content[:4]), list[str]()
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if _CONTROL.search(content):
            raise InputError(f"{path}: table must be text, got {error.reason} at byte {error.start}") from None
        notes = ["text that is not UTF-8 read as Windows-1252"]
        try:
            text = content.decode("cp1252")
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: table must be text in UTF-8, UTF-16, UTF-32 or Windows-1252, got {error.reason}"
            ) from None
    text = text.rstrip("\x1a").replace("\N{MINUS SIGN}", "-")
    if (zero := text.find("\0")) >= 0:
        row = text.count("\n", 0, zero) + 1
        raise InputError(f"{path}: row {row} must be text, got zero bytes: the file was not written to its end")
    # Its lines without comments and titles; what stands in front of the rows may hold their units
    every = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    named = _SEPARATOR_LINE.match(every[0][1]) if every else None
    lines = [pair for pair in (every[1:] if named else every) if not _is_comment(pair[1])]
    lines = _without_comments_in_front(lines)
    if not lines:
        raise InputError(f"{path}: table must have rows, got none")
    titles, separator = _titles(lines, named[1] if named else None)
    if titles:
        notes.append(f"{counted(titles, 'line')} in front of the header skipped")
    lines = lines[titles:]
    marks = "".join((*COMMENT, *COMMENT_IN_FRONT))
    comments = [line.lstrip().lstrip(marks).strip() for number, line in every if number < lines[0][0]]
    names, rows = _names_and_rows(path, lines, comments, separator)
    # The header may be repeated between the rows
    if repeated := [number for number, row in rows if [cell.strip() for cell in row] == names]:
        rows = [pair for pair in rows if pair[0] not in set(repeated)]
        notes.append(f"header repeated in row {', '.join(map(str, repeated[:5]))} skipped")
    names, rows = _even(path, names, rows)
    units: list[str] | None = _row_of_units(rows) if rows else None
    if units is not None:
        rows = rows[1:]
    if not any(units or ()):
        units = _units_in_comments(comments, names)
    in_comments = [unit_name(match[1]) for line in comments if (match := UNIT_IN_COMMENT.fullmatch(line))]
    units_of_all = [unit for unit in in_comments if unit in ANGLES]
    return names, rows, units or ["" for _ in names], units_of_all, notes


def _is_comment(line: str) -> bool:
    start = line.lstrip()
    return start.startswith(COMMENT) and not SPREADSHEET_ERROR.match(start)


def _without_comments_in_front(lines: list[Line]) -> list[Line]:
    """Lines without those that begin as comments of other programs do, up to the first other one.

    A line that begins with a semicolon and has as many as the last one is a row with an empty first cell.
    """
    for i, (_, line) in enumerate(lines):
        mark = next((mark for mark in COMMENT_IN_FRONT if line.lstrip().startswith(mark)), None)
        if mark is None or (mark == ";" and line.count(";") == lines[-1][1].count(";")) or are_values([line[:2]]):
            return lines[i:]
    return []


def _titles(lines: Sequence[Line], stated: str | None) -> tuple[int, str | None]:
    """Lines of free text in front of the header, and the mark between cells.

    A title has another number of cells than the rows; behind titles there must be a header with as many names as the
    next row has values, or the one behind a row of units. Without such a header nothing is skipped.
    """
    for i in range(min(len(lines) - 1, TITLES)):
        mark = stated or separator_of(lines[i][1])
        try:
            names, row = (_cells(lines[k][1], mark) for k in (i, i + 1))
            if are_values(names) or are_values(lines[i][1].split()):
                break
            if len(row) == len(names) and i + 2 < len(lines) and not any(map(is_value, filter(None, row))):
                row = _cells(lines[i + 2][1], mark)  # behind a row of units
            if len(names) == len(row) > 1 and are_values(row) and not any(map(is_value, filter(None, names))):
                same = any(len(_cells(lines[k][1], mark)) == len(names) for k in range(i))
                return (i, mark) if not same else (0, stated or separator_of(lines[0][1]))
        except csv.Error:
            break
    return 0, stated or separator_of(lines[0][1])


def _cells(line: str, separator: str | None) -> list[str]:
    cells = next(csv.reader([line], delimiter=separator), []) if separator else line.split()
    return with_points(cells) if separator != "," or '"' in line else cells


def _names_in(comments: Sequence[str], separator: str | None, count: int) -> list[str] | None:
    """Names of the columns in the last comment that has as many; None without one."""
    for line in reversed([comment for comment in comments if not UNIT_IN_COMMENT.fullmatch(comment)]):
        for mark in (separator, ",", ";", "\t", None):
            cells = [cell.strip() for cell in (line.split() if mark is None else line.split(mark))]
            if len(cells) == len(set(cells)) == count and all(any(map(str.isalpha, cell)) for cell in cells):
                return cells
    return None


def _names_and_rows(
    path: Path, lines: Sequence[Line], comments: Sequence[str], separator: str | None
) -> tuple[list[str], list[Row]]:
    """Names of the columns, and rows of cells with their lines in the file."""
    first, texts = lines[0][1], [line for _, line in lines]
    try:
        cells = list(csv.reader(texts, delimiter=separator)) if separator else [line.split() for line in texts]
    except csv.Error as error:
        raise InputError(f"{path}: table must have rows of numbers, got {error}") from None
    numbers = [number for number, _ in lines] if len(cells) == len(lines) else list(range(1, len(cells) + 1))
    if separator != "," or any('"' in line for line in texts[:2]):
        check_decimal_mark(path, numbers, cells)
        cells = [with_points(row) if "," in "".join(row) else row for row in cells]
    rows = list(zip(numbers, cells))
    if are_values(cells[0]):
        count = len(cells[0])
        return _names_in(comments, separator, count) or [f"column_{i + 1}" for i in range(count)], rows
    names = [cell.strip() for cell in rows.pop(0)[1]]
    if not any(letter.isalpha() for name in names for letter in name):
        raise InputError(f"{path}: first row must be names or numbers, got {first.strip()[:SHOWN]!r}")
    return names, rows


def _even(path: Path, names: list[str], rows: list[Row]) -> tuple[list[str], list[Row]]:
    """Names that differ and rows of as many cells, without empty columns at the end that have no name."""
    width = max(len(names), *(len(row) for _, row in rows)) if rows else len(names)
    ends = len(names)  # columns from here on have no name
    while ends and not names[ends - 1]:
        ends -= 1
    filled = any(cell.strip() for _, row in rows for cell in row[ends:])
    if ends < width and not filled:
        least = min((len(row) for _, row in rows), default=width)
        if least >= ends:
            names, rows = names[:ends], [(number, row[:ends]) for number, row in rows]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: columns must have different names, got {', '.join(names)}")
    uneven = next(((number, len(row)) for number, row in rows if len(row) != len(names)), None)
    if uneven is not None:
        raise InputError(f"{path}: every row must have {len(names)} cells, got {uneven[1]} in row {uneven[0]}")
    return names, rows


def separator_of(line: str) -> str | None:
    """Mark between the cells of the first line; None for spaces.

    Commas are decimal ones where only cells between spaces are numbers with them.

    Examples
    --------
    >>> separator_of("0 0,5 -1,25"), separator_of("0, 0.5, -1.25"), separator_of("0,5;1,25"), separator_of("t x y")
    (None, ',', ';', None)
    """
    mark_of_line = next((mark for mark in (";", "\t", "|", ",") if mark in line), None)
    if mark_of_line == "," and not are_values(line.split(",")) and are_values(with_points(line.split())):
        return None
    return mark_of_line


def _row_of_units(rows: Sequence[Row]) -> list[str] | None:
    """Units of the columns in a row that has nothing else, empty where one has none; None for another row.

    Words in each cell in front of a row of numbers are units, too, of any quantity: they are no values.
    """
    cells = [cell.strip().strip("[]()") for cell in rows[0][1]]
    units = [unit_name(cell) for cell in cells]
    words = all(cell and len(cell) <= SHOWN // 3 and not are_values([cell]) for cell in cells)
    words = words and not any(map(SPREADSHEET_ERROR.match, cells))
    if words and len(rows) > 1 and all(rows[1][1]) and are_values(rows[1][1]) and units[0] in _UNITS:
        return units
    if all(unit in _NO_UNIT for unit in units) or not all(unit in _UNITS for unit in units):
        return None
    return ["" if unit in _NO_UNIT else unit for unit in units]


def _units_in_comments(comments: Sequence[str], names: Sequence[str]) -> list[str]:
    """Units of the columns that comments name, one for each column or by its name."""
    by_name = {match[1]: unit_name(match[2]) for line in comments if (match := ECSV_COLUMN.fullmatch(line))}
    if by_name:
        return [by_name.get(name, "") for name in names]
    for line in comments:
        match = UNIT_IN_COMMENT.fullmatch(line)
        units = [unit_name(part) for part in match[1].split(",")] if match else []
        if len(units) == len(names) > 1:
            return ["" if unit in _NO_UNIT else unit for unit in units]
    return []
