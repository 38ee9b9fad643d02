"""Files as a NASTRAN run delivers them, written by pyNastran from a beam frame of this project.

The frame is solved here with its constraints as linear equations: SPC, RBE2 and RBE3 are rows of ``G u = 0``, the
constraint forces their multipliers. The readers under test compute neither.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag, eigh, inv, lstsq, null_space, solve
from scipy.spatial.transform import Rotation

from titop_plant.structures import BeamFrame
from titop_plant.structures.beam_element import beam_axes
from titop_plant.structures.beam_frame import assemble, rigid_body_modes
from titop_plant.structures.kinematics import tau

RECTANGULAR, CYLINDRICAL = 7, 8
ORIGIN = np.array([-0.4, 0.2, 0.1])
TURNED = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
"""Axes of both as rows."""


@dataclass(frozen=True)
class Delivery:
    """A frame in the units of its deck, and how it is held.

    Attributes
    ----------
    spc : components by node; none is a free body
    rbe2, rbe3 : nodes of a ring by the node at its centre, which governs them (RBE2) or is their mean (RBE3)
    wtmass : PARAM,WTMASS; the deck states the masses divided by it
    weight : reference grid point of the grid point weight, 0 for the origin, None for none
    lumped : NASTRAN's default: half the mass of a bar at each end; False: consistent masses with PARAM,COUPMASS
    keep : number of modes
    cards : further lines at the head of the deck
    cd : displacement coordinates by node: `RECTANGULAR`, or `CYLINDRICAL` about an axis through `ORIGIN`
    """

    frame: BeamFrame
    spc: Mapping[str, str] = field(default_factory=dict)
    rbe2: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    rbe3: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    wtmass: float = 1.0
    weight: int | None = 0
    lumped: bool = False
    keep: int = 8
    cards: str = ""
    cd: Mapping[str, int] = field(default_factory=dict)

    def grid(self, node: str) -> int:
        """Grid point of a node, counted from 1."""
        return 1 + list(self.frame.divided().nodes).index(node)

    def axes(self, node: str) -> np.ndarray:
        """Axes of the displacements of a node as rows, translation and rotation, shape (6, 6)."""
        kind = self.cd.get(node, 0)
        if kind == 0:
            return np.eye(6)
        rows = TURNED
        if kind == CYLINDRICAL:
            arm = self.frame.divided().nodes[node] - ORIGIN
            out = arm - (arm @ TURNED[2]) * TURNED[2]
            out = out / np.sqrt(out @ out)
            rows = np.array([out, np.cross(TURNED[2], out), TURNED[2]])
        return block_diag(rows, rows)


def write_deck(delivery: Delivery, path: Path) -> None:
    """BDF of the frame."""
    from pyNastran.bdf.bdf import BDF

    source, model = delivery.frame.divided(), BDF(debug=None)
    grids = {name: delivery.grid(name) for name in source.nodes}
    for name, grid in grids.items():
        model.add_grid(grid, source.nodes[name], cd=delivery.cd.get(name, 0))
    if delivery.cd:
        for add, kind in ((model.add_cord2r, RECTANGULAR), (model.add_cord2c, CYLINDRICAL)):
            add(kind, ORIGIN, ORIGIN + TURNED[2], ORIGIN + TURNED[0])
    for k, beam in enumerate(source.beams, start=1):
        s = beam.section
        model.add_mat1(k, s.E, s.G, None, rho=s.density / delivery.wtmass)
        model.add_pbar(k, k, A=s.A, i1=s.Iz, i2=s.Iy, j=s.J)
        up = beam_axes(source.nodes[beam.start], source.nodes[beam.end], beam.up, source.name)[1]
        model.add_cbar(k, k, [grids[beam.start], grids[beam.end]], up, None)
    for k, lump in enumerate(source.masses, start=1001):
        i = lump.inertia / delivery.wtmass
        inertia = [i[0, 0], -i[1, 0], i[1, 1], -i[2, 0], -i[2, 1], i[2, 2]]
        model.add_conm2(k, grids[lump.node], lump.mass / delivery.wtmass, X=lump.offset, I=inertia)
    for k, (centre, ring) in enumerate(delivery.rbe2.items(), start=2001):
        model.add_rbe2(k, grids[centre], "123456", [grids[node] for node in ring])
    for k, (centre, ring) in enumerate(delivery.rbe3.items(), start=3001):
        model.add_rbe3(k, grids[centre], "123456", [1.0], ["123"], [[grids[node] for node in ring]])
    for node, components in delivery.spc.items():
        model.add_spc1(1, components, [grids[node]])
    if not delivery.lumped:
        model.add_param("COUPMASS", [1])
    if delivery.wtmass != 1.0:
        model.add_param("WTMASS", [delivery.wtmass])
    model.write_bdf(str(path), size=16, is_double=True)
    path.write_text(delivery.cards + path.read_text())


@dataclass(frozen=True)
class Solution:
    """Matrices of the free frame, its modes (columns) and the forces of the single-point constraints."""

    M: np.ndarray
    K: np.ndarray
    squares: np.ndarray
    shapes: np.ndarray
    forces: np.ndarray


def matrices(delivery: Delivery) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Nodes, mass and stiffness of the free frame."""
    source = delivery.frame.divided()
    names, M, K = assemble(source)
    if delivery.lumped:
        M = np.zeros_like(M)
        row = {name: 6 * k for k, name in enumerate(names)}
        for beam in source.beams:
            span = source.nodes[beam.end] - source.nodes[beam.start]
            half = 0.5 * beam.section.density * beam.section.A * float(np.sqrt(span @ span))
            for node in (beam.start, beam.end):
                M[range(row[node], row[node] + 3), range(row[node], row[node] + 3)] += half
        for lump in source.masses:
            rows = slice(row[lump.node], row[lump.node] + 6)
            M[rows, rows] += lump.matrix()
    return list(names), M, K


