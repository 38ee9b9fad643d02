"""Table in a text file: CSV with any usual separator, or columns separated by spaces."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.read.tables.cells import SHOWN, SPREADSHEET_ERROR, are_values, is_number, number
from pointing_analysis.read.tables.dates import dates
from pointing_analysis.read.tables.table import Column, Table, split_unit
from pointing_analysis.read.tables.text_rows import rows_of
from pointing_analysis.units import ANGLES

MOST_TEXT = 0.5
"""Part of the cells of a column that are text from which on it is a column of text."""


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
    parsed = rows_of(path)
    empty = [not any(cell.strip() for cell in row) for _, row in parsed.cells]
    kept = [row for row, bare in zip(parsed.cells, empty) if not bare]
    cells = {name: [(n, row[i]) for n, row in kept] for i, name in enumerate(parsed.names)}
    columns = {name: _column(path, name, rows) for name, rows in cells.items()}
    notes = [*parsed.notes, *([f"{sum(empty)} empty rows skipped"] if any(empty) else [])]
    texts = {name: _first_text(cells[name]) for name, column in columns.items() if column is None}
    if texts:
        notes.append(f"text columns ignored: {', '.join(texts)}")
    units: dict[str, list[str]] = {}
    for name, unit in zip(parsed.names, parsed.units):
        for_all = parsed.units_of_all if split_unit(name)[1] in ("", *ANGLES) else ()
        units[name] = [*for_all, *filter(None, [unit])]
    kept_columns = {name: column for name, column in columns.items() if column is not None}
    return Table(path, "CSV", kept_columns, units, left_out=tuple(notes), names=tuple(parsed.names), texts=texts)


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
