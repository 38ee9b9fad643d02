"""Signals of a bag for other programs: MATLAB, NumPy, CSV and Parquet, with names and units.

In the first two each topic has a time axis of its own. The other two are one table: a row for each stamp of any topic,
empty (CSV), null (Parquet) where a topic has no sample. Time [s] counts from the first stamp of all topics that are
written; ``stamp_ns`` is the stamp itself. Lost samples have no row: a gap is seen in the time.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import NANO, Topic

ROWS = 20_000
"""Rows of a table that are in memory as text at a time."""
MAT_5_LIMIT = 2**31 - 1
"""Largest variable of a .mat file before version 7.3 [byte]."""
_USERBLOCK = 512  # of an HDF5 file that MATLAB takes for its own


@dataclass(frozen=True)
class TopicSignal:
    """Samples of one topic.

    Attributes
    ----------
    name : topic, without the namespace
    columns : (k,) names of the values
    units : (k,) their units
    stamp : (n,) [ns]
    time : (n,) [s]
    values : (n, k)
    """

    name: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    stamp: IntArray
    time: FloatArray
    values: FloatArray

    @property
    def heads(self) -> list[str]:
        """Names of the columns of a table, with topic and unit."""
        return [f"{self.name} {column} [{unit}]" for column, unit in zip(self.columns, self.units)]


def signals_of(run: Run, topics: Sequence[str] = ()) -> list[TopicSignal]:
    """Signals of a bag.

    Parameters
    ----------
    run : Run
    topics : sequence of str
        Without the namespace; default: all that have values.

    Raises
    ------
    BagError
        No such topic, or one that does not fit into the memory.
    """
    chosen = [run[name] for name in topics or run.topics]
    chosen = [topic for topic in chosen if len(topic)]
    first = min((int(topic.stamp[0]) for topic in chosen), default=0)
    return [_signal(topic, first) for topic in chosen]


def _signal(topic: Topic, first: int) -> TopicSignal:
    units = [unit.strip() for unit in topic.unit.split(",")]
    many = len(topic.columns) // len(units)
    each = tuple(units[min(k // many, len(units) - 1)] for k in range(len(topic.columns)))
    columns = tuple(column.removeprefix("vector.") for column in topic.columns)
    return TopicSignal(topic.name, columns, each, topic.stamp, (topic.stamp - first) / NANO, topic.values)


def write_signals(signals: Sequence[TopicSignal], path: Path, mat_version: str = "") -> None:
    """Write signals into a file, in the format of its suffix, whole or not at all.

    Parameters
    ----------
    signals : sequence of TopicSignal
    path : Path
        ``.mat``, ``.npz``, ``.csv`` or ``.parquet``.
    mat_version : {"", "5", "7.3"}
        Of a .mat file; default: 5, which SciPy and every MATLAB reads, and 7.3 where a variable is too large for it.

    Raises
    ------
    ValueError
        Another suffix, no signal, a package that is not installed, a variable too large for version 5.
    """
    large = max((s.values.nbytes for s in signals), default=0) > MAT_5_LIMIT
    if large and mat_version == "5":
        raise InputError(f"--mat-version must be 7.3 for variables of more than {MAT_5_LIMIT / 1e9:.1f} GB, got 5")
    writers = {
        ".mat": _mat_7_3 if large or mat_version == "7.3" else _mat_5,
        ".npz": _npz,
        ".csv": _csv,
        ".parquet": _parquet,
    }
    kind = check_format(path, mat_version)
    if not signals:
        raise InputError("topics must have messages with values, got none")
    with atomic_file(path) as temporary:
        writers[kind](signals, temporary)


FORMATS = (".mat", ".npz", ".csv", ".parquet")
MAT_VERSIONS = ("", "5", "7.3")


def check_format(path: Path, mat_version: str = "") -> str:
    """Format of a file, one of :data:`FORMATS`; one that cannot be written is refused before any work.

    Raises
    ------
    ValueError
        Another suffix or version, a package that is not installed.
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise InputError(f"--output must end with one of {', '.join(FORMATS)}, got {path.name}")
    if mat_version not in MAT_VERSIONS:
        raise InputError(f"--mat-version must be 5 or 7.3, got {mat_version}")
    if mat_version and kind != ".mat":
        raise InputError(f"--mat-version must be that of a .mat file, got {mat_version} for {path.name}")
    needed = {".parquet": ("pyarrow", "campaign")}.get(kind)
    if kind == ".mat" and mat_version == "7.3":
        needed = ("h5py", "hdf5")
    if needed is not None:
        _import(*needed)
    return kind


def _import(package: str, extra: str) -> Any:
    from importlib import import_module

    try:
        return import_module(package)
    except ImportError:
        raise InputError(f"{package} must be installed: pip install 'los-testbed[{extra}]'") from None