def equations(delivery: Delivery, row: Mapping[str, int], size: int) -> tuple[np.ndarray, int]:
    """Rows G of ``G u = 0``, those of the SPC last, and the number of these."""
    source = delivery.frame.divided()
    found: list[np.ndarray] = [np.zeros((0, size))]

    def equation(blocks: Mapping[str, np.ndarray]) -> None:
        rows = np.zeros((6, size))
        for node, block in blocks.items():
            rows[:, row[node] : row[node] + 6] += block
        found.append(rows)

    for centre, ring in delivery.rbe2.items():
        for node in ring:
            equation({node: -np.eye(6), centre: tau(source.nodes[node], source.nodes[centre])})
    for centre, ring in delivery.rbe3.items():
        arms = {node: tau(source.nodes[node], source.nodes[centre])[:3] for node in ring}
        stacked = np.vstack(list(arms.values()))
        sums = inv(stacked.T @ stacked)
        equation(
            {centre: -np.eye(6), **{node: np.hstack([sums @ arm.T, np.zeros((6, 3))]) for node, arm in arms.items()}}
        )
    held = []
    for node, components in delivery.spc.items():
        rows = np.zeros((6, size))
        rows[:, row[node] : row[node] + 6] = delivery.axes(node)
        held += [rows[int(one) - 1] for one in components]
    return np.vstack([*found, *held]), len(held)


def solved(delivery: Delivery) -> Solution:
    """Modes of the frame under its constraints."""
    names, M, K = matrices(delivery)
    size = M.shape[0]
    G, held = equations(delivery, {name: 6 * k for k, name in enumerate(names)}, size)
    free = null_space(G) if G.size else np.eye(size)
    reduced_K, reduced_M = free.T @ K @ free, free.T @ M @ free
    if delivery.lumped:  # masses of zero: the largest of the inverse squares
        inverse, shapes = eigh(
            reduced_M, reduced_K, subset_by_index=(len(reduced_M) - delivery.keep, len(reduced_M) - 1)
        )
        squares, shapes = 1.0 / inverse[::-1], shapes[:, ::-1] / np.sqrt(inverse[::-1])
    else:
        squares, shapes = eigh(reduced_K, reduced_M, subset_by_index=(0, delivery.keep - 1))
    shapes = free @ shapes
    out_of_balance = K @ shapes - (M @ shapes) * squares
    forces = np.zeros_like(shapes)
    if held:
        multipliers = lstsq(G.T, out_of_balance)[0]
        forces = G[-held:].T @ multipliers[-held:]
    return Solution(M, K, squares, shapes, forces)


