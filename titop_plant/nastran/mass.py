"""Mass of a NASTRAN deck: concentrated masses, bars and other elements, and the grid point weight of an OP2.

All are in the units in which the deck states masses, before ``PARAM,WTMASS``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.nastran.axes import displacement_axes, six_axes
from titop_plant.structures.kinematics import skew, tau

BARS = ("CBAR", "CBEAM", "CROD", "CTUBE", "CONROD")
UNKNOWN = ("CPYRAM", "CBEAM3", "CBEND", "CCONEAX", "CQUADX", "CTRIAX", "CTRIAX6")
"""Elements whose mass pyNastran has not, or not rightly: of an oblique pyramid, curved bars, and rings."""
POINTS = ("CONM1", "CONM2", "CMASS1", "CMASS2", "CMASS3", "CMASS4")
SAME_IN_ALL = 1e-4
"""Largest difference of the mass in two directions, relative, that is the rounding of a rigid body."""
NO_INERTIA = 1e-9
"""Least moment of inertia, relative to the largest, below which a body has none about that axis."""


def momentum_maps(model: Any, point: FloatArray, coupled: bool) -> tuple[dict[int, FloatArray], str]:
    """Momentum about a point by the velocities of the grid points, as NASTRAN's mass matrix has it.

    Parameters
    ----------
    model : object
    point : ndarray, shape (3,)
    coupled : bool
        ``PARAM,COUPMASS``: bars have the consistent mass of cubic deflections and the polar inertia
        ``rho (I1 + I2) L`` about their axis. False, NASTRAN's default: half their mass is at each end. Other elements
        have equal masses at their grid points, CONM1 and CONM2 their inertia, CMASS1 and CMASS2 one component.

    Returns
    -------
    maps : dict of int to ndarray, shape (6, 6)
        **momentum (linear, angular about the point) = sum of maps[grid] @ velocity of the grid point.** With
        the velocities of rigid motions the sum is the rigid mass matrix.
    unknown : str
        The first mass that is not understood, "" if all are.
    """
    maps: dict[int, FloatArray] = {}
    if unknown := _not_understood(model):
        return maps, unknown

    def add(grid: int, momentum: FloatArray) -> None:
        maps[grid] = maps.get(grid, np.zeros((6, 6))) + momentum

    for lump in model.masses.values():
        if lump.type.startswith("CMASS"):
            for grid, component in _scalar(model, lump):
                axis = six_axes(model.nodes[grid], "deck")[component - 1]
                add(grid, lump.Mass() * tau(_position(model.nodes[grid]), point).T @ np.outer(axis, axis))
            continue
        position = _position(model.nodes[lump.Nid()])
        if lump.type == "CONM1":
            # Mass matrix of a CONM1 at its grid point in the basic coordinates, shape (6, 6)
            lower = np.tril(np.asarray(lump.mass_matrix, dtype=float))
            full = lower + np.tril(lower, -1).T
            if lump.Cid() > 0:
                axes = np.asarray(lump.cid_ref.beta(), dtype=float)
                turn = linalg.block_diag(axes, axes)
                full = turn.T @ full @ turn
            add(lump.Nid(), tau(position, point).T @ np.asarray(full, dtype=float))
            continue
        center, body = _concentrated(lump, position)
        add(lump.Nid(), tau(center, point).T @ body @ tau(center, position))
    for element in model.elements.values():
        mass = float(element.Mass()) if hasattr(element, "Mass") else 0.0
        grids = [grid for grid in element.node_ids if grid] if mass else []
        if element.type in BARS and grids:
            start, end = _ends(element)
            mass *= float(linalg.norm(end - start)) / float(element.Length())
            half = (np.diag([mass / 2.0] * 3 + [0.0] * 3),) * 2
            centers = (0.5 * (start + end),) * 2 if coupled else (start, end)
            parts = zip(grids, (start, end), _bar(element, mass) if coupled else half, centers)
            for grid, place, momentum, center in parts:
                add(grid, tau(center, point).T @ momentum @ tau(place, _position(model.nodes[grid])))
            continue
        for grid in grids:
            add(grid, tau(_position(model.nodes[grid]), point).T @ np.diag([mass / len(grids)] * 3 + [0.0] * 3))
    return maps, ""


def _not_understood(model: Any) -> str:
    """The first mass that pyNastran has in no element, or that is not understood; "" if there is none."""
    for number in model.nsms:
        return f"NSM set {number}"
    for name in model.dmigs:
        return f"DMIG {name}"
    for name in sorted(model.reject_count):
        if name.startswith("C"):  # an element that pyNastran has not
            return str(name)
    moved = {int(grid) for cards in model.mpcs.values() for card in cards for grid in card.node_ids}
    for lump in model.masses.values():
        grids = [grid for grid in lump.node_ids if grid]
        scalar = any(grid not in model.nodes and grid in moved for grid in grids)
        if lump.type not in POINTS or scalar or (len(grids) > 1 and any(grid in model.nodes for grid in grids)):
            return f"{lump.type} {lump.eid}"
    for element in model.elements.values():
        if element.type in UNKNOWN or (element.type == "CBUSH" and element.pid_ref and element.pid_ref.mass):
            return f"{element.type} {element.eid}"
        if _is_offset(element) and str(element.offt).upper() != "GGG":
            return f"{element.type} {element.eid} with OFFT {element.offt}"
    return ""


def is_exact(model: Any, coupled: bool) -> bool:
    """Whether :func:`momentum_maps` is the mass matrix of the run: point masses, and bars with half at each end."""
    heavy = [
        element for element in model.elements.values() if hasattr(element, "Mass") and float(element.Mass()) != 0.0
    ]
    bars = all(element.type in ("CBAR", "CROD", "CONROD") and not _is_offset(element) for element in heavy)
    return bars and not coupled and "BARMASS" not in model.params


def _is_offset(element: Any) -> bool:
    """Whether an end of a bar is not at its grid point."""
    return element.type in BARS and any(np.any(getattr(element, side, 0.0)) for side in ("wa", "wb"))


def _scalar(model: Any, lump: Any) -> list[tuple[int, int]]:
    """Grid point and component 1 to 6 of a CMASS; none at scalar points, which rigid motions do not move."""
    if lump.type not in ("CMASS1", "CMASS2"):
        return []
    ends = ((lump.G1(), lump.c1), (lump.G2(), lump.c2))
    return [(grid, int(one)) for grid, one in ends if grid in model.nodes and one]


def _ends(element: Any) -> tuple[FloatArray, FloatArray]:
    """Ends of a bar in the basic coordinates: its grid points, and its offsets in their displacement axes."""
    ends = []
    for node, side in zip(element.nodes_ref, ("wa", "wb")):
        offset = np.asarray(getattr(element, side, np.zeros(3)), dtype=float)
        ends.append(_position(node) + displacement_axes(node, "deck").T @ offset)
    return ends[0], ends[1]


def _concentrated(lump: Any, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre of mass of a CONM2 in the basic coordinates, shape (3,), and its mass matrix there, shape (6, 6).

    Offset and inertia are in the axes of CID, Cartesian whatever its kind; with CID -1 the offset is a position.
    """
    i = np.asarray(lump.I, dtype=float)  # products of inertia with the sign of the integrals
    inertia = np.array([[i[0], -i[1], -i[3]], [-i[1], i[2], -i[4]], [-i[3], -i[4], i[5]]])
    offset = np.asarray(lump.X, dtype=float)
    if lump.Cid() > 0:
        axes = np.asarray(lump.cid_ref.beta(), dtype=float)
        offset, inertia = axes.T @ offset, axes.T @ inertia @ axes
    center = offset if lump.Cid() == -1 else position + offset
    return center, np.asarray(linalg.block_diag(float(lump.mass) * np.eye(3), inertia))