def _structures(signals: Sequence[TopicSignal]) -> dict[str, dict[str, Any]]:
    """A structure for each signal, by a name that MATLAB takes."""
    return {
        s.name.replace("/", "_"): {
            "topic": s.name,
            "time": s.time.reshape(-1, 1),
            "stamp_ns": s.stamp.reshape(-1, 1),
            "values": s.values,
            "columns": np.array(s.columns, dtype=object),
            "units": np.array(s.units, dtype=object),
        }
        for s in signals
    }


def _mat_5(signals: Sequence[TopicSignal], path: Path) -> None:
    from scipy.io import savemat

    savemat(str(path), _structures(signals), appendmat=False, do_compression=True, long_field_names=True)


def _mat_7_3(signals: Sequence[TopicSignal], path: Path) -> None:
    """An HDF5 file with the attributes and the first 512 bytes by which MATLAB knows its own."""
    h5py = _import("h5py", "hdf5")
    with h5py.File(path, "w", userblock_size=_USERBLOCK, libver=("earliest", "v110")) as file:
        references = file.create_group("#refs#")
        for name, fields in _structures(signals).items():
            group = file.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for field, value in fields.items():
                _write_field(group, field, value, references)
    text = f"MATLAB 7.3 MAT-file, Platform: Python, Created on: {datetime.datetime.now():%a %b %d %H:%M:%S %Y}"
    with path.open("r+b") as file:
        file.write(f"{text} HDF5 schema 1.00 .".ljust(124).encode("ascii") + b"\x00\x02IM")


def _write_field(group: Any, name: str, value: Any, references: Any) -> None:
    """A field of a structure: numbers (with the axes of MATLAB), a text, or a row of texts as a cell."""
    if isinstance(value, str):
        data = group.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
        data.attrs["MATLAB_class"], data.attrs["MATLAB_int_decode"] = np.bytes_("char"), np.int32(2)
        return
    if value.dtype == object:
        h5py = _import("h5py", "hdf5")
        cells = []
        for text in value:
            _write_field(references, f"c{len(references)}", text, references)
            cells.append([references[f"c{len(references) - 1}"].ref])
        data = group.create_dataset(name, data=np.array(cells, dtype=object), dtype=h5py.ref_dtype)
        data.attrs["MATLAB_class"] = np.bytes_("cell")
        return
    data = group.create_dataset(name, data=value.T, compression="gzip", shuffle=True)
    data.attrs["MATLAB_class"] = np.bytes_("int64" if value.dtype == np.int64 else "double")


def _npz(signals: Sequence[TopicSignal], path: Path) -> None:
    """Arrays by ``TOPIC``, ``TOPIC.time``, ``TOPIC.stamp_ns``, ``TOPIC.columns`` and ``TOPIC.units``."""
    arrays: dict[str, Any] = {}
    for s in signals:
        further = {"time": s.time, "stamp_ns": s.stamp, "columns": np.array(s.columns), "units": np.array(s.units)}
        arrays |= {s.name: s.values, **{f"{s.name}.{key}": value for key, value in further.items()}}
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _blocks(signals: Sequence[TopicSignal]) -> Iterator[tuple[FloatArray, list[FloatArray]]]:
    """Time and values of a table by blocks of rows; NaN where a topic has no sample."""
    stamps = np.unique(np.concatenate([s.stamp for s in signals]))
    time = (stamps - stamps[0]) / NANO
    places = [np.searchsorted(stamps, s.stamp) for s in signals]
    for low in range(0, len(time), ROWS):
        high = min(low + ROWS, len(time))
        columns: list[FloatArray] = []
        for s, rows in zip(signals, places):
            first, last = np.searchsorted(rows, (low, high))
            block = np.full((high - low, s.values.shape[1]), np.nan)
            block[rows[first:last] - low] = s.values[first:last]
            columns.append(block)
        yield time[low:high], columns


def _csv(signals: Sequence[TopicSignal], path: Path) -> None:
    heads = ["time [s]", *(head for s in signals for head in s.heads)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(heads) + "\n")
        for time, columns in _blocks(signals):
            for row in np.column_stack([time, *columns]).tolist():
                file.write(",".join("" if value != value else repr(value) for value in row) + "\n")


def _parquet(signals: Sequence[TopicSignal], path: Path) -> None:
    pyarrow = _import("pyarrow", "campaign")
    parquet = _import("pyarrow.parquet", "campaign")
    names = [(head, unit) for s in signals for head, unit in zip(s.heads, s.units)]
    fields = [pyarrow.field(head, pyarrow.float64(), metadata={"unit": unit}) for head, unit in names]
    schema = pyarrow.schema([pyarrow.field("time [s]", pyarrow.float64(), metadata={"unit": "s"}), *fields])
    with parquet.ParquetWriter(str(path), schema) as writer:
        for time, columns in _blocks(signals):
            values = np.column_stack([time, *columns])
            table = [pyarrow.array(column, mask=np.isnan(column)) for column in values.T]
            writer.write_table(pyarrow.Table.from_arrays(table, schema=schema))
