"""Whether a NASTRAN deck and an OP2 file are of the same model: grid points, positions, mass, momentum of the modes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.structures.kinematics import tau

MASS = 0.02
"""Largest difference of the masses, relative; elements of some kinds differ by their rounding and offsets."""
POSITION = 1e-4
"""Largest difference of positions, relative to the size of the model; the OP2 file is in single precision."""
MOMENTUM = 0.25
"""Largest difference of the participation, relative; the masses of elements are taken at their grid points."""
EXACT_MOMENTUM = 0.01
"""The same where the masses of the deck are those of the run: point masses, and bars with half at each end."""
ORTHONORMAL = 0.01
"""Largest error of the products of the modes with masses of the deck that are those of the run."""


def check_grids(model: Any, results: Any, table: Any, path: str) -> None:
    """Refuse results at grid points that the deck does not have, or that are elsewhere.

    Raises
    ------
    ValueError
        The OP2 file is of another model.
    """
    known = {*model.nodes, *model.spoints, *model.epoints}
    rows = {int(grid) for grid in np.asarray(table.node_gridtype)[:, 0]}
    if others := sorted(rows - known):
        raise InputError(
            f"{path}: results must be of the model of the deck, got {len(others)} unknown grid points: {others[:5]}"
        )
    stated = getattr(getattr(results, "op2_results", None), "gpdt", None)
    if stated is None:
        return
    numbers, xyz = np.asarray(stated.nid_cp_cd_ps), np.asarray(stated.xyz, dtype=float)
    grids = {int(row[0]): place for row, place in zip(numbers, xyz) if row[1] == 0 and int(row[0]) in model.nodes}
    if missing := sorted(set(model.nodes) - {int(row[0]) for row in numbers}):
        raise InputError(f"{path}: grid points must be those of the deck, got none with the numbers {missing[:5]}")
    ours = {grid: np.asarray(model.nodes[grid].get_position(), dtype=float) for grid in grids}
    size = max((float(np.abs(place).max()) for place in ours.values()), default=0.0)
    for grid, place in grids.items():
        if np.abs(place - ours[grid]).max() > POSITION * size:
            raise InputError(
                f"{path}: GRID {grid} must be where the deck has it, at {ours[grid].tolist()}, got {place.tolist()}"
            )


def check_mass(total: float, stated: float, path: str) -> None:
    """Refuse a mass of the OP2 file that the deck has not.

    Raises
    ------
    ValueError
        They differ by more than `MASS`.
    """
    if abs(total - stated) > MASS * max(total, stated):
        raise InputError(
            f"{path}: results must be of the model of the deck, whose mass is {total:.6g}, got a mass of {stated:.6g}"
        )


def momentum_of(maps: Mapping[int, FloatArray], table: Any) -> FloatArray | None:
    """Momentum of the deck's masses in each mode, shape (n, 6); None where the modes lack a grid point with mass.

    Parameters
    ----------
    maps, table
        As for :func:`check_momentum`.
    """
    rows = {int(grid): row for row, grid in enumerate(np.asarray(table.node_gridtype)[:, 0])}
    if not maps or any(grid not in rows for grid in maps):
        return None
    shapes = np.asarray(table.data, dtype=float)
    return np.asarray(sum(shapes[:, rows[grid]] @ by_velocity.T for grid, by_velocity in maps.items()))


def modal_masses(model: Any, maps: Mapping[int, FloatArray], table: Any, point: FloatArray) -> FloatArray:
    """Products of the modes with the masses of a deck at its grid points, shape (n, n): I for the masses of the run.

    Parameters
    ----------
    model : object
    maps : mapping of int to ndarray, shape (6, 6)
        Of lumped masses, about `point`; the modes have all their grid points.
    table : object
        Eigenvectors.
    point : ndarray, shape (3,)
    """
    rows = {int(grid): row for row, grid in enumerate(np.asarray(table.node_gridtype)[:, 0])}
    shapes = np.asarray(table.data, dtype=float)
    total = np.zeros((len(shapes), len(shapes)))
    for grid, by_velocity in maps.items():
        mass = tau(point, np.asarray(model.nodes[grid].get_position(), dtype=float)).T @ by_velocity
        total += shapes[:, rows[grid]] @ mass @ shapes[:, rows[grid]].T
    return total


def check_normalised(products: FloatArray, exact: bool, path: str) -> None:
    """Refuse modes that are not orthonormal with the masses of the deck.

    Parameters
    ----------
    products : ndarray, shape (n, n)
        Of :func:`modal_masses`, normalised and in the unit of mass of the run.
    exact : bool
        These masses are those of the run. Else the median of the squares is compared alone, within a factor of 2.

    Raises
    ------
    ValueError
        Other modes: the file has another normalisation without its generalised masses, or is of another model.
    """
    worst = float(np.abs(products - np.eye(len(products))).max())
    if not (worst <= ORTHONORMAL if exact else 0.5 <= np.median(np.diag(products)) <= 2.0):
        raise InputError(
            f"{path}: results must be of the model of the deck, with modes of unit generalised mass (NORM MASS) or the "
            f"table of eigenvalues, got products of the modes with its masses that miss I by {worst:.2g}"
        )


def check_momentum(
    maps: Mapping[int, FloatArray], table: Any, participation: FloatArray, path: str, largest: float = MOMENTUM
) -> None:
    """Compare what holds a mode at the clamped point with the momentum of the deck's masses in its shape.

    Parameters
    ----------
    maps : mapping of int to ndarray, shape (6, 6)
        Of :func:`~titop_plant.nastran.mass.momentum_maps`, about the clamped point.
    table : object
        Eigenvectors; where they lack a grid point with mass, nothing is compared.
    participation : ndarray, shape (n, 6)
        Of the constraint forces, in the modal scale of `table` and the mass unit of the maps.
    largest : float
        Largest relative difference.

    Raises
    ------
    ValueError
        They differ by more: the OP2 file is of another model, or the parent does not hold the body alone.
    """
    momentum = momentum_of(maps, table)
    if momentum is None:
        return
    for part, name in ((slice(0, 3), "forces"), (slice(3, 6), "moments")):
        held, has = participation[:, part], momentum[:, part]
        size = max(float(linalg.norm(held)), float(linalg.norm(has)))
        if linalg.norm(held - has) > largest * size:
            raise InputError(
                f"{path}: results must be of the model of the deck, held by its parent alone and without residual "
                f"vectors (RESVEC = NO), got {name} of constraint that differ from the momentum of its masses by "
                f"{100 * linalg.norm(held - has) / size:.2g} %"
            )
