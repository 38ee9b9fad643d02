"""Sources of disturbance from files: ``--disturbance FILE[@PLACE]``, and ``[[disturbance]]`` of a TOML file.

A TOML file has any number of tables ``[[disturbance]]``; a table of values (CSV, Parquet, .mat, HDF5, NumPy) is one
source, whose kind follows from its columns: times are a series, orders the harmonics of a wheel, speeds and frequencies
a waterfall, frequencies alone a power spectral density.

The keys of each kind are the fields of its class in :mod:`titop_plant.disturbances.source_kinds`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import TABLE
from los_testbed.config.run_config import RunConfig
from pointing_analysis.files.settings import written
from pointing_analysis.files.structured_text import load_toml, read_text
from pointing_analysis.read.tables.los_table import read_table
from pointing_analysis.read.tables.table import Table, split_unit
from titop_plant.disturbances.source_kinds import FREQUENCIES, KINDS, DisturbanceTable, RunConditions
from titop_plant.telescope.load import FOLDER

if TYPE_CHECKING:
    from titop_plant.disturbances.sources import PlacedSource
    from titop_plant.telescope.telescope import Telescope


def entries_of(items: Sequence[str]) -> list[DisturbanceTable]:
    """Tables of the files that options ``--disturbance`` name.

    Raises
    ------
    ValueError
        A file that cannot be read or holds no source.
    """
    entries = []
    for item in items:
        name, _, place = item.partition("@")
        path = Path(name)
        if path.suffix.lower() == ".toml":
            if place:
                raise InputError(f"place must be given in the file {path}, got {item!r}")
            entries += entries_in(path, _toml(path))
        else:
            table: dict[str, Any] = {"name": path.stem, "file": path.name, **({"place": place} if place else {})}
            table["kind"] = _kind_of(read_table(path))
            entries.append(DisturbanceTable(table, path.parent, str(path)))
    return entries


def sources_of(config: RunConfig, telescope: Telescope) -> list[DisturbanceTable]:
    """Tables of all sources of a run: those of its files, then those of its telescope; none without disturbance."""
    if not config.disturbance or config.other_plant:
        return []
    of_telescope = [DisturbanceTable(table, Path(table[FOLDER]), str(config.parameters)) for table in telescope.sources]
    of_telescope = [replace(one, table={k: v for k, v in one.table.items() if k != FOLDER}) for one in of_telescope]
    return entries_of(config.files_of_disturbance) + of_telescope


def entries_in(path: Path, content: Mapping[str, Any]) -> list[DisturbanceTable]:
    """Tables ``[[disturbance]]`` of a file that was read."""
    tables = content.get("disturbance")
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{path} must hold tables [[disturbance]], got none")
    return [DisturbanceTable(table, path.parent, str(path)) for table in tables]


def _toml(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = load_toml(read_text(path), path)
    return content


def _kind_of(table: Table) -> str:
    names = {split_unit(name)[0].lower() for name in (*table.columns, *table.texts)}
    if names & {"order", "harmonic"}:
        return "harmonics"
    if names & set(FREQUENCIES) and "time" not in names:
        return "waterfall" if "speed" in names else "psd"
    return "series"


def digest(entries: Sequence[DisturbanceTable], mechanisms: Sequence[tuple[str, Mapping[str, Any]]] = ()) -> str:
    """SHA-256 of the tables, of the files that they name, and of those of the telescope's wheels and drives."""
    total = hashlib.sha256()
    for name, table in mechanisms:
        total.update(repr((name, sorted(table.items()))).encode())
    for entry in entries:
        total.update(repr(sorted(entry.table.items())).encode())
        if isinstance(entry.table.get("file"), str):
            total.update(read_bytes(entry.folder / entry.table["file"], TABLE))
    return total.hexdigest()


def make_sources(
    entries: Sequence[DisturbanceTable], telescope: Telescope, run: RunConditions
) -> tuple[PlacedSource, ...]:
    """Sources of a run.

    Raises
    ------
    ValueError
        An unknown key, kind or place, a value that does not fit, a file that cannot be used; in one line.
    """
    names = [str(entry.table.get("name", "")) for entry in entries]
    if len(set(names)) < len(names):
        files = ", ".join(dict.fromkeys(entry.where for entry in entries))
        raise InputError(f"{files}: disturbances must have different names, got {', '.join(names)}")
    sources = tuple(_source(entry, telescope, run) for entry in entries)
    driven = [one.place for one in sources if one.limit < math.inf]
    for place in sorted({place for place in driven if driven.count(place) > 1}):
        raise InputError(f"actuator {place} must have one source, got {driven.count(place)}")
    return sources


def _source(entry: DisturbanceTable, telescope: Telescope, run: RunConditions) -> PlacedSource:
    from titop_plant.disturbances.places import place_matrix
    from titop_plant.disturbances.sources import PlacedSource

    kind = entry.table.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise entry.error(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    entry = replace(entry)  # without the remarks of an earlier run
    source = entry.made(KINDS[kind])
    if not source.name:
        raise entry.error("name must be a text that is not empty, got ''")
    place, offset = source.place, None if source.offset is None else np.array(source.offset)
    try:
        matrix = place_matrix(place, telescope, _frame(source.frame), offset)
    except ValueError as error:
        raise entry.error(str(error)) from None
    signal, remarks = source.make(entry, run)
    limits = {one.name: one.authority for one in telescope.placed_actuators}
    limit = limits[place] / max(abs(source.scale), 1e-300) if place in limits else math.inf
    return PlacedSource(source.name, kind, place, source.scale * matrix, signal, (*entry.ignored(), *remarks), limit)


def _frame(frame: Any) -> FloatArray | None:
    if frame == "own":
        return None
    try:
        return np.eye(3) if frame == "body" else np.array(frame, dtype=float)
    except (ValueError, TypeError):
        raise InputError(f"frame must be own, body or three rows of three numbers, got {written(frame)}") from None