def _bar(element: Any, mass: float) -> tuple[FloatArray, FloatArray]:
    """Momentum of a bar about its centre by the velocities of its ends, each shape (6, 6).

    Integrals of the cubic shape functions and of their products with the distance from the centre.
    """
    start, end = _ends(element)
    length = float(linalg.norm(end - start))
    along = skew((end - start) / length)  # along @ v is axis x v
    momenta = []
    for side in (-1.0, 1.0):
        momentum = np.zeros((6, 6))
        momentum[:3, :3] = mass / 2.0 * np.eye(3)
        momentum[:3, 3:] = side * mass * length / 12.0 * along
        momentum[3:, :3] = side * mass * length / 10.0 * along
        momentum[3:, 3:] = mass * length**2 / 120.0 * along @ along + 0.5 * _polar(element)
        momenta.append(momentum)
    return momenta[0], momenta[1]


def mass_of_elements(model: Any, point: FloatArray, path: str, coupled: bool) -> FloatArray:
    """Rigid mass matrix at a point, shape (6, 6), of :func:`momentum_maps`.

    Raises
    ------
    ValueError
        A mass element that is not understood.
    """
    maps, unknown = momentum_maps(model, point, coupled)
    if unknown:
        raise InputError(
            f"{path}: masses must be those of CONM1, CONM2, CMASS2 and of elements that are read (or add "
            f"PARAM,GRDPNT,0 to the run), got {unknown}"
        )
    total = np.zeros((6, 6))
    for grid, momentum in maps.items():
        total += momentum @ tau(_position(model.nodes[grid]), point)
    return 0.5 * (total + total.T)


