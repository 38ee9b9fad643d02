"""Tables in files of MATLAB and in HDF5: variables, structures and datasets as columns.

``save('los.mat', 't', 'los')`` writes version 5 or 7 (read with scipy), ``-v7.3`` HDF5 (h5py). A variable of two or
three columns is ``los.x, los.y, los.z``; fields of a structure and groups are joined by a point. The unit of a dataset
is its attribute ``unit`` or ``units``; of a variable, a text ``los_unit`` or ``unit`` beside it. A scalar ``fs`` or
``rate`` [Hz], or ``dt`` or ``Ts`` [s], is the sampling rate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError
from lftkit.support.input_limits import HDF5_DEPTH, HDF5_OBJECTS
from lftkit.support.mat_structure import check_mat
from pointing_analysis.read.tables.table import Gathered, Table, check_unpacked

DEEPEST = 8
"""Levels of structures and groups that are gone into."""
CELLS = 1000
"""Most cells of an array, and characters of each, that are looked at: names of units, not data."""
CLASSES = "objects of MATLAB classes (timetable, timeseries, table) are not read: save their arrays"
PACKED = ("scale_factor", "add_offset", "_FillValue", "missing_value")
"""Attributes of packed values, by the conventions of netCDF (CF, 8.1 and 2.5.1)."""
UNIT_KEYS = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")


def read_mat(path: Path) -> Table:
    """Arrays of a .mat file up to version 7.2.

    Raises
    ------
    InputError
        The file is damaged, unpacks to too much, or holds nothing but objects of MATLAB classes.
    """
    from scipy import io

    try:
        check_mat(path)
    except InputError as error:
        raise InputError(f"{path}: file must be a MATLAB file, got: {error}") from None
    try:
        sizes = [int(np.prod(shape, dtype=np.int64)) for _, shape, kind in io.whosmat(path) if kind != "object"]
        check_unpacked(path, 8 * sum(sizes))
        content = io.loadmat(path, squeeze_me=False, struct_as_record=True)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # of a damaged file scipy raises a dozen kinds
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: file must be a MATLAB file, got: {text}") from None
    gathered = Gathered()
    for name, value in content.items():
        if not name.startswith("__"):
            _add(gathered, name, value, 0)
    notes = [CLASSES] if "__function_workspace__" in content else []
    return _made(gathered, path, "MATLAB", notes)


def _add(table: Gathered, name: str, value: Any, depth: int) -> None:
    if depth > DEEPEST or not isinstance(value, np.ndarray) or value.size == 0:
        return
    if value.dtype.names:  # a structure; of an array of them the first
        for part in value.dtype.names:
            _add(table, f"{name}.{part}", value[part].reshape(-1)[0], depth + 1)
    elif value.dtype.kind == "U":
        table.add_setting(name, str(value.reshape(-1)[0]))
    elif value.dtype.kind != "O":
        table.add(name, value)
    else:
        _add_cells(table, name, {str(one.item()) for one in value.flat if np.size(one) == 1 and hasattr(one, "item")})


def _add_cells(gathered: Gathered, name: str, texts: set[str]) -> None:
    """Texts of a cell array, which is a setting where it has the same for each column."""
    if len(texts) == 1:
        gathered.add_setting(name, texts.pop())


def read_hdf5(path: Path) -> Table:
    """Datasets of an HDF5 file, also of a .mat file of version 7.3. Nothing outside of the file is read.

    Raises
    ------
    InputError
        h5py is not installed, the file is damaged or unpacks to too much, or no dataset can be used.
    """
    try:
        import h5py
    except ModuleNotFoundError:
        raise InputError(f"{path}: h5py must be installed: pip install 'los-testbed[hdf5]'") from None
    gathered, notes = Gathered(), dict[str, None]()
    try:
        with h5py.File(path, "r") as file:
            matlab = path.suffix.lower() == ".mat"
            datasets, groups = _datasets(file, h5py, notes)
            check_unpacked(path, sum(d.size * d.dtype.itemsize for _, d in datasets))
            for name, group in groups:
                _add_attributes(gathered, name, group.attrs)
            for name, dataset in datasets:
                _add_dataset(gathered, name, dataset)
    except MemoryError:
        raise
    except InputError as error:
        raise InputError.of_file(path, error) from None
    except Exception as error:  # of a damaged file h5py raises a dozen kinds
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: file must be HDF5, got: {text}") from None
    return _made(gathered, path, "MATLAB 7.3" if matlab else "HDF5", list(notes))


def _datasets(file: Any, h5py: Any, notes: dict[str, None]) -> tuple[list[tuple[str, Any]], list[tuple[str, Any]]]:
    """Datasets by name, without links to other files, and the groups that they are in, the file as the first."""
    items: list[tuple[str, Any]] = []
    waiting: list[tuple[str, Any]] = [("", file)]
    seen: set[Any] = set()
    for prefix, group in waiting:  # grows while it is gone through
        depth = prefix.count("/")
        if depth > HDF5_DEPTH:
            raise InputError(f"file must have groups of at most {HDF5_DEPTH} levels, got more")
        for key in group:
            if len(seen) >= HDF5_OBJECTS:
                raise InputError(f"file must have at most {HDF5_OBJECTS} groups and datasets, got more")
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue  # a link by name may lead anywhere
            name, item = prefix + key, group[key]
            info = h5py.h5o.get_info(item.id)
            if (place := (info.fileno, info.addr)) in seen:
                continue
            seen.add(place)
            if name.startswith("#"):  # what MATLAB keeps of objects and cells
                if name.startswith("#subsystem#"):
                    notes[CLASSES] = None
            elif isinstance(item, h5py.Group):
                waiting.append((name + "/", item))
            elif isinstance(item, h5py.Dataset) and item.shape is not None:
                if item.external or item.is_virtual:
                    notes[f"{name}: its values are in another file, which is not read"] = None
                elif depth <= DEEPEST:
                    items.append((name.replace("/", "."), item))
    groups = [(prefix.rstrip("/").replace("/", "."), group) for prefix, group in waiting]
    return sorted(items, key=lambda pair: pair[0].split(".")), groups


def _add_dataset(gathered: Gathered, name: str, dataset: Any) -> None:
    kind = _text(dataset.attrs.get("MATLAB_class", ""))
    if kind == "char":
        gathered.add_setting(name, _characters(dataset))
        return
    if kind == "cell":
        cells = [dataset.file[one] for one in dataset[()].flat if one] if dataset.size <= CELLS else []
        texts = [one for one in cells if _text(one.attrs.get("MATLAB_class", "")) == "char" and one.size <= CELLS]
        _add_cells(gathered, name, {_characters(one) for one in texts})
        return
    _add_attributes(gathered, name, dataset.attrs)
    if dataset.dtype.kind in "OSU":
        if dataset.size == 1:
            gathered.add_setting(name, _text(np.asarray(dataset[()]).reshape(-1)[0]))
        return
    if dataset.dtype.kind in "fiucMV" and "MATLAB_empty" not in dataset.attrs:
        gathered.add(name, _values(dataset))


def _characters(dataset: Any) -> str:
    """Text of a dataset of MATLAB: the numbers of its characters."""
    return "".join(map(chr, np.asarray(dataset[()], dtype=np.uint16).reshape(-1).tolist()))


def _values(dataset: Any) -> NDArray[Any]:
    """Values of a dataset; packed ones (``scale_factor``, ``add_offset``, ``_FillValue`` of netCDF) are unpacked."""
    values = np.asarray(dataset[()])
    packing = {key: np.asarray(dataset.attrs[key]) for key in PACKED if key in dataset.attrs}
    one = {key: value.reshape(-1)[0] for key, value in packing.items() if value.size == 1 and value.dtype.kind in "fiu"}
    if not one or values.dtype.kind not in "fiu":
        return values
    missing = np.isin(values, [one[key] for key in PACKED[2:] if key in one])
    scale, offset = float(one.get("scale_factor", 1.0)), float(one.get("add_offset", 0.0))
    if not missing.any() and (scale, offset) == (1.0, 0.0):
        return values  # as they are: stamps of whole nanoseconds among them
    return np.where(missing, np.nan, values * scale + offset)


def _add_attributes(gathered: Gathered, name: str, attributes: Any) -> None:
    """Unit and rate that attributes of a dataset or of the file say."""
    for key in attributes:
        try:
            value = np.asarray(attributes[key])
        except (OSError, TypeError, ValueError):
            continue
        if value.size != 1:
            continue
        if key in UNIT_KEYS:
            gathered.add_unit(name, _text(value.reshape(-1)[0]))
        elif value.dtype.kind in "fiu":
            gathered.add_setting(f"{name}.{key}" if name else key, value)


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _made(gathered: Gathered, path: Path, kind: str, notes: list[str]) -> Table:
    table = gathered.table(path, kind, notes)
    if not table.columns:
        advice = f" ({table.left_out[0]})" if table.left_out else ""
        raise InputError(f"{path}: file must hold arrays of numbers with 2 or more rows, got none{advice}")
    return table
