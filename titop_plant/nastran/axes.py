"""Displacement coordinates of grid points (CD), rectangular, cylindrical and spherical, and the basic ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lftkit.arrays import FloatArray
from lftkit.errors import InputError

ON_AXIS = 1e-9
"""Distance from the axis, relative to that from the origin, at which cylindrical and spherical axes do not exist."""


def displacement_axes(node: Any, path: str) -> FloatArray:
    """Axes of the displacements of a grid point as rows, shape (3, 3): **v_displacement = axes @ v_basic**.

    Parameters
    ----------
    node : object
        pyNastran's GRID; its CD may be rectangular, cylindrical (r, theta, z) or spherical (r, theta, phi).
    path : str
        Of the deck, for messages.

    Raises
    ------
    ValueError
        A grid point on the axis of its cylindrical or spherical coordinates, or coordinates that are not understood.
    """
    if node.Cd() in (0, -1):  # -1: of a fluid, with a pressure
        return np.eye(3)
    system = node.cd_ref
    rows = np.asarray(system.beta(), dtype=float)
    kind = system.type[-1]
    if kind == "R":
        return rows
    x, y, z = rows @ (np.asarray(node.get_position(), dtype=float) - np.asarray(system.origin, dtype=float))
    across, whole = float(np.hypot(x, y)), float(np.sqrt(x * x + y * y + z * z))
    if kind not in "CS" or across <= ON_AXIS * max(whole, 1e-300):
        raise InputError(
            f"{path}: GRID {node.nid} must have displacement coordinates that exist there, got CD {node.Cd()} "
            f"({system.type}) at its axis"
        )
    c, s = x / across, y / across
    around = np.array([-s, c, 0.0])
    if kind == "C":
        return np.asarray(np.array([[c, s, 0.0], around, [0.0, 0.0, 1.0]]) @ rows)
    cosine, sine = z / whole, across / whole
    return np.asarray(np.array([[sine * c, sine * s, cosine], [cosine * c, cosine * s, -sine], around]) @ rows)


def six_axes(node: Any, path: str) -> FloatArray:
    """The same of translation and rotation, shape (6, 6)."""
    axes = displacement_axes(node, path)
    return np.asarray(block_diag(axes, axes), dtype=float)


def to_basic(model: Any, table: Any, path: str) -> None:
    """Turn the rows of a table of motions or forces (modes, grid points, 6) to the basic coordinates, in place."""
    for k, grid in enumerate(np.asarray(table.node_gridtype)[:, 0].tolist()):
        node = model.nodes.get(int(grid))
        if node is not None and node.Cd() != 0:
            table.data[:, k, :] = table.data[:, k, :] @ six_axes(node, path)
