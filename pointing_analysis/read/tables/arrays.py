"""Tables in Parquet and NumPy files."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.read.tables.table import Column, Gathered, Table, check_unpacked

READ_FROM_PARQUET = ("timestamp", "duration", "integer", "floating", "decimal")
"""Types of columns with numbers or times."""


def read_parquet(path: Path) -> Table:
    """Columns of numbers and times of a Parquet file.

    Raises
    ------
    InputError
        pyarrow is not installed, the file is damaged, unpacks to too much, or has columns of the same name.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise InputError(f"{path}: pyarrow must be installed: pip install 'los-testbed[parquet]'") from None

    def numbers(kind: pyarrow.DataType) -> bool:
        return any(getattr(pyarrow.types, f"is_{name}")(kind) for name in READ_FROM_PARQUET)

    try:
        file = parquet.ParquetFile(path)
        schema = file.schema_arrow
        names = [name for name, kind in zip(schema.names, schema.types) if numbers(kind)]
        check_unpacked(path, 8 * len(names) * file.metadata.num_rows)
        table = file.read(columns=names)
        others = {name: f"{kind}" for name, kind in zip(schema.names, schema.types) if not numbers(kind)}
    except (pyarrow.ArrowException, OSError) as error:
        raise InputError(f"{path}: table must be Parquet, got {str(error).splitlines()[0]}") from None
    if len(set(table.column_names)) < len(table.column_names):
        raise InputError(f"{path}: columns must have different names, got {', '.join(table.column_names)}")
    columns: dict[str, Column] = {}
    units: dict[str, list[str]] = {}
    for name in table.column_names:
        column = table.column(name)
        time, since = (getattr(pyarrow.types, f"is_{kind}")(column.type) for kind in ("timestamp", "duration"))
        if time:
            column = column.cast(pyarrow.timestamp("ns"))
        elif since:
            column = column.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
        elif pyarrow.types.is_decimal(column.type):
            column = column.cast(pyarrow.float64())
        columns[name] = column.to_numpy()
        about = table.schema.field(name).metadata or {}
        units[name] = [about[key].decode("utf-8", "replace") for key in (b"unit", b"units") if key in about]
        units[name] += ["ns"] if since else []
    texts = {name: (1, kind) for name, kind in others.items()}
    return Table(path, "Parquet", columns, units, names=tuple(schema.names), texts=texts)


def _check_shapes(archive: zipfile.ZipFile) -> None:
    """Numpy takes memory for the shape that an array of an archive declares, which may be any."""
    heads: Any = np.lib.format
    for entry in archive.infolist():
        if not entry.filename.endswith(".npy"):
            continue
        with archive.open(entry) as file:
            version = heads.read_magic(file)
            read = heads.read_array_header_1_0 if version[0] == 1 else heads.read_array_header_2_0
            shape, _, dtype = read(file)
        if math.prod(shape) * dtype.itemsize > entry.file_size:
            raise InputError(
                f"{entry.filename} must have the numbers of its shape {shape}, got {entry.file_size} bytes"
            )


def read_numpy(path: Path) -> Table:
    """Columns of the arrays of a ``.npz`` file, of a record array, or of an array (n, 2 to 12).

    Raises
    ------
    InputError
        Damaged, with objects of Python in it, unpacking to too much, or of another shape.
    """
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                check_unpacked(path, sum(entry.file_size for entry in archive.infolist()))
                _check_shapes(archive)
            gathered = Gathered()
            with np.load(path, allow_pickle=False) as content:
                for name in content.files:
                    array = content[name]
                    if array.dtype.kind == "U" and len(np.unique(array)) == 1:  # of each column the same
                        gathered.add_setting(name, str(array.reshape(-1)[0]))
                    else:
                        gathered.add(name, array)
            return gathered.table(path, "NumPy")
        # mapped, not read: the shape that a file declares may be any
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except MemoryError:
        raise
    except InputError as error:
        raise InputError.of_file(path, error) from None
    except Exception as error:  # of a damaged file numpy raises a dozen kinds, that of its tokenizer included
        raise InputError(
            f"{path}: file must hold plain NumPy arrays, got {str(error) or type(error).__name__}"
        ) from None
    if array.dtype.names:
        columns = {name: array[name] for name in array.dtype.names if array.dtype[name].kind in "fiuM"}
        return Table(path, "NumPy", columns)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: array must hold real numbers, got {array.dtype}")
    if array.ndim != 2 or not 2 <= array.shape[1] <= 12:
        raise InputError(f"{path}: array must have the shape (n, 2), or (n, 3) with the time first, got {array.shape}")
    return Table(path, "NumPy", {f"column_{i + 1}": np.array(array[:, i]) for i in range(array.shape[1])})
