"""Line of sight in a table: CSV, Parquet or NumPy file.

Columns are chosen by name (``x,y``) or, without names, by position: two columns are the line of sight; of three the
first is the time. Times: `pointing_analysis.read.table_times`.
"""

from __future__ import annotations

import csv
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pointing_analysis.read.series import Series, make_series, stamps_of
from pointing_analysis.read.table_times import Column, column_stamps, dates, time_column

SUFFIXES = (".csv", ".txt", ".parquet", ".npy", ".npz")
DECIMAL_COMMA = re.compile(r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$")
MAX_UNPACKED, MAX_RATIO = 200_000_000, 100
"""A compressed table may unpack to this many bytes, or to this many times its size."""
X_NAMES = (("x", "y"), ("los_x", "los_y"), ("los.x", "los.y"), ("error_x", "error_y"))


class TableError(ValueError):
    """A table that cannot be used; the message says what it must be and what it is."""


def read_table(
    path: Path, los: str | None = None, *, unit: str | None, rate: float | None = None, time: str | None = None
) -> Series:
    """Line of sight from a table.

    Parameters
    ----------
    path : file ending in .csv, .txt, .parquet, .npy or .npz
    los : names of two columns, ``x,y``; by default x, y or those that are left beside the time
    unit : of the line of sight
    rate : sampling rate [Hz]; needed where there is no time
    time : name of the time column; by default `pointing_analysis.read.table_times.time_column`

    Raises
    ------
    TableError
        A file that cannot be read, or columns that are not there.
    ValueError
        Unknown unit, or neither times nor a rate.
    """
    if not path.is_file():
        raise TableError(f"{path}: no such file")
    columns = _READERS[path.suffix.lower()](path)
    if not columns:
        raise TableError(f"{path}: table must have numeric columns, got none")
    when = _time_column(path, columns, time, los)
    x, y = _los_columns(path, columns, los, when)
    xy = np.column_stack([columns[x], columns[y]]).astype(float)
    try:
        stamps = stamps_of(None, len(xy), rate) if when is None else column_stamps(when, columns[when], rate)
    except ValueError as error:
        raise TableError(f"{path}: {error}{_others(columns, x, y) if when is None else ''}") from None
    unused = _others(columns, x, y) if when is None else ""
    problems = [f"no time column: {rate:g} Hz without gaps assumed{unused}"] if unused else []
    about = {"line_of_sight": f"{x}, {y}", "time": when or "none, from the rate"}
    return make_series(stamps, xy, unit=unit, rate=rate, path=path, parameters=about, problems=problems)


def _others(columns: Mapping[str, Column], x: str, y: str) -> str:
    rest = [name for name in columns if name not in (x, y)]
    return f" (others, for --time: {', '.join(rest)})" if rest else ""


def _time_column(path: Path, columns: Mapping[str, Column], asked: str | None, los: str | None) -> str | None:
    if asked is not None:
        if asked not in columns:
            raise TableError(f"{path}: time must be one of {', '.join(columns)}, got {asked!r}")
        return asked
    named = [part.strip() for part in los.split(",")] if los else list(_known_pair(list(columns)) or ())
    return time_column(columns, named)


def _known_pair(names: Sequence[str]) -> tuple[str, str] | None:
    lower = {name.lower(): name for name in names}
    return next(((lower[x], lower[y]) for x, y in X_NAMES if x in lower and y in lower), None)


def _los_columns(path: Path, columns: Mapping[str, Column], los: str | None, when: str | None) -> tuple[str, str]:
    if los is not None:
        asked = tuple(part.strip() for part in los.split(","))
        if len(asked) != 2 or any(name not in columns for name in asked):
            raise TableError(f"{path}: los must be two of the columns {', '.join(columns)}, got {los!r}")
        return asked[0], asked[1]
    rest = [name for name in columns if name != when]
    pair = _known_pair(rest) or ((rest[0], rest[1]) if len(rest) == 2 else None)
    if pair is None:
        raise TableError(f"{path}: los must name two of the columns {', '.join(columns)} (--los X,Y), got none")
    return pair


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


def _csv(path: Path) -> dict[str, Column]:
    """Numeric columns; an empty cell is a missing sample. Lines that begin with # are left out."""
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: table must be UTF-8 text, got {error}") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise TableError(f"{path}: table must have rows, got none")
    separator = next((mark for mark in (";", "\t", ",") if mark in lines[0]), None)
    try:
        rows = list(csv.reader(lines, delimiter=separator)) if separator else [line.split() for line in lines]
    except csv.Error as error:
        raise TableError(f"{path}: table must have rows of numbers, got {error}") from None
    if separator != ",":
        rows = [[DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in row] if "," in "".join(row) else row for row in rows]
    try:
        [_number(cell) for cell in rows[0]]
        names = [f"column_{i + 1}" for i in range(len(rows[0]))]
    except ValueError:
        names = [cell.strip() for cell in rows.pop(0)]
    if len(set(names)) < len(names):
        raise TableError(f"{path}: columns must have different names, got {', '.join(names)}")
    uneven = next((i for i, row in enumerate(rows) if len(row) != len(names)), None)
    if uneven is not None:
        raise TableError(f"{path}: every row must have {len(names)} cells, got {len(rows[uneven])} in row {uneven + 1}")
    columns = {name: _column(name, [row[i] for row in rows]) for i, name in enumerate(names)}
    return {name: column for name, column in columns.items() if column is not None}


def _parquet(path: Path) -> dict[str, Column]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise TableError(f"{path}: pyarrow must be installed: pip install 'los-testbed[parquet]'") from None

    def numbers(kind: pyarrow.DataType) -> bool:
        return any(getattr(pyarrow.types, f"is_{name}")(kind) for name in ("timestamp", "integer", "floating"))

    try:
        file = parquet.ParquetFile(path)
        schema = file.schema_arrow
        names = [name for name, kind in zip(schema.names, schema.types) if numbers(kind)]
        _check_unpacked(path, 8 * len(names) * file.metadata.num_rows)
        table = file.read(columns=names)
    except (pyarrow.ArrowException, OSError) as error:
        raise TableError(f"{path}: table must be Parquet, got {str(error).splitlines()[0]}") from None
    if len(set(table.column_names)) < len(table.column_names):
        raise TableError(f"{path}: columns must have different names, got {', '.join(table.column_names)}")
    found: dict[str, Column] = {}
    for name in table.column_names:
        column = table.column(name)
        time = pyarrow.types.is_timestamp(column.type)
        found[name] = (column.cast(pyarrow.timestamp("ns")) if time else column).to_numpy()
    return found


def _check_unpacked(path: Path, size: int) -> None:
    """Some kilobytes can stand for any number of rows: the declared size is checked before memory is taken."""
    if size > max(MAX_UNPACKED, MAX_RATIO * path.stat().st_size):
        raise TableError(
            f"{path}: table must unpack to at most {MAX_UNPACKED / 1e6:g} MB or {MAX_RATIO} times its size, "
            f"got {size / 1e6:.0f} MB"
        )


def _numpy(path: Path) -> dict[str, Column]:
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                _check_unpacked(path, sum(entry.file_size for entry in archive.infolist()))
            with np.load(path, allow_pickle=False) as content:
                return _named_arrays(path, {name: content[name] for name in content.files})
        # mapped, not read: the shape that a file declares may be any
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except TableError:
        raise
    except Exception as error:  # of a damaged file numpy raises a dozen kinds, that of its tokenizer included
        raise TableError(
            f"{path}: file must hold plain NumPy arrays, got {str(error) or type(error).__name__}"
        ) from None
    if array.dtype.names:
        return {name: array[name] for name in array.dtype.names if array.dtype[name].kind in "fiuM"}
    if array.ndim != 2 or array.shape[1] not in (2, 3) or array.dtype.kind not in "fiu":
        raise TableError(f"{path}: array must have the shape (n, 2), or (n, 3) with the time first, got {array.shape}")
    return {f"column_{i + 1}": np.array(array[:, i]) for i in range(array.shape[1])}


def _named_arrays(path: Path, content: Mapping[str, Column]) -> dict[str, Column]:
    """Columns of the arrays of a ``.npz`` file."""
    found: dict[str, Column] = {}
    for name, array in content.items():
        if array.dtype.kind not in "fiuM":
            continue
        if array.ndim == 1:
            found[name] = array
        elif array.ndim == 2 and array.shape[1] in (2, 3):
            found.update({f"{name}.{axis}": array[:, i] for i, axis in enumerate("xyz"[: array.shape[1]])})
    if len({len(column) for column in found.values()}) > 1:
        raise TableError(f"{path}: arrays must have the same length, got {sorted({len(c) for c in found.values()})}")
    return found


_READERS = {".csv": _csv, ".txt": _csv, ".parquet": _parquet, ".npy": _numpy, ".npz": _numpy}
