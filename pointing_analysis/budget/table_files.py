"""Tables of a budget as files: CSV, or a workbook (.xlsx, the extra ``xlsx``) whose first sheet is the table."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file, write_text
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import LINES, TEXT
from pointing_analysis.files.structured_text import read_text
from pointing_analysis.read.tables.table import check_unpacked

WORKBOOK = ".xlsx"
ENDINGS = (".csv", WORKBOOK)
"""Endings of the files of tables."""

TEXT_HEADS = ("source", "type", "text", "requirement")
"""Columns of a workbook whose cells are texts, also where they look like a number."""

MAX_ROWS = 100_000
"""A workbook is compressed: this many rows are read at most."""


def read_rows(path: Path) -> tuple[list[str], Iterator[tuple[str, dict[str, str]]]]:
    """Heads of a table, and the cells of each row that has any, with the place of the row.

    Raises
    ------
    InputError
        An unreadable workbook, a repeated heading; of the rows: a cell without a heading.
    InputError
        A CSV file that cannot be read.
    """
    if path.suffix.lower() == WORKBOOK:
        lines = _lines_of_workbook(path)
    else:
        text = read_text(path).lstrip("\ufeff")
        if text.count("\n") > LINES:
            raise InputError(f"{path} must have at most {LINES} lines, got more")
        lines = list(csv.reader(io.StringIO(text), skipinitialspace=True))
    heads = [cell.strip() for cell in lines[0]] if lines else []
    if twice := [head for head in heads if head and heads.count(head) > 1]:
        raise InputError(f"{path}: columns must be unique, got {twice[0]!r} {heads.count(twice[0])} times")
    return heads, _filled(path, heads, lines[1:])


def _filled(path: Path, heads: list[str], lines: list[list[str]]) -> Iterator[tuple[str, dict[str, str]]]:
    for number, line in enumerate(lines, start=2):
        where, cells = f"{path}, line {number}", {}
        for column, cell in enumerate((cell.strip() for cell in line), start=1):
            head = heads[column - 1] if column <= len(heads) else ""
            if cell and not head:
                hint = "" if path.suffix.lower() == WORKBOOK else "; quote a text with commas"
                raise InputError(f"{where}: cells must be in a column with a heading, got {cell!r} in {column}{hint}")
            if cell:
                cells[head] = cell
        if cells:
            yield where, cells


def _lines_of_workbook(path: Path) -> list[list[str]]:
    openpyxl = _openpyxl(path)
    try:
        check_file(path, TEXT)
        with zipfile.ZipFile(path) as archive:
            check_unpacked(path, sum(entry.file_size for entry in archive.infolist()))
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            rows = book.worksheets[0].iter_rows(values_only=True, max_row=MAX_ROWS)
            lines = [["" if cell is None else _text(cell) for cell in row] for row in rows]
        finally:
            book.close()
    except (InputError, MemoryError):
        raise
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
    except Exception as error:  # of a damaged file openpyxl raises a dozen kinds
        text = " ".join(str(error).split())
        raise InputError(f"{path} must be a workbook (.xlsx), got {type(error).__name__}: {text}") from None
    while lines and not any(lines[-1]):
        lines.pop()
    return lines


def _text(cell: Any) -> str:
    """A cell as the CSV file has it: numbers with all their digits."""
    return repr(float(cell)) if isinstance(cell, (int, float)) and not isinstance(cell, bool) else str(cell)


def write_rows(path: Path, rows: Sequence[Mapping[str, str]], columns: Sequence[str] = ()) -> None:
    """Write a table, whole or not at all; by default with the columns that its rows have, in their order.

    In a workbook cells that are numbers are numbers.

    Raises
    ------
    InputError
        A workbook, and openpyxl is not installed.
    OSError
        The file cannot be written.
    """
    heads = list(columns or dict.fromkeys(key for row in rows for key in row))
    if path.suffix.lower() != WORKBOOK:
        out = io.StringIO()
        writer = csv.DictWriter(out, heads, lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows(rows)
        write_text(path, out.getvalue())
        return
    book = _openpyxl(path).Workbook()
    sheet = book.active
    sheet.append(heads)
    for row in rows:
        sheet.append([_number(row.get(head, ""), head) for head in heads])
    for cell in (cell for cells in sheet.iter_rows() for cell in cells if cell.data_type == "f"):
        cell.data_type = "s"  # a name that begins with = is no formula
    sheet.freeze_panes = "A2"
    for letter, head in zip((cell.column_letter for cell in sheet[1]), heads):
        sheet.column_dimensions[letter].width = min(
            60, 2 + max(len(head), *(len(row.get(head, "")) for row in rows), 8)
        )
    with atomic_file(path) as temporary:
        book.save(temporary)


def _number(cell: str, head: str) -> float | str | None:
    try:
        return cell if head in TEXT_HEADS else float(cell)
    except ValueError:
        return cell or None


def require_writable(path: Path) -> None:
    """Refuse a workbook before work where openpyxl is not installed.

    Raises
    ------
    InputError
        It is not.
    """
    if path.suffix.lower() == WORKBOOK:
        _openpyxl(path)


def _openpyxl(path: Path) -> Any:
    try:
        import openpyxl
    except ModuleNotFoundError:
        raise InputError(f"{path}: openpyxl must be installed: pip install 'los-testbed[xlsx]'") from None
    return openpyxl
