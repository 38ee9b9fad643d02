"""Modal data from the reduced matrices of a NASTRAN superelement: DMIG in a punch file (extra ``nastran``).

``EXTSEOUT(STIFFNESS,MASS,DMIGPCH)`` writes the stiffness ``KAAX`` and the mass ``MAAX`` of a component reduced to the
grid points of ASET or BSET and, with component modes (QSET, SPOINT), to generalised coordinates: the reduction of
Craig and Bampton ("Coupling of Substructures for Dynamic Analyses", AIAA Journal 6(7), 1968) if its boundary is fixed,
of Guyan without component modes. The static shapes of the boundary are in the matrices, so the component may be free:
it is clamped here, and the modes that a run with SPC would have follow, truncated as the component modes are.

``PARAM,WTMASS`` is in the matrices already. Damping matrices (``BAAX``, ``K4AAX``) are not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.nastran.axes import displacement_axes
from titop_plant.nastran.files import grid_positions, read_model
from titop_plant.nastran.interface import Interface
from titop_plant.nastran.mass import check_rigid
from titop_plant.nastran.units import DeckUnits, Units, units_of
from titop_plant.ports import AXES
from titop_plant.structures.clamped_modes import FreeStructure, clamped_body
from titop_plant.structures.kinematics import tau
from titop_plant.structures.modal_data import ModalData
from titop_plant.structures.residual_mass import check_residual_mass

STIFFNESS, MASS = "KAAX", "MAAX"
"""Their names, if EXTSEOUT states no other suffix (DMIGSFIX)."""
RIGID = 1e-4
"""Largest force of a rigid motion, relative to those of its single coordinates."""

Coordinate = tuple[int, int]
"""Grid point and component 1 to 6; component 0 of a scalar point (generalised coordinate)."""


def read_nastran_matrices(
    punch: str | Path,
    bdf: str | Path,
    *,
    name: str,
    parent: tuple[str, int] | Interface,
    ports: Mapping[str, int],
    units: Units,
    damping: float | ArrayLike = 0.005,
    n_modes: int | None = None,
) -> ModalData:
    """Import a flexible body from reduced stiffness and mass matrices.

    Parameters
    ----------
    punch : path
        DMIG ``KAAX`` and ``MAAX``, or the one pair of another suffix; may be one file with `bdf`.
    bdf : path
        Positions of the grid points of the matrices.
    name : str
        Name of the body.
    parent : (str, int) or Interface
        As for :func:`~titop_plant.nastran.read_nastran`; of grid points in the matrices, without SPC.
    ports : mapping of str to int
        Names and grid points of the child ports, with six components in the matrices.
    units : Units
        Of the matrices, as for :func:`~titop_plant.nastran.read_nastran`; stated, since nothing in them tells.
    damping : float or array_like, shape (n,)
        Damping ratios.
    n_modes : int, optional
        Lowest modes to keep. Default: all; the highest are those of the reduction, not of the structure.

    Returns
    -------
    ModalData
        In the basic coordinate system of the model, in SI units. **The component is free but for P.**

    Raises
    ------
    ImportError
        pyNastran is not installed.
    FileNotFoundError
        No such file.
    ValueError
        No or incomplete matrices, a stiffness against rigid motions (a grounded component, other positions), or grid
        points that are not in the matrices; the message names the file.
    """
    path, interface = str(punch), Interface.of(parent)
    model = read_model(Path(punch))[1]
    deck, geometry = read_model(Path(bdf))
    stated = units_of(deck, geometry, Path(bdf), units)
    names = _names(model, path)
    coordinates = _coordinates(model, names, path)
    _check_known(interface, ports, coordinates, path)
    named = {f"{grid}": grid for grid, component in coordinates if component}
    positions = {int(key): place for key, place in grid_positions(geometry, named, str(bdf)).items()}
    point = interface.place(geometry, str(bdf))
    turn = _to_basic(geometry, coordinates, str(bdf))
    K, M = (turn.T @ _matrix(model.dmigs[key], coordinates, stated) @ turn for key in names)
    rigid = _rigid_motions(coordinates, {grid: stated.length * (place - point) for grid, place in positions.items()}, K)
    # Refuse a stiffness against rigid motions
    what = f"{path}: {names[0]}"
    forces, parts = np.abs(K @ rigid), np.abs(K) @ np.abs(rigid)
    share = forces.max(axis=0) / np.maximum(parts.max(axis=0), 1e-300)
    if share.max() > RIGID:
        axis = int(share.argmax())
        where = coordinates[int(forces[:, axis].argmax())]
        raise InputError(
            f"{what} must have no force for rigid motions, got {share[axis]:.2g} of those of single "
            f"coordinates in {AXES[axis]} at GRID {where[0]}: a grounded component, or positions of another one"
        )
    clamped = np.array([k for k, (grid, _) in enumerate(coordinates) if grid in interface.clamped])
    if linalg.svdvals(rigid[clamped] / np.maximum(1e-300, np.abs(rigid[clamped]).max(axis=0)))[-1] < 1e-6:
        got = {grid: "".join(str(one) for of, one in coordinates if of == grid) for grid in interface.clamped}
        raise InputError(f"{path}: interface must hold all six rigid motions, got {got} in the matrices")
    rows = {}
    for port, grid in ports.items():
        first = coordinates.index((grid, 1))
        rows[port] = stated.length * positions[grid], slice(first, first + 6)
    free = FreeStructure(name, M, K, rigid)
    place = (interface.name, stated.length * point)
    data = clamped_body(free, place, clamped, rows, n_modes, damping, massless=True)
    check_rigid(data.mass_matrix, path)
    check_residual_mass(data)
    return data


def _names(model: Any, path: str) -> tuple[str, str]:
    """Names of stiffness and mass: `STIFFNESS` and `MASS`, or those of the one other suffix (DMIGSFIX)."""
    known = set(model.dmigs)
    pairs = [(name, f"M{name[1:]}") for name in sorted(known) if name[0] == "K" and f"M{name[1:]}" in known]
    if (STIFFNESS, MASS) in pairs:
        return STIFFNESS, MASS
    if len(pairs) != 1:
        raise InputError(
            f"{path}: punch file must have DMIG {STIFFNESS} and {MASS} (EXTSEOUT(STIFFNESS,MASS,DMIGPCH)) or one pair "
            f"of another suffix, got {sorted(known) or 'none'}"
        )
    return pairs[0]


def _coordinates(model: Any, names: tuple[str, str], path: str) -> list[Coordinate]:
    """Coordinates of both matrices in ascending order."""
    coordinates: set[Coordinate] = set()
    for key in names:
        matrix = model.dmigs[key]
        if matrix.matrix_form not in (1, 6) or matrix.tin not in (1, 2):
            raise InputError(
                f"{path}: DMIG {key} must be real and square or symmetric (form 1 or 6, type 1 or 2), "
                f"got form {matrix.matrix_form}, type {matrix.tin}"
            )
        coordinates |= {(int(grid), int(one)) for grid, one in (*matrix.GCi, *matrix.GCj)}
    return sorted(coordinates)


def _matrix(matrix: Any, coordinates: list[Coordinate], units: DeckUnits) -> FloatArray:
    """A matrix in SI, shape (n, n); generalised coordinates keep their scale."""
    index = {coordinate: k for k, coordinate in enumerate(coordinates)}
    full = np.zeros((len(coordinates),) * 2)
    for row, column, value in zip(matrix.GCi, matrix.GCj, matrix.Real):
        i, j = index[int(row[0]), int(row[1])], index[int(column[0]), int(column[1])]
        full[i, j] = value
        if matrix.matrix_form == 6:
            full[j, i] = value
    by_unit = np.array([1.0 if 1 <= component <= 3 else units.length for _, component in coordinates])
    return np.asarray(units.mass * np.outer(by_unit, by_unit) * 0.5 * (full + full.T))


def _to_basic(geometry: Any, coordinates: list[Coordinate], path: str) -> FloatArray:
    """Coordinates of the matrices by those with basic displacement axes, shape (n, n).

    Raises
    ------
    ValueError
        A grid point with displacement axes of its own and one or two of three translations or rotations.
    """
    turn = np.eye(len(coordinates))
    index = {coordinate: k for k, coordinate in enumerate(coordinates)}
    for grid in {grid for grid, component in coordinates if component and geometry.nodes[grid].Cd() != 0}:
        axes = displacement_axes(geometry.nodes[grid], path)
        for three in ((1, 2, 3), (4, 5, 6)):
            there = [index[grid, one] for one in three if (grid, one) in index]
            if len(there) == 3:
                turn[np.ix_(there, there)] = axes
            elif there:
                raise InputError(
                    f"{path}: GRID {grid} must have all three translations or rotations in the matrices, since its "
                    f"displacement coordinates are CD {geometry.nodes[grid].Cd()}, got {len(there)}"
                )
    return turn


def _check_known(interface: Interface, ports: Mapping[str, int], coordinates: list[Coordinate], path: str) -> None:
    known = {grid for grid, component in coordinates if component}
    for label, grid in (*((interface.name, grid) for grid in interface.clamped), *ports.items()):
        if grid not in known:
            raise InputError(
                f"{path}: grid point of {label!r} must be one of the {len(known)} in the matrices "
                f"{sorted(known)[:12]} (ASET), got GRID {grid}"
            )
    for port, grid in ports.items():
        components = "".join(str(one) for of, one in coordinates if of == grid)
        if components != "123456":
            raise InputError(
                f"{path}: GRID {grid} ({port!r}) must have six components in the matrices, got {components}"
            )


def _rigid_motions(
    coordinates: list[Coordinate], levers: Mapping[int, FloatArray], stiffness: FloatArray
) -> FloatArray:
    """Coordinates for unit rigid motions about P, shape (n, 6); generalised ones follow without force."""
    physical = np.array([component > 0 for _, component in coordinates])
    rigid = np.zeros((len(coordinates), 6))
    for k, (grid, component) in enumerate(coordinates):
        if component:
            rigid[k] = tau(levers[grid], np.zeros(3))[component - 1]
    inner = stiffness[np.ix_(~physical, ~physical)]
    coupling = stiffness[np.ix_(~physical, physical)]
    if np.any(coupling):
        rigid[~physical] = -linalg.lstsq(inner, coupling @ rigid[physical])[0]
    return rigid
