"""The reference telescope's two structures: central body and payload, as beam frames.

They replace the confidential finite-element data of the published mission: structures of plausible
mass, size and stiffness, not measured ones. Every number comes from the parameter file of the telescope
(tables ``materials``, ``body``, ``payload``, ``optics``); this module contains the topology only:

* central body: a thrust tube, three decks of radial webs, edge beams and braces, four longerons, braced
  side walls, brackets for the array drives (A1 on the +y side, A2 on the -y side), for the wheel assembly
  (I_w) and for the isolator (I_p), and equipment. G is its centre of mass, joined to the thrust tube by
  a massless link.
* payload: three feet from I_p to a six-sided bench, M1 on three bipods, a tower of six struts
  with a ring and a spider of three vanes that carries M2, brackets for the fast steering mirror (I_f) and
  the detector (DET), and electronics. z is the optical axis, light comes from +z.

The payload frame has its origin at I_p and axes parallel to the body's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.structures.beam_element import Section
from titop_plant.structures.beam_frame import (
    Beam,
    BeamFrame,
    LumpedMass,
    assemble,
    rigid_body_modes,
    to_modal_data,
)
from titop_plant.structures.modal_data import ModalData
from titop_plant.structures.modal_file import read_modal_data
from titop_plant.structures.sections import bar, box, tube
from titop_plant.telescope.layout import frame_points
from titop_plant.telescope.sections import BodyTable, Equipment, Material, PayloadTable, SectionTable
from titop_plant.telescope.telescope import Telescope

PORTS = {"body": BodyTable.POINTS, "payload": ("M1", "M2", "I_f", "DET")}
"""Points of each frame; a parameter file may add points to the body."""
SUPPORTS = 4
"""Nodes of the frame that carry the bracket of an added point."""
PARENTS = {"body": "G", "payload": "I_p"}


def build_body(telescope: Telescope, points: Sequence[str] = ("A1", "A2")) -> ModalData:
    """Central body clamped at G, children A1, A2, I_w, I_p and the points that the parameter file adds.

    Parameters
    ----------
    telescope : Telescope
        Its ``materials`` and ``body``. If ``body.modal_data`` names a modal data file, that body is used, with all its
        modes and damping, instead of the frame.
    points : sequence of str
        What a file must have beside I_w and I_p: the points where something is mounted.

    Returns
    -------
    ModalData
        ``body.modes`` modes, positions in the body frame (origin at the centre of the bottom deck).

    Raises
    ------
    ValueError
        The file is not modal data, has another parent point or lacks a port.
    """
    needed = (*points, "I_w", "I_p")
    from_file = _from_file(telescope, "body", needed)
    return from_file or _from_frame(telescope.body, "body", body_frame(telescope), frame_points(telescope.body.ports))


def build_payload(telescope: Telescope) -> ModalData:
    """Telescope payload clamped at I_p, children M1, M2, I_f, DET.

    Parameters
    ----------
    telescope : Telescope
        Its ``materials``, ``payload`` and ``optics``. If ``payload.modal_data`` names a modal data file, that payload
        is used instead of the frame.

    Returns
    -------
    ModalData
        ``payload.modes`` modes, positions in the payload frame (origin at I_p).

    Raises
    ------
    ValueError
        The file is not modal data, has another parent point or lacks a port.
    """
    points = PORTS["payload"]
    from_file = _from_file(telescope, "payload", points)
    return from_file or _from_frame(telescope.payload, "payload", payload_frame(telescope), points)


def _from_frame(table: BodyTable | PayloadTable, name: str, frame: BeamFrame, points: Sequence[str]) -> ModalData:
    return to_modal_data(frame, PARENTS[name], points, table.modes, table.damping)


def _from_file(telescope: Telescope, name: str, points: Sequence[str]) -> ModalData | None:
    """The user's body, if the parameters name a file."""
    path = telescope.modal_file(name)
    if not path:
        return None
    try:
        data = read_modal_data(path)
    except OSError as error:
        raise InputError(f"{name}.modal_data must be a readable file, got {path}: {error.strerror}") from None
    if data.parent != PARENTS[name]:
        raise InputError(f"{path}: {data.name}: parent must be {PARENTS[name]!r}, got {data.parent!r}")
    missing = sorted(set(points) - {child.name for child in data.children})
    if missing:
        raise InputError(f"{path}: {data.name}: child ports must be {list(points)}, got no {missing[0]!r}")
    return data