def with_residual_vectors(delivery: Delivery, keep: int, node: str) -> Solution:
    """Modes and the static shapes of three forces at a node, orthonormalised: Ritz vectors, as those of RESVEC.

    Only of a delivery without RBE. The constraint forces are the rows of ``K u - w^2 M u`` at the held grid points, as
    NASTRAN recovers them, whatever forces are left at the others.
    """
    names, M, K = matrices(delivery)
    G, _ = equations(delivery, {name: 6 * k for k, name in enumerate(names)}, M.shape[0])
    free, loads = null_space(G), np.eye(M.shape[0])[:, 6 * names.index(node) :][:, :3]
    static = free @ solve(free.T @ K @ free, free.T @ loads)
    basis = np.hstack([solved(delivery).shapes[:, :keep], static])
    squares, factors = eigh(basis.T @ K @ basis, basis.T @ M @ basis)
    shapes = basis @ factors
    held = np.any(G != 0.0, axis=0)
    return Solution(M, K, squares, shapes, held[:, None] * (K @ shapes - (M @ shapes) * squares))


def write_results(
    delivery: Delivery,
    path: Path,
    *,
    modes: bool = True,
    forces: bool = True,
    solution: Solution | None = None,
    largest: bool = False,
    eigenvalues: bool = False,
) -> Solution:
    """OP2 of the modes, constraint forces and grid point weight.

    `largest` normalises every mode to a largest component of 1 (NORM MAX); `eigenvalues` writes the generalised masses,
    in a table with one mode more than the eigenvectors.
    """
    from pyNastran.op2.op2 import OP2
    from pyNastran.op2.result_objects.grid_point_weight import GridPointWeight
    from pyNastran.op2.tables.oqg_constraintForces.oqg_spc_forces import RealSPCForcesArray
    from pyNastran.op2.tables.oug.oug_eigenvectors import RealEigenvectorArray

    source, found = delivery.frame.divided(), solution or solved(delivery)
    keep = found.squares.size
    names = list(source.nodes)
    grids = np.column_stack([np.arange(1, len(names) + 1), np.ones(len(names))]).astype("int32")
    model = OP2(debug=None)
    model.set_as_msc()
    model.is_nx, model.is_msc, model.is_optistruct = False, True, False
    numbers, cycles = np.arange(1, keep + 1), np.sqrt(np.abs(found.squares)) / (2 * np.pi)

    factor = 1.0 / np.abs(found.shapes).max(axis=0) if largest else np.ones(keep)
    found = replace(found, shapes=factor * found.shapes, forces=factor * found.forces)

    def table(kind: Any, name: str, columns: np.ndarray) -> Any:
        columns = block_diag(*(delivery.axes(node) for node in names)) @ columns
        data = columns.T.reshape(keep, len(names), 6).astype("float32")
        return kind.add_modal_case(name, grids, data, 1, numbers, found.squares, cycles)

    if modes:
        vectors = table(RealEigenvectorArray, "OUGV1", found.shapes)
        vectors.table_code = vectors.data_code["table_code"] = 7  # eigenvectors, not displacements
        model.eigenvectors[1] = vectors
    if forces:
        model.spc_forces[1] = table(RealSPCForcesArray, "OQG1", found.forces)
    if delivery.weight is not None:
        point = np.zeros(3) if delivery.weight == 0 else source.nodes[names[delivery.weight - 1]]
        rigid = rigid_body_modes(source, names, point)
        eye, mass = np.eye(3), rigid.T @ found.M @ rigid / delivery.wtmass
        model.grid_point_weight[""] = GridPointWeight(
            delivery.weight, mass, eye, np.ones(3), 0 * eye, eye, np.ones(3), eye
        )
    model.write_op2(str(path), nastran_format="msc")
    if eigenvalues:
        _append_eigenvalues(path, found.squares, factor**2)
    return found


