"""Modal data from a NASTRAN normal-modes run, through pyNastran (extra ``nastran``).

Requirements on the run:

* the bulk data (BDF) in SI units or those that ``PARAM,UNITSYS`` states, basic displacement coordinates at the parent
  and the ports, no WTMASS; files that it includes in its folder;
* ``SOL 103`` clamped at **one grid point**, the parent, by ``SPC1,...,123456``, and nowhere else;
* mass-normalised real eigenvectors of at least the ports (``DISPLACEMENT(PLOT)=ALL``);
* forces of single-point constraint of the parent (``SPCFORCES(PLOT)=ALL``): they give the participation;
* ``PARAM,GRDPNT,0`` for the rigid mass matrix. Without it the masses of the BDF are summed: CONM2 exactly,
  bars as slender rods, other elements as points at their centroids;
* ``PARAM,POST,-1`` so that these results are in the OP2 file.

**Participation: L_k = -q_k / w_k^2**, with ``q_k`` the constraint force at the clamped point in mode k: the
sum of all inertia forces of the mode, whatever mass formulation the elements have.

Deck and OP2 must be of the same model: grid points, positions and mass are compared as far as the OP2 has them, and the
constraint forces with the momentum of the deck's masses in each mode.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import RESULTS
from titop_plant.structures.kinematics import read_only, tau
from titop_plant.structures.modal_data import ChildPort, ModalData
from titop_plant.structures.nastran_deck import DeckUnits, read_deck, units_of
from titop_plant.structures.nastran_match import MASS, check_grids, check_mass, check_momentum, lumps
from titop_plant.structures.residual_mass import check_residual_mass

#: The OP2 file is in single precision: a residual negative by less than this fraction is a rounding error.
SINGLE_PRECISION = 1e-5


def read_nastran(
    bdf: str | Path,
    op2: str | Path,
    *,
    name: str,
    parent: tuple[str, int],
    ports: Mapping[str, int],
    damping: float | ArrayLike = 0.005,
    subcase: int | None = None,
    mass_matrix: ArrayLike | None = None,
) -> ModalData:
    """Import a flexible body from a BDF and the OP2 of its clamped normal modes.

    Parameters
    ----------
    bdf, op2 : path
        Bulk data and results; the module docstring lists the required content.
    name : str
        Name of the body.
    parent : (str, int)
        Name and grid point of the clamped point P, such as ``("G", 1001)``.
    ports : mapping of str to int
        Names and grid points of the child ports.
    damping : float or array_like, shape (n,)
        Damping ratios.
    subcase : int, optional
        Needed if the OP2 holds eigenvectors of several subcases.
    mass_matrix : array_like, shape (6, 6), optional
        Rigid mass matrix at P, in the units of the deck, that replaces the one computed from the files.

    Returns
    -------
    ModalData
        In the basic coordinate system of the model, in SI units, with all modes of the file;
        :meth:`ModalData.truncate` keeps the first ones.

    Raises
    ------
    ImportError
        pyNastran is not installed.
    FileNotFoundError
        No such file.
    ValueError
        Missing or invalid content of a file, or files of two models; the message names the file.
    """
    model, units = _read_bdf(Path(bdf))
    grids = {parent[0]: parent[1], **ports}
    positions = _positions(model, grids, str(bdf))
    _check_clamped(model, parent[1], str(bdf))
    results = _read_op2(Path(op2))
    table = _of_subcase(results.eigenvectors, "real eigenvectors", str(op2), subcase)
    forces = _of_subcase(results.spc_forces, "forces of single-point constraint", str(op2), subcase)
    squares = np.asarray(table.eigns, dtype=float)
    scale = _mass_normalisation(results, squares.size)[:, None]
    if np.any(squares <= 0):
        raise ValueError(f"{op2}: eigenvalues of a clamped body must be positive, got {squares.min():.3g}")
    check_grids(model, results, table, str(op2))
    participation = -scale * _rows(forces, parent[1], str(op2), parent[0]) / squares[:, None]
    shapes = {port: scale * _rows(table, grid, str(op2), port) for port, grid in ports.items()}
    if mass_matrix is None:
        rigid = _mass_matrix(model, results, positions[parent[0]], str(bdf))
    else:
        rigid = read_only(mass_matrix, (6, 6), f"{name}: mass_matrix")
    _check_same(model, results, table, (participation / scale, positions[parent[0]], rigid[0, 0]), str(op2))
    length, mass = units.length, np.sqrt(units.mass)
    data = ModalData(
        name,
        parent[0],
        length * positions[parent[0]],
        rigid * units.mass * np.outer(*2 * [_by_axis(1.0, length)]),
        np.sqrt(squares),
        np.broadcast_to(damping, squares.shape),
        participation * mass * _by_axis(1.0, length),
        tuple(
            ChildPort(port, length * positions[port], (shapes[port] / mass / _by_axis(1.0, length)).T) for port in ports
        ),
    )
    check_residual_mass(data, SINGLE_PRECISION)
    return data


def _by_axis(translation: float, rotation: float) -> FloatArray:
    """Factors of the six components of a motion or a force, shape (6,)."""
    return np.repeat([translation, rotation], 3)


def _check_same(model: Any, results: Any, table: Any, found: tuple[FloatArray, FloatArray, float], path: str) -> None:
    """Deck against OP2: mass by the grid point weight, momentum of the modes where all mass is known."""
    known = lumps(model)
    if known is None:
        return
    participation, point, mass = found
    for weight in results.grid_point_weight.values():
        check_mass(known, float(np.asarray(weight.MO)[0, 0]), path)
    if abs(sum(lump[1] for lump in known) - mass) <= MASS * mass:
        check_momentum(model, known, table, participation, point, path)


def _pynastran() -> tuple[Any, Any]:
    try:
        from pyNastran.bdf.bdf import read_bdf
        from pyNastran.op2.op2 import read_op2
    except ModuleNotFoundError as error:
        raise ImportError(
            f"pyNastran must be installed to read NASTRAN files (pip install 'los-testbed[nastran]'), got {error}"
        ) from None
    return read_bdf, read_op2


def _read_bdf(path: Path) -> tuple[Any, DeckUnits]:
    reader = _pynastran()[0]
    try:
        deck = read_deck(path)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: BDF file must exist, got no such file as {error.filename}") from None
    try:
        model = reader(io.StringIO(deck.text), debug=None, punch=deck.punch)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # pyNastran raises many types
        raise ValueError(f"{path}: BDF must be readable by pyNastran, got {_one_line(error)}") from None
    return model, units_of(deck, model, path)


def _read_op2(path: Path) -> Any:
    try:
        check_file(path, RESULTS)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: OP2 file must exist, got no such file") from None
    try:
        return _pynastran()[1](str(path), debug=None)
    except (ImportError, MemoryError):
        raise
    except Exception as error:
        raise ValueError(f"{path}: OP2 must be readable by pyNastran, got {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) < 200 else text[:200] + "..."


def _positions(model: Any, grids: Mapping[str, int], path: str) -> dict[str, FloatArray]:
    positions = {}
    for name, grid in grids.items():
        node = model.nodes.get(grid)
        if node is None:
            raise ValueError(
                f"{path}: grid point of {name!r} must be one of the {len(model.nodes)} in the file, got GRID {grid}"
            )
        if node.Cd() != 0:
            raise ValueError(
                f"{path}: GRID {grid} ({name!r}) must have basic displacement coordinates (CD = 0), got {node.Cd()}"
            )
        positions[name] = read_only(node.get_position(), (3,), f"{path}: GRID {grid}")
    return positions


def _check_clamped(model: Any, parent: int, path: str) -> None:
    """Check that one grid point is clamped in all six directions and no other is constrained."""
    constrained: dict[int, set[str]] = {}
    for card in (card for cards in model.spcs.values() for card in cards):
        components = card.components
        each = [components] * len(card.nodes) if isinstance(components, str) else components
        for node, component in zip(_integers(card.nodes), each):
            constrained.setdefault(node, set()).update(str(component))
    for grid, node in model.nodes.items():
        if node.ps:
            constrained.setdefault(grid, set()).update(str(node.ps))
    if constrained.get(parent, set()) < set("123456"):
        got = "".join(sorted(constrained.get(parent, set()))) or "nothing"
        raise ValueError(f"{path}: the parent GRID {parent} must be clamped (SPC1 123456), got {got}")
    others = sorted(set(constrained) - {parent})
    if others:
        raise ValueError(f"{path}: SPC must be at the parent GRID {parent} alone, got SPC at {others[:5]} too")


def _integers(nodes: Iterable[Any]) -> list[int]:
    return [int(node) for node in nodes]


def _of_subcase(tables: Mapping[Any, Any], what: str, path: str, subcase: int | None) -> Any:
    """The table of a subcase; keys are a number, or tuples that begin with it."""
    found = {int(key[0] if isinstance(key, tuple) else key): table for key, table in tables.items()}
    if not found:
        raise ValueError(f"{path}: file must contain {what} (SOL 103 with output to OP2), got none")
    if subcase is None:
        if len(found) > 1:
            raise ValueError(f"{path}: subcase must be given, got {what} of subcases {sorted(found)}")
        return next(iter(found.values()))
    if subcase not in found:
        raise ValueError(f"{path}: subcase of {what} must be one of {sorted(found)}, got {subcase}")
    return found[subcase]


def _rows(table: Any, grid: int, path: str, name: str) -> FloatArray:
    """Six components at a grid point in every mode, shape (n, 6)."""
    index = np.flatnonzero(np.asarray(table.node_gridtype)[:, 0] == grid)
    if index.size != 1:
        raise ValueError(f"{path}: each mode must have one result row of GRID {grid} ({name!r}), got {index.size}")
    return np.asarray(table.data[:, index[0], :], dtype=float)


def _mass_normalisation(results: Any, n: int) -> FloatArray:
    """Factor on every mode that makes its modal mass 1, by the table of eigenvalues if there is one."""
    for table in results.eigenvalues.values():
        generalized = np.asarray(table.generalized_mass, dtype=float)
        if generalized.size == n and np.all(generalized > 0):
            return np.asarray(1.0 / np.sqrt(generalized))
    return np.ones(n)


def _mass_matrix(model: Any, results: Any, point: FloatArray, path: str) -> FloatArray:
    """Rigid mass matrix at the parent: grid point weight of the OP2, else the masses of the BDF."""
    for weight in results.grid_point_weight.values():
        reference = int(weight.reference_point)
        origin = np.asarray(model.nodes[reference].get_position()) if reference in model.nodes else np.zeros(3)
        shift = tau(origin, point)
        matrix = shift.T @ np.asarray(weight.MO, dtype=float) @ shift
        return np.asarray(0.5 * (matrix + matrix.T))
    found = _mass_of_elements(model, point, path)
    least = linalg.eigvalsh(found[3:, 3:])
    if found[0, 0] > 0 and least[0] <= 1e-9 * least[-1]:
        raise ValueError(
            f"{path}: mass must have inertia about every axis, got none about one: bars have none about their axis; "
            "a straight boom needs PARAM,GRDPNT,0 in the run, an inertia in a CONM2, or mass_matrix"
        )
    return found


def _mass_of_elements(model: Any, point: FloatArray, path: str) -> FloatArray:
    """Rigid mass matrix at a point, summed over CONM2 (with their inertia), slender bars and other elements."""
    total = np.zeros((6, 6))
    for lump in model.masses.values():
        if lump.type != "CONM2" or lump.Cid() != 0:
            raise ValueError(
                f"{path}: mass elements must be CONM2 in basic coordinates (or add PARAM,GRDPNT,0 to the run), "
                f"got {lump.type} {lump.eid}"
            )
        center, mass, inertia = lump.centroid_mass_inertia()  # a tensor, minus the products of the card
        total += _shifted(float(mass), np.asarray(inertia), np.asarray(center) - point)
    for element in model.elements.values():
        mass = float(element.Mass()) if hasattr(element, "Mass") else 0.0
        if mass == 0.0:
            continue
        inertia = np.zeros((3, 3))
        if element.type in ("CBAR", "CBEAM", "CROD", "CTUBE", "CONROD"):
            start, end = (np.asarray(node.get_position()) for node in element.nodes_ref)
            span = end - start
            inertia = mass / 12.0 * (span @ span * np.eye(3) - np.outer(span, span))
        total += _shifted(mass, inertia, np.asarray(element.center_of_mass()) - point)
    return total


def _shifted(mass: float, inertia: FloatArray, lever: FloatArray) -> FloatArray:
    shift = tau(lever, np.zeros(3))
    return np.asarray(shift.T @ linalg.block_diag(mass * np.eye(3), inertia) @ shift)