def body_frame(telescope: Telescope) -> BeamFrame:
    """Beam frame of the central body (see the module docstring); nodes in the body frame, m."""
    table, materials = telescope.body, telescope.materials
    section = {name: _section(materials, spec) for name, spec in table.sections.items()}
    nodes, beams = _decks(table, section)
    _brackets(table, section, nodes, beams)
    masses = [_equipment(item, nodes) for item in table.equipment]
    loose = BeamFrame("body", nodes, tuple(beams), tuple(masses))
    names, M, _ = assemble(loose)
    rigid = rigid_body_modes(loose, names, np.zeros(3))
    at_origin = rigid.T @ M @ rigid
    moment = at_origin[3:, :3] / at_origin[0, 0]  # skew of the position of the centre of mass
    nodes["G"] = np.array([moment[2, 1], moment[0, 2], moment[1, 0]])
    tube_nodes = {name: xyz for name, xyz in nodes.items() if name.startswith("tube")}
    link = Section(**{**asdict(materials["aluminium"]), "density": 0.0}, A=1.0, Iy=0.1, Iz=0.1, J=0.2)
    beams.append(Beam("G", _nearest(nodes["G"], tube_nodes), link))
    return BeamFrame("body", nodes, tuple(beams), tuple(masses))


def _decks(table: BodyTable, section: Mapping[str, Section]) -> tuple[dict[str, FloatArray], list[Beam]]:
    """Thrust tube, decks and longerons; corner k is at 45, 135, 225, 315 degrees."""
    nodes: dict[str, FloatArray] = {}
    beams: list[Beam] = []
    half = 0.5 * np.array([table.width_x, table.width_y])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    for level, z in enumerate(table.deck_heights):
        nodes[f"tube{level}"] = np.array([0.0, 0.0, z])
        for k in range(4):
            x, y = half * signs[k]
            nodes[f"corner{level}{k}"] = np.array([x, y, z])
            nodes[f"web{level}{k}"] = np.array([0.5 * x, 0.5 * y, z])
        for k in range(4):
            middle = 0.5 * (nodes[f"corner{level}{k}"] + nodes[f"corner{level}{(k + 1) % 4}"])
            nodes[f"edge{level}{k}"] = middle
            beams += [
                Beam(f"tube{level}", f"web{level}{k}", section["web"]),
                Beam(f"web{level}{k}", f"corner{level}{k}", section["web"]),
                Beam(f"corner{level}{k}", f"edge{level}{k}", section["edge"]),
                Beam(f"edge{level}{k}", f"corner{level}{(k + 1) % 4}", section["edge"]),
                Beam(f"edge{level}{k}", f"web{level}{k}", section["deck_brace"]),
                Beam(f"edge{level}{k}", f"web{level}{(k + 1) % 4}", section["deck_brace"]),
                Beam(f"web{level}{k}", f"web{level}{(k + 1) % 4}", section["deck_brace"]),
            ]
        if level:
            beams.append(Beam(f"tube{level - 1}", f"tube{level}", section["thrust_tube"], elements=2))
            for k, factor in enumerate(table.longeron_factors):
                below, above = f"corner{level - 1}{k}", f"corner{level}{(k + 1) % 4}"
                longeron, brace = _scaled(section["longeron"], factor), section["wall_brace"]
                beams += [
                    Beam(below, f"corner{level}{k}", longeron, elements=2),
                    Beam(below, above, brace),  # represents a shear panel
                ]
    return nodes, beams


def _brackets(
    table: BodyTable, section: Mapping[str, Section], nodes: dict[str, FloatArray], beams: list[Beam]
) -> None:
    """Array drives on the middle deck, wheels on the bottom deck, isolator on the top deck."""
    supports = {
        "A1": ("edge10", "corner10", "corner11", "edge00"),
        "A2": ("edge12", "corner12", "corner13", "edge02"),
        "I_w": ("tube0", "web03", "edge03", "corner03"),
        "I_p": ("tube2", "web20", "web21", "web22", "web23"),
    }
    for name, ends in supports.items():
        nodes[name] = np.array(table.ports[name], dtype=float)
        beams += [Beam(end, name, section[f"bracket_{name}"]) for end in ends]
    structure = {name: xyz for name, xyz in nodes.items() if name not in supports}
    for name in (name for name in table.ports if name not in supports):
        if name in nodes or name == "G":
            raise InputError(f"body.ports: name of a point must not be that of a node of the frame, got {name!r}")
        place = nodes[name] = np.array(table.ports[name], dtype=float)
        bracket = section.get(f"bracket_{name}", section[f"bracket_{PORTS['body'][0]}"])
        beams += [Beam(end, name, bracket) for end in sorted(structure, key=_distance(place, structure))[:SUPPORTS]]


def _distance(point: FloatArray, nodes: Mapping[str, FloatArray]) -> Callable[[str], float]:
    """Square of the distance of a node by its name."""
    return lambda name: float(np.sum((nodes[name] - point) ** 2))