def _append_eigenvalues(path: Path, squares: np.ndarray, masses: np.ndarray) -> None:
    """Table of eigenvalues of one mode more, which pyNastran leaves out of its OP2, before the end of file."""
    from pyNastran.op2.tables.lama_eigenvalues.lama_objects import RealEigenvalues

    stated = RealEigenvalues("modes", "LAMA", squares.size + 1)
    for k, (square, mass) in enumerate(zip([*squares, 2.0 * squares[-1]], [*masses, 1.0])):
        root = np.sqrt(square)
        stated.add_f06_line((k + 1, k + 1, square, root, root / (2 * np.pi), mass, mass * square), k)
    stated.format_code = 1
    text, end = path.read_bytes(), struct.pack("<3i", 4, 0, 4)
    assert text.endswith(end)
    with path.open("wb") as file:
        file.write(text[: -len(end)])
        number = stated.write_op2(file, io.StringIO(), -1, True, (1, 1, 2020), endian=b"<")
        file.write(struct.pack("<9i", 4, number, 4, 4, 1, 4, 4, 0, 4) + end + end)


def write_superelement(
    delivery: Delivery,
    path: Path,
    boundary: Mapping[str, str],
    modes: int,
    *,
    names: tuple[str, str] = ("KAAX", "MAAX"),
) -> None:
    """Punch file of the frame reduced to components of nodes and fixed-interface modes (Craig and Bampton).

    In the large fields of a punch file with ten digits, lower triangles; the modes are scalar points from 9001.
    """
    _, M, K = matrices(delivery)
    first = {node: 6 * (delivery.grid(node) - 1) for node in boundary}
    G, _ = equations(delivery, {name: 6 * k for k, name in enumerate(delivery.frame.divided().nodes)}, M.shape[0])
    kept = [first[node] + int(one) - 1 for node, components in boundary.items() for one in components]
    fixed = null_space(np.vstack([G, np.eye(M.shape[0])[kept]]))
    static = _static_shapes(K, G, kept, fixed)
    turn = block_diag(*(delivery.axes(node) for node in boundary))  # of boundaries with all six components
    if delivery.cd:
        static = static @ turn.T
    basis = static
    if modes:
        shapes = eigh(fixed.T @ K @ fixed, fixed.T @ M @ fixed, subset_by_index=(0, modes - 1))[1]
        basis = np.hstack([static, fixed @ shapes])
    names_of = [(delivery.grid(node), int(one)) for node, components in boundary.items() for one in components]
    names_of += [(9001 + k, 0) for k in range(modes)]
    lines = ["$TITLE   = SUPERELEMENT", "$LABEL   ="]
    for name, matrix in zip(names, (K, M)):
        reduced = basis.T @ matrix @ basis
        lines.append(f"DMIG    {name:<8}{0:>8}{6:>8}{2:>8}{0:>8}")
        for j, (grid, component) in enumerate(names_of):
            lines.append(f"DMIG*   {name:<16}{grid:>16}{component:>16}")
            for i in range(j, len(names_of)):
                value = f"{reduced[i, j]:.9E}".replace("E", "D")
                lines.append(f"*       {names_of[i][0]:>16}{names_of[i][1]:>16}{value:>16}")
    path.write_text("\n".join(lines) + "\n")


def _static_shapes(K: np.ndarray, G: np.ndarray, kept: list[int], fixed: np.ndarray) -> np.ndarray:
    """Displacements without forces elsewhere for unit displacements of the coordinates that are kept."""
    rows = np.vstack([G, np.eye(K.shape[0])[kept]])
    values = np.vstack([np.zeros((G.shape[0], len(kept))), np.eye(len(kept))])
    given = lstsq(rows, values)[0]
    return given - fixed @ inv(fixed.T @ K @ fixed) @ fixed.T @ K @ given
