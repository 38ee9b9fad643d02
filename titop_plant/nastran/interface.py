"""The clamped interface of a NASTRAN run: one grid point, or several that one rigid part holds.

If every constrained grid point moves with the parent point P as one rigid body, a unit motion of P moves the structure
at rest as a rigid body, too, whichever components are constrained, as long as they hold all six rigid motions. Then the
wrench at P in mode k is the sum of the constraint forces, moved to P, and the body has one parent port.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.nastran.axes import six_axes
from titop_plant.nastran.files import grid_positions, rows_of
from titop_plant.structures.kinematics import tau

SPRINGS = ("CELAS1", "CELAS2", "CELAS3", "CELAS4", "CBUSH", "CBUSH1D")
DIRECTED = ("CELAS1", "CELAS2")
"""Springs between components of grid points, wherever these are."""
RIGID = 1e-3
"""Sum of the terms of an MPC in a rigid motion, relative to their absolute values, that is their rounding."""
STILL = 1e-5
"""Motion or force at a grid point, relative to the largest of the mode, that is none in single precision."""


@dataclass(frozen=True)
class Interface:
    """Grid points that one rigid part holds: the parent point P of a body.

    Parameters
    ----------
    name : str
        Name of P.
    clamped : sequence of int
        Grid points in SPC, such as those of the bolts.
    at : int or sequence of 3 floats, optional
        Grid point, or position in the basic coordinates and units of the deck, of P. Default: the mean of the
        clamped grid points, the centre of a circle of bolts.

    Raises
    ------
    ValueError
        No grid point.

    Examples
    --------
    Four bolts, P at their centre:

    >>> Interface("I_p", (11, 12, 13, 14)).clamped
    (11, 12, 13, 14)
    """

    name: str
    clamped: tuple[int, ...]
    at: int | Sequence[float] | None = None

    def __post_init__(self) -> None:
        try:
            clamped = tuple(int(grid) for grid in self.clamped)
        except (TypeError, ValueError):
            raise InputError(f"interface {self.name!r}: clamped must be grid points, got {self.clamped!r}") from None
        if not clamped:
            raise InputError(f"interface {self.name!r}: clamped must have at least one grid point, got none")
        object.__setattr__(self, "clamped", clamped)

    @classmethod
    def of(cls, parent: tuple[str, int] | Interface) -> Interface:
        """The interface of a name and one grid point."""
        return parent if isinstance(parent, Interface) else cls(parent[0], (parent[1],))

    def place(self, model: Any, path: str) -> FloatArray:
        """Position of P in the units of the deck, shape (3,).

        Raises
        ------
        ValueError
            A grid point that is not in the deck.
        """
        places = [grid_positions(model, {self.name: grid}, path)[self.name] for grid in self.clamped]
        if self.at is None:
            return np.asarray(np.mean(places, axis=0))
        if isinstance(self.at, (int, np.integer)):
            node = model.nodes.get(int(self.at))
            if node is None:
                raise InputError(f"{path}: grid point of {self.name!r} must be in the file, got GRID {self.at}")
            return np.asarray(node.get_position(), dtype=float)
        place = np.asarray(self.at, dtype=float)
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise InputError(f"interface {self.name!r}: at must be a grid point or a position (3,), got {self.at!r}")
        return place


def check_clamped(
    model: Any, interface: Interface, table: Any, forces: Any, path: str, subcase: int | None = None
) -> None:
    """Check that the deck holds the interface in all six directions and nothing else.

    Without `forces` (None) no other constraint is accepted. Constraints are those of `subcase`, None for all.

    Raises
    ------
    ValueError
        Rigid motions are free, another grid point is held with a force, or the results move what the deck holds.
    """
    held = _constrained(model, subcase)
    first = interface.clamped[0]
    if not held:
        raise InputError(
            f"{path}: the parent GRID {first} must be clamped (SPC1 123456), got nothing: modes of a free body have "
            "no flexibility of the interface; ask for SOL 103 with the interface in SPC1 and SPCFORCES(PLOT)=ALL, or "
            "for the reduced matrices KAAX and MAAX (read_nastran_matrices)"
        )
    point, parts = interface.place(model, path), []
    for grid in interface.clamped:
        position = np.asarray(model.nodes[grid].get_position(), dtype=float)
        rows = [int(one) - 1 for one in sorted(held.get(grid, set())) if one in "123456"]
        parts.append((six_axes(model.nodes[grid], path) @ tau(position, point))[rows])
    rigid = np.vstack(parts)
    size = float(np.abs(rigid[:, 3:]).max(initial=0.0)) if len(interface.clamped) > 1 else 1.0
    if rigid.shape[0] < 6 or linalg.svdvals(rigid / np.repeat([1.0, size or 1.0], 3))[-1] < 1e-6:
        got = {grid: "".join(sorted(held.get(grid, set()))) or "nothing" for grid in interface.clamped}
        if len(got) == 1:
            others = sorted(set(held) - set(got))
            also = f" and SPC at {others[:12]}: Interface({interface.name!r}, ...) takes several" if others else ""
            raise InputError(f"{path}: the parent GRID {first} must be clamped (SPC1 123456), got {got[first]}{also}")
        raise InputError(f"{path}: SPC at the interface must hold all six rigid motions, got {got}")
    others = [
        grid
        for grid in sorted(set(held) - set(interface.clamped))
        if forces is None or not all(_largest(model, one, grid, held, path) <= STILL for one in (forces, table))
    ]
    if others:
        where = f"GRID {first}" if len(interface.clamped) == 1 else f"grid points {list(interface.clamped)}"
        both = (*interface.clamped, *others)
        several = str(both) if len(both) <= 12 else "..."
        raise InputError(
            f"{path}: SPC must be at the parent {where} alone, got SPC at {others[:12]} too; "
            f"Interface({interface.name!r}, {several}) takes them as one rigid part"
        )
    for grid in interface.clamped:
        if _largest(model, table, grid, held, path, absent=0.0) > STILL:
            raise InputError(f"{path}: results must be of a run that clamps GRID {grid} as the deck does, got motion")
    _check_not_grounded(model, path, subcase)


def _check_not_grounded(model: Any, path: str, subcase: int | None) -> None:
    """Refuse springs to ground or scalar points, and MPC against rigid motions: P does not hold the body alone."""
    places = np.array([node.get_position() for node in model.nodes.values()], dtype=float)
    size = float(np.ptp(places, axis=0).max())
    for element in model.elements.values():
        if element.type in SPRINGS and any(grid not in model.nodes for grid in element.node_ids):
            raise InputError(
                f"{path}: springs must be between two grid points, got {element.type} {element.eid} to ground or to a "
                "scalar point: SPC at the parent must be all that holds the body"
            )
        if element.type in DIRECTED and _turns(model, element, size, path):
            raise InputError(
                f"{path}: springs between two grid points must have no force in a rigid motion, got {element.type} "
                f"{element.eid}, whose ends are apart across its direction, or have other directions: ask for CBUSH"
            )
    chosen = _chosen(model, "MPC", subcase)
    for key, cards in model.mpcs.items():
        for card in cards if chosen is None or int(key) in chosen else ():
            grids = _integers(card.nodes)
            if all(grid in model.nodes for grid in grids) and _holds(model, card, grids, path):
                raise InputError(
                    f"{path}: MPC must let the body move as a rigid one, got MPC {key} of GRID {grids[:6]} against it"
                )


def _turns(model: Any, spring: Any, size: float, path: str) -> bool:
    """Whether a spring between components of two grid points has a force in a rigid motion of a model of some size."""
    components = int(spring.c1), int(spring.c2)
    if 0 in components:
        return False
    nodes = [model.nodes[grid] for grid in _integers(spring.node_ids)]
    places = [np.asarray(node.get_position(), dtype=float) for node in nodes]
    motions = [six_axes(node, path) @ tau(place, places[0]) for node, place in zip(nodes, places)]
    rows = [motion[component - 1] for motion, component in zip(motions, components)]
    apart = np.abs(rows[1] - rows[0])
    return bool(apart[:3].max() > RIGID or apart[3:].max() > RIGID * (size if components[0] <= 3 else 1.0))


def _holds(model: Any, equation: Any, grids: list[int], path: str) -> bool:
    """Whether an MPC of grid points has a value in a rigid motion."""
    point = np.asarray(model.nodes[grids[0]].get_position(), dtype=float)
    terms = np.zeros((len(grids), 6))
    for k, (grid, component, factor) in enumerate(zip(grids, equation.components, equation.coefficients)):
        position = np.asarray(model.nodes[grid].get_position(), dtype=float)
        terms[k] = factor * (six_axes(model.nodes[grid], path) @ tau(position, point))[int(component) - 1]
    parts = (terms[:, :3], terms[:, 3:])
    return any(float(np.abs(one.sum(axis=0)).max()) > RIGID * float(np.abs(one).sum()) for one in parts)


def held_wrench(model: Any, interface: Interface, forces: Any, path: str) -> FloatArray:
    """Constraint forces of every mode as one wrench on the body at P, shape (n, 6).

    Raises
    ------
    ValueError
        The OP2 has no forces at a clamped grid point.
    """
    point = interface.place(model, path)
    total = np.zeros((np.asarray(forces.data).shape[0], 6))
    for grid in interface.clamped:
        lever = tau(np.asarray(model.nodes[grid].get_position(), dtype=float), point)
        total += rows_of(forces, grid, path, interface.name) @ lever
    return total


def _constrained(model: Any, subcase: int | None) -> dict[int, set[str]]:
    """Constrained components by grid point: the sets that the case control names, else all; and those of GRID."""
    constrained: dict[int, set[str]] = {}
    chosen = _chosen(model, "SPC", subcase)
    for key, cards in model.spcs.items():
        for card in cards if chosen is None or int(key) in chosen else ():
            components = card.components
            each = [components] * len(card.nodes) if isinstance(components, str) else components
            for node, component in zip(_integers(card.nodes), each):
                constrained.setdefault(node, set()).update(str(component))
    for grid, node in model.nodes.items():
        if node.ps:
            constrained.setdefault(grid, set()).update(str(node.ps))
    return {grid: axes for grid, axes in constrained.items() if grid in model.nodes}


def _chosen(model: Any, kind: str, subcase: int | None) -> set[int] | None:
    """Sets of SPC or MPC that the case control names, with those that SPCADD or MPCADD adds; None where it names none.

    Those of `subcase`, or of all for None and for a subcase that it does not have.
    """
    control = getattr(model, "case_control_deck", None)
    if control is None:
        return None
    cases = control.subcases
    named = {
        int(case.params[kind][0])
        for case in ([cases[subcase]] if subcase in cases else cases.values())
        if kind in case.params and str(case.params[kind][0]).isdigit()
    }
    if not named:
        return None
    for key, cards in (model.spcadds if kind == "SPC" else model.mpcadds).items():
        if int(key) in named:
            named |= {int(one) for card in cards for one in _integers(card.sets)}
    return named


def _integers(nodes: Iterable[Any]) -> list[int]:
    return [int(getattr(node, "nid", node)) if not isinstance(node, (int, str)) else int(node) for node in nodes]


def _largest(model: Any, table: Any, grid: int, held: dict[int, set[str]], path: str, absent: float = np.inf) -> float:
    """Largest value of the constrained components of a grid point, relative to the largest of the table."""
    index = np.flatnonzero(np.asarray(table.node_gridtype)[:, 0] == grid)
    if index.size != 1:
        return absent
    rows = [int(one) - 1 for one in held[grid] if one in "123456"]
    data = np.asarray(table.data, dtype=float)
    of_grid = data[:, index[0], :] @ six_axes(model.nodes[grid], path).T
    return float(np.abs(of_grid[:, rows]).max(initial=0.0) / max(float(np.abs(data).max()), 1e-300))