def polar_inertia(model: Any) -> FloatArray:
    """Inertia of the bars about their own axes, shape (3, 3): ``rho (I1 + I2) L`` about each axis.

    A lumped mass matrix lacks it, and so does the grid point weight: a straight boom has then no inertia about itself.
    """
    return np.asarray(sum((_polar(element) for element in model.elements.values()), np.zeros((3, 3))))


def _polar(element: Any) -> FloatArray:
    section: Any = getattr(element, "pid_ref", None)
    if element.type not in BARS or not (hasattr(section, "I11") and hasattr(section, "I22")):
        return np.zeros((3, 3))
    start, end = _ends(element)
    span = end - start
    line = float(section.Rho()) * (float(section.I11()) + float(section.I22()))
    return np.asarray(line / max(float(linalg.norm(span)), 1e-300) * np.outer(span, span), dtype=float)


def rigid_mass(model: Any, results: Any, point: FloatArray, path: str, coupled: bool) -> FloatArray:
    """Rigid mass matrix at a point, shape (6, 6): grid point weight of the OP2, else the masses of the BDF.

    Where it has no inertia about an axis, the polar inertia of the bars is added.

    Raises
    ------
    ValueError
        Still no inertia about an axis, or a mass element that is not understood.
    """
    weight_table = _grid_point_weight(model, results, point, path)
    if weight_table is None:
        weight_table = mass_of_elements(model, point, path, coupled)
    check_rigid(weight_table, path)
    if lacks_inertia(weight_table):
        weight_table = weight_table.copy()
        weight_table[3:, 3:] += polar_inertia(model)
    if lacks_inertia(weight_table):
        raise InputError(
            f"{path}: mass must have inertia about every axis, got none about one, and no bars with a density and "
            "second moments of area along it: give a CONM2 an inertia, or mass_matrix"
        )
    return weight_table


def check_rigid(mass_matrix: FloatArray, path: str) -> None:
    """Refuse a mass matrix, shape (6, 6), that no rigid body has: another mass in each direction.

    Raises
    ------
    ValueError
        Such a matrix, as of CMASS1, CMASS2 or CONM1 in one direction only.
    """
    mass, size = mass_matrix[0, 0], float(np.abs(mass_matrix[:3, :3]).max())
    if np.abs(mass_matrix[:3, :3] - mass * np.eye(3)).max() > SAME_IN_ALL * size:
        raise InputError(
            f"{path}: mass must be the same in all directions (CMASS1, CMASS2 and CONM1 in x, y and z), got "
            f"{', '.join(f'{one:.6g}' for one in np.diag(mass_matrix)[:3])} in x, y and z"
        )


def lacks_inertia(mass_matrix: FloatArray) -> bool:
    """Whether a body with mass has no moment of inertia about some axis."""
    least = linalg.eigvalsh(mass_matrix[3:, 3:])
    return bool(mass_matrix[0, 0] > 0 and least[0] <= NO_INERTIA * least[-1])


def _grid_point_weight(model: Any, results: Any, point: FloatArray, path: str) -> FloatArray | None:
    for weight in results.grid_point_weight.values():
        reference = int(weight.reference_point)
        if reference and reference not in model.nodes:
            raise InputError(f"{path}: PARAM,GRDPNT must be 0 or a grid point of the deck, got {reference}")
        origin = _position(model.nodes[reference]) if reference else np.zeros(3)
        shift = tau(origin, point)
        matrix = shift.T @ np.asarray(weight.MO, dtype=float) @ shift
        return np.asarray(0.5 * (matrix + matrix.T))
    return None


def _position(node: Any) -> FloatArray:
    return np.asarray(node.get_position(), dtype=float)
