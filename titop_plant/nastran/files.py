"""BDF and OP2 files through pyNastran, and the tables of an OP2 that a modal reduction takes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import RESULTS
from titop_plant.nastran.deck import Deck, read_deck

SAME_VALUE = 1e-3
"""Largest relative difference of eigenvalues of two tables that are those of one mode."""
KINDS = {b"\x89HDF": "an HDF5 file", b"PK\x03\x04": "a zip file", b"\x1f\x8b": "a gzip file"}


def _pynastran() -> tuple[Any, Any]:
    try:
        from pyNastran.bdf.bdf import read_bdf
        from pyNastran.op2.op2 import read_op2
    except ModuleNotFoundError as error:
        raise ImportError(
            f"pyNastran must be installed to read NASTRAN files (pip install 'los-testbed[nastran]'), got {error}"
        ) from None
    return read_bdf, read_op2


def read_model(path: Path) -> tuple[Deck, Any]:
    """A deck as text and as pyNastran's model.

    Raises
    ------
    ImportError
        pyNastran is not installed.
    FileNotFoundError
        No such file.
    ValueError
        Not readable; the message names the file.
    """
    reader = _pynastran()[0]
    try:
        deck = read_deck(path)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: BDF file must exist, got no such file as {error.filename}") from None
    try:
        with _quiet():
            model = reader(io.StringIO(deck.text), debug=None, punch=deck.punch)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # pyNastran raises many types
        raise InputError(f"{path}: BDF must be readable by pyNastran, got {_one_line(error)}") from None
    defaults = model.grdset
    if defaults is not None and (defaults.Cp() or defaults.Cd() or defaults.ps not in ("", "0", 0, None)):
        raise InputError(
            f"{path}: GRDSET must have no CP, CD and PS (state them on each GRID), got CP {defaults.Cp()}, "
            f"CD {defaults.Cd()}, PS {defaults.ps or 'none'}"
        )
    return deck, model


def read_results(path: Path) -> Any:
    """An OP2 file as pyNastran's tables.

    Raises
    ------
    ImportError, FileNotFoundError, ValueError
        As :func:`read_model`.
    """
    try:
        check_file(path, RESULTS)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: OP2 file must exist, got no such file") from None
    with path.open("rb") as file:
        head = file.read(64)
    kind = next((name for start, name in KINDS.items() if head.startswith(start)), None)
    if head and not kind and all(byte in b"\t\r\n\f" or 32 <= byte < 127 for byte in head):
        kind = "text, as F06 and punch files"
    if kind:
        raise InputError(f"{path}: OP2 must be readable by pyNastran (PARAM,POST,-1 writes it), got {kind}")
    reader = _pynastran()[1]
    try:
        with _quiet():
            return reader(str(path), debug=None)
    except (ImportError, MemoryError):
        raise
    except Exception as error:
        raise InputError(f"{path}: OP2 must be readable by pyNastran, got {_one_line(error)}") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what pyNastran prints of a file that it cannot read; the error has its reason."""
    with io.StringIO() as text, redirect_stdout(text), redirect_stderr(text):
        yield


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) < 200 else text[:200] + "..."


def of_subcase(tables: Mapping[Any, Any], what: str, path: str, subcase: int | None, also: str = "") -> Any:
    """The table of a subcase; keys are a number, or tuples that begin with it. `also`: what the file has, if not it.

    Raises
    ------
    ValueError
        No table, several without `subcase`, or none of this subcase.
    """
    numbers = [int(key[0] if isinstance(key, tuple) else key) for key in tables]
    by_subcase = dict(zip(numbers, tables.values()))
    if len(by_subcase) < len(numbers):
        twice = max(by_subcase, key=numbers.count)
        raise InputError(
            f"{path}: file must contain {what} once for each subcase, got {numbers.count(twice)} tables of subcase "
            f"{twice} (superelements, or runs that were appended)"
        )
    if not by_subcase:
        raise InputError(f"{path}: file must contain {what} (SOL 103 with output to OP2), got none{also}")
    if subcase is None:
        if len(by_subcase) > 1:
            raise InputError(f"{path}: subcase must be given, got {what} of subcases {sorted(by_subcase)}")
        return next(iter(by_subcase.values()))
    if subcase not in by_subcase:
        raise InputError(f"{path}: subcase of {what} must be one of {sorted(by_subcase)}, got {subcase}")
    return by_subcase[subcase]


def rows_of(table: Any, grid: int, path: str, name: str) -> FloatArray:
    """Six components at a grid point in every mode, shape (n, 6).

    Raises
    ------
    ValueError
        Not one row of this grid point in each mode.
    """
    index = np.flatnonzero(np.asarray(table.node_gridtype)[:, 0] == grid)
    if index.size != 1:
        raise InputError(f"{path}: each mode must have one result row of GRID {grid} ({name!r}), got {index.size}")
    return np.asarray(table.data[:, index[0], :], dtype=float)


def mass_normalisation(model: Any, results: Any, table: Any, path: str) -> FloatArray:
    """Factor on every mode that makes its modal mass 1, by the table of eigenvalues if there is one; shape (n,).

    Raises
    ------
    ValueError
        No table has these modes, and the deck asks for another normalisation than that of unit masses.
    """
    squares = np.asarray(table.eigns, dtype=float)
    numbers = np.asarray(table.modes, dtype=int)
    for stated in results.eigenvalues.values():
        row = {int(mode): k for k, mode in enumerate(np.asarray(stated.mode))}
        rows = [row[mode] for mode in numbers.tolist() if mode in row]
        generalized = np.asarray(stated.generalized_mass, dtype=float)[rows]
        values = np.asarray(stated.eigenvalues, dtype=float)[rows]
        if len(rows) == squares.size and np.allclose(values, squares, rtol=SAME_VALUE) and np.all(generalized > 0):
            return np.asarray(1.0 / np.sqrt(generalized))
    for card in model.methods.values():
        if str(getattr(card, "norm", None) or "MASS").upper() != "MASS":
            raise InputError(
                f"{path}: file must contain the table of eigenvalues of these modes with their generalised masses, got "
                f"none and {card.type} {card.sid} with NORM {card.norm}"
            )
    return np.ones(squares.size)


def grid_positions(model: Any, grids: Mapping[str, int], path: str) -> dict[str, FloatArray]:
    """Positions (3,) of grid points in the basic coordinates, in the units of the deck.

    Raises
    ------
    ValueError
        Not in the deck, or not finite.
    """
    positions = {}
    for name, grid in grids.items():
        node = model.nodes.get(grid)
        if node is None:
            raise InputError(
                f"{path}: grid point of {name!r} must be one of the {len(model.nodes)} in the file, got GRID {grid}"
            )
        positions[name] = np.asarray(node.get_position(), dtype=float)
        if not np.all(np.isfinite(positions[name])):
            raise InputError(f"{path}: GRID {grid} must have a finite position, got {positions[name].tolist()}")
    return positions
