"""Modal data from a NASTRAN normal-modes run, through pyNastran (extra ``nastran``).

Requirements on the run:

* the bulk data (BDF), in SI, in the units that ``PARAM,UNITSYS`` states, or with the option `units`;
  ``PARAM,WTMASS`` is read. Displacement coordinates (CD) are turned to the basic ones;
* ``SOL 103`` clamped at the parent by ``SPC1``: one grid point in all six components, as that at the centre of a ring
  of bolts (RBE2, RBE3), or the grid points of an :class:`~titop_plant.nastran.interface.Interface`;
  constraints elsewhere only of what has no stiffness;
* real eigenvectors of at least the ports (``DISPLACEMENT(PLOT)=ALL``), mass-normalised or with the table of
  eigenvalues that has their generalised masses;
* forces of single-point constraint of the interface (``SPCFORCES(PLOT)=ALL``): they give the participation. Without
  them it is the momentum of the deck's lumped masses, if the modes have all of them and are orthonormal with them
  (1 %), which shows that they are the masses of the run. So it is for modes that are no eigenvectors of the whole
  model, residual vectors (RESVEC) and those of an analysis set (ASET): other forces than those of the parent are left;
* ``PARAM,GRDPNT,0`` for the rigid mass matrix. Without it the masses of the BDF are summed: CONM and CMASS
  exactly, elements as points at their grid points, bars with ``PARAM,COUPMASS,1`` as slender rods with their polar
  inertia. A straight boom has no inertia about itself in lumped masses: the polar inertia of its bars is added;
* ``PARAM,POST,-1`` so that these results are in the OP2 file.

**Participation: L_k = -q_k / w_k^2**, with ``q_k`` the constraint force at the parent in mode k: the
sum of all inertia forces of the mode, whatever mass formulation the elements have.

Deck and OP2 must be of the same model: grid points, positions and mass are compared as far as the OP2 has them, and the
constraint forces with the momentum of the deck's masses in each mode, within 1 % for lumped masses of bars and points.

Without a statement the units are SI, and a deck without a Young's modulus from 1 GPa to 2 TPa is refused. In stated
units one must be from 1 MPa (rubber) to 10 TPa, and a density from 10 (foam) to 5e4 kg/m3. The grid point weight is in
the units of the input: ``WTMASS`` is applied to it, too.
``INCLUDE`` reads files in the folder of the deck and below it. Of several sets of SPC those count that the case control
names. Constraints of other grid points are accepted where no mode has a force or a motion in them.

Free-free modes are refused: cut off above, they lack the flexibility of the interface, and no number of the files tells
how much. Reduced matrices have it: :func:`~titop_plant.nastran.matrices.read_nastran_matrices`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.nastran.axes import to_basic
from titop_plant.nastran.deck import is_coupled, parameters_of, reduced_by
from titop_plant.nastran.files import (
    grid_positions,
    mass_normalisation,
    of_subcase,
    read_model,
    read_results,
    rows_of,
)
from titop_plant.nastran.interface import Interface, check_clamped, held_wrench
from titop_plant.nastran.mass import is_exact, mass_of_elements, momentum_maps, rigid_mass
from titop_plant.nastran.match import (
    EXACT_MOMENTUM,
    MASS,
    MOMENTUM,
    ORTHONORMAL,
    check_grids,
    check_mass,
    check_momentum,
    check_normalised,
    modal_masses,
    momentum_of,
)
from titop_plant.nastran.units import Units, units_of
from titop_plant.structures.kinematics import read_only
from titop_plant.structures.modal_data import ChildPort, ModalData
from titop_plant.structures.residual_mass import check_residual_mass

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: The OP2 file is in single precision: a residual negative by less than this fraction is a rounding error.
SINGLE_PRECISION = 1e-5
NO_FORCES = "file must contain forces of single-point constraint (SPCFORCES(PLOT)=ALL), got none"
NO_EIGENVECTORS = "modes must be eigenvectors of the whole model (RESVEC = NO, no ASET) for constraint forces, got {}"
FREE_BODY = 1e-9
"""Squares of frequencies, relative to the largest, that are those of rigid-body modes."""


class NastranOptions(TypedDict, total=False):
    """Further options of :func:`read_nastran`.

    Attributes
    ----------
    units : Units
        Of the deck, where ``PARAM,UNITSYS`` does not state them: "SI", "mm-t-s", "mm-kg-s", "inch-lbf-s",
        "ft-lbf-s", or factors (length [m], consistent mass [kg]).
    subcase : int
        Needed if the OP2 holds eigenvectors of several subcases.
    mass_matrix : array_like, shape (6, 6)
        Rigid mass matrix at P, in the units of the deck, that replaces the one computed from the files.
    """

    units: Units
    subcase: int | None
    mass_matrix: ArrayLike | None


def read_nastran(
    bdf: str | Path,
    op2: str | Path,
    *,
    name: str,
    parent: tuple[str, int] | Interface,
    ports: Mapping[str, int],
    damping: float | ArrayLike = 0.005,
    **options: Unpack[NastranOptions],
) -> ModalData:
    """Import a flexible body from a BDF and the OP2 of its clamped normal modes.

    Parameters
    ----------
    bdf, op2 : path
        Bulk data and results; the module docstring lists the required content.
    name : str
        Name of the body.
    parent : (str, int) or Interface
        Name and grid point of the clamped point P, such as ``("G", 1001)``; several clamped grid points as one rigid
        interface: ``Interface("G", (11, 12, 13))``.
    ports : mapping of str to int
        Names and grid points of the child ports.
    damping : float or array_like, shape (n,)
        Damping ratios.
    **options
        ``units``, ``subcase``, ``mass_matrix``: see :class:`NastranOptions`.

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
    TypeError
        Another option.
    ValueError
        Missing or invalid content of a file, or files of two models; the message names the file.
    """
    if unknown := sorted(set(options) - set(NastranOptions.__annotations__)):
        raise TypeError(f"option must be one of {list(NastranOptions.__annotations__)}, got {unknown[0]}")
    subcase, stated = options.get("subcase"), options.get("mass_matrix")
    deck, model = read_model(Path(bdf))
    units, interface = units_of(deck, model, Path(bdf), options.get("units")), Interface.of(parent)
    coupled, point = is_coupled(deck, model, Path(bdf)), interface.place(model, str(bdf))
    positions = grid_positions(model, ports, str(bdf))
    results = read_results(Path(op2))
    reduced = sorted(results.matrices)[:6]
    also = f", and matrices {reduced}: read_nastran_matrices takes them as text (DMIGPCH)" if reduced else ""
    table = of_subcase(results.eigenvectors, "real eigenvectors", str(op2), subcase, also)
    forces = None
    if results.spc_forces or coupled:
        forces = of_subcase(results.spc_forces, "forces of single-point constraint", str(op2), subcase)
        to_basic(model, forces, str(bdf))
    if parameters_of(deck, model, Path(bdf)).get("OUGCORD", "GLOBAL").upper() != "BASIC":
        to_basic(model, table, str(bdf))
    check_clamped(model, interface, table, forces, str(bdf), int(table.isubcase))
    squares = _squares(table, str(op2))
    scale = mass_normalisation(model, results, table, str(op2))[:, None]
    check_grids(model, results, table, str(op2))
    if forces is None or (approximate := reduced_by(deck, model)):
        asked = NO_FORCES if forces is None else NO_EIGENVECTORS.format(approximate)
        participation = _by_momentum(model, table, (scale, units.weight, point), f"{op2}: {asked}")
    else:
        participation = -scale * held_wrench(model, interface, forces, str(op2)) / squares[:, None]
    shapes = {port: scale * _port_rows(table, grid, str(op2), port) for port, grid in ports.items()}
    if stated is None:
        rigid = rigid_mass(model, results, point, str(bdf), coupled)
    else:
        rigid = read_only(stated, (6, 6), f"{name}: mass_matrix")
    rigid_body = participation / scale / units.weight, point, rigid[0, 0], scale * np.sqrt(units.weight)
    _check_same(model, results, table, rigid_body, (str(op2), coupled))
    root = np.sqrt(units.mass)
    data = ModalData(
        name,
        interface.name,
        units.length * point,
        rigid * units.weight * units.matrix_scale(),
        np.sqrt(squares),
        np.broadcast_to(damping, squares.shape),
        participation * root * units.by_axis(),
        tuple(
            ChildPort(port, units.length * positions[port], (shapes[port] / root / units.by_axis()).T) for port in ports
        ),
    )
    check_residual_mass(data, SINGLE_PRECISION)
    return data


def nastran_mass(bdf: str | Path, *, parent: tuple[str, int] | Interface, units: Units = None) -> FloatArray:
    """Rigid mass matrix of a deck alone, summed over its elements, to be compared with that of the model.

    Parameters
    ----------
    bdf : path
        Bulk data.
    parent : (str, int) or Interface
        As for :func:`read_nastran`.
    units : Units, optional
        As for :func:`read_nastran`.

    Returns
    -------
    ndarray, shape (6, 6)
        At P, in kg, kg m and kg m2; see :func:`~titop_plant.nastran.mass.momentum_maps`.

    Raises
    ------
    ImportError, FileNotFoundError, ValueError
        As :func:`read_nastran`.
    """
    deck, model = read_model(Path(bdf))
    deck_units = units_of(deck, model, Path(bdf), units)
    point = Interface.of(parent).place(model, str(bdf))
    mass = mass_of_elements(model, point, str(bdf), is_coupled(deck, model, Path(bdf)))
    return np.asarray(mass * deck_units.weight * deck_units.matrix_scale())


def _squares(table: Any, path: str) -> FloatArray:
    """Squares of the frequencies of a clamped body, shape (n,)."""
    squares = np.asarray(table.eigns, dtype=float)
    rigid = int(np.sum(squares <= FREE_BODY * squares.max(initial=0.0)))
    if rigid:
        raise InputError(
            f"{path}: eigenvalues of a clamped body must be positive, got {rigid} rigid-body modes or mechanisms "
            f"(least eigenvalue {squares.min():.3g} of up to {squares.max():.3g})"
        )
    return squares


def _port_rows(table: Any, grid: int, path: str, name: str) -> FloatArray:
    """Six components of a port in every mode, shape (n, 6).

    Raises
    ------
    ValueError
        A grid point that moves and does not turn: one of solid elements or rods, which give it no rotation.
    """
    rows = rows_of(table, grid, path, name)
    if np.any(rows[:, :3]) and not np.any(rows[:, 3:]):
        raise InputError(
            f"{path}: GRID {grid} ({name!r}) must turn with the structure (solid elements and rods turn no grid point: "
            "tie one to several by RBE2 or RBE3), got rotations of zero in all modes"
        )
    return rows


def _by_momentum(model: Any, table: Any, rigid_body: tuple[FloatArray, float, FloatArray], asked: str) -> FloatArray:
    """Participation by the momentum of the deck's lumped masses, shape (n, 6), if these are the masses of the run.

    Parameters
    ----------
    rigid_body : (ndarray of shape (n, 1), float, ndarray of shape (3,))
        Factors that normalise the modes, ``PARAM,WTMASS``, and P.
    asked : str
        Begin of the messages: why the forces of constraint do not give it.

    Raises
    ------
    ValueError
        The modes are not orthonormal with these masses, or lack grid points with mass.
    """
    scale, weight, point = rigid_body
    maps, unknown = momentum_maps(model, point, False)
    momentum = None if unknown else momentum_of(maps, table)
    if momentum is None:
        raise InputError(f"{asked}, and not the motion of all masses of the deck")
    products = weight * scale * modal_masses(model, maps, table, point) * scale.T
    worst = float(np.abs(products - np.eye(len(products))).max())
    if not worst <= ORTHONORMAL:
        raise InputError(f"{asked}, and the masses of the deck give products of the modes that miss I by {worst:.2g}")
    return np.asarray(scale * weight * momentum)


def _check_same(
    model: Any,
    results: Any,
    table: Any,
    rigid_body: tuple[FloatArray, FloatArray, float, FloatArray],
    files: tuple[str, bool],
) -> None:
    """Deck against OP2: mass by the grid point weight, momentum and norm of the modes where all mass is known."""
    (path, coupled), (participation, point, mass, scale) = files, rigid_body
    maps, unknown = momentum_maps(model, point, coupled)
    if unknown:
        return
    total = float(sum(by_velocity[0, 0] for by_velocity in maps.values()))
    for weight in results.grid_point_weight.values():
        check_mass(total, float(np.asarray(weight.MO)[0, 0]), path)
    if abs(total - mass) > MASS * mass or momentum_of(maps, table) is None:
        return
    exact = is_exact(model, coupled)
    check_momentum(maps, table, participation, path, EXACT_MOMENTUM if exact else MOMENTUM)
    lumped = momentum_maps(model, point, False)[0]
    check_normalised(scale * modal_masses(model, lumped, table, point) * scale.T, exact, path)