def payload_frame(telescope: Telescope) -> BeamFrame:
    """Beam frame of the telescope payload (see the module docstring); nodes in the payload frame, m."""
    table, materials, optics = telescope.payload, telescope.materials, telescope.optics
    section = {name: _section(materials, spec) for name, spec in table.sections.items()}
    m1 = np.array([0.0, 0.0, table.m1_height])
    nodes = {
        "I_p": np.zeros(3),
        "M1": m1,
        "M2": m1 + [0.0, 0.0, optics.mirror_distance],
        "DET": np.array([*table.detector_xy, table.m1_height - optics.back_focal_distance]),
        "I_f": np.array(table.fsm_position, dtype=float),
    }
    beams: list[Beam] = []
    _bench(table, section, nodes, beams)
    _mirror_cell(table, section, nodes, beams)
    _tower(table, section, nodes, beams)
    for name, ends in (("I_f", ("bench", "spoke0", "spoke5")), ("DET", ("bench", "spoke2", "spoke3"))):
        beams += [Beam(end, name, section[f"bracket_{name}"]) for end in ends]
    masses = [_equipment(item, nodes) for item in table.equipment]
    return BeamFrame("payload", nodes, tuple(beams), tuple(masses))


def _bench(
    table: PayloadTable, section: Mapping[str, Section], nodes: dict[str, FloatArray], beams: list[Beam]
) -> None:
    """Six-sided bench on three feet from the isolator interface."""
    z, radius = table.bench_height, table.bench_radius
    nodes["bench"] = np.array([0.0, 0.0, z])
    for k, angle in enumerate(np.deg2rad(table.bench_angles)):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        nodes[f"ring{k}"] = nodes["bench"] + radius * direction
        nodes[f"spoke{k}"] = nodes["bench"] + 0.5 * radius * direction
    for k in range(6):
        beams += [
            Beam("bench", f"spoke{k}", section["spoke"]),
            Beam(f"spoke{k}", f"ring{k}", section["spoke"]),
            Beam(f"ring{k}", f"ring{(k + 1) % 6}", section["ring"], elements=2),
        ]
    beams.append(Beam("I_p", "bench", section["foot"]))
    beams += [Beam("I_p", f"spoke{k}", section["foot"]) for k in (0, 2, 4)]


def _mirror_cell(
    table: PayloadTable, section: Mapping[str, Section], nodes: dict[str, FloatArray], beams: list[Beam]
) -> None:
    """M1: a stiff three-armed blank on three bipods that stand on the bench ring."""
    for k, angle in enumerate(np.deg2rad(table.pad_angles)):
        nodes[f"pad{k}"] = nodes["M1"] + table.pad_radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        beams.append(Beam("M1", f"pad{k}", section["m1_blank"]))
        beams += [Beam(f"ring{2 * k + j}", f"pad{k}", section["bipod"], elements=2) for j in (0, 1)]
    beams += [Beam(f"pad{k}", f"pad{(k + 1) % 3}", section["m1_blank"]) for k in range(3)]


def _tower(
    table: PayloadTable, section: Mapping[str, Section], nodes: dict[str, FloatArray], beams: list[Beam]
) -> None:
    """M2: six struts up to a ring, three vanes inwards."""
    z = nodes["M2"][2]
    for k, angle in enumerate(np.deg2rad(table.tower_angles)):
        nodes[f"top{k}"] = np.array([0.0, 0.0, z]) + table.tower_radius * np.array([np.cos(angle), np.sin(angle), 0.0])
    beams += [
        Beam(f"ring{k}", f"top{((k + 1) // 2) % 3}", _scaled(section["strut"], factor), elements=2)
        for k, factor in enumerate(table.strut_factors)
    ]
    beams += [Beam(f"top{k}", f"top{(k + 1) % 3}", section["top_ring"], elements=2) for k in range(3)]
    beams += [Beam(f"top{k}", "M2", section["vane"], elements=2) for k in range(3)]


def _section(materials: Mapping[str, Material], spec: SectionTable) -> Section:
    """Section of a table such as ``{ shape = "bar", material = "cfrp", height = 0.06, width = 0.006 }``."""
    shapes: dict[str, Callable[..., Section]] = {"tube": tube, "box": box, "bar": bar}
    if spec.shape not in shapes:
        raise InputError(f"section shape must be one of {sorted(shapes)}, got {spec.shape!r}")
    if spec.material not in materials:
        raise InputError(f"section material must be one of {sorted(materials)}, got {spec.material!r}")
    return shapes[spec.shape](asdict(materials[spec.material]), **spec.size)


def _scaled(section: Section, factor: float) -> Section:
    """The same tube with a wall thinner or thicker by a few percent."""
    return replace(section, A=section.A * factor, Iy=section.Iy * factor, Iz=section.Iz * factor, J=section.J * factor)


def _equipment(item: Equipment, nodes: Mapping[str, FloatArray]) -> LumpedMass:
    """A unit with the inertia of a homogeneous block, fixed to the named node (default: the nearest)."""
    position = nodes[str(item.node)] if item.position is None else np.array(item.position, dtype=float)
    node = item.node or _nearest(position, nodes)
    a, b, c = item.size
    inertia = item.mass / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    return LumpedMass(node, item.mass, inertia, position - nodes[node], item.name)


def _nearest(point: FloatArray, nodes: Mapping[str, FloatArray]) -> str:
    return min(nodes, key=_distance(point, nodes))
