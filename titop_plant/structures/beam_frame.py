"""3-D frames of Euler-Bernoulli beams with lumped masses, reduced to modal data.

The elements are those of :mod:`titop_plant.structures.beam_element`. Small displacements, no preload,
no thermal state; lumped masses are rigid and act at a node through a rigid offset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.structures.beam_element import Section, beam_axes, element_matrices
from titop_plant.structures.clamped_modes import FreeStructure, clamped_body
from titop_plant.structures.kinematics import read_only, tau
from titop_plant.structures.modal_data import ModalData


@dataclass(frozen=True)
class Beam:
    """A straight beam between two nodes.

    Parameters
    ----------
    start, end : str
        Node names.
    section : Section
    up : array_like, shape (3,), optional
        A vector in the beam's local x-y plane (as NASTRAN's CBAR). Default: global z, or global y
        for a beam along z.
    elements : int
        Number of elements it is divided into.
    """

    start: str
    end: str
    section: Section
    up: FloatArray | None = None
    elements: int = 1

    def __post_init__(self) -> None:
        if self.elements < 1:
            raise InputError(f"beam {self.start}-{self.end}: elements must be at least 1, got {self.elements}")
        if self.up is not None:
            object.__setattr__(self, "up", read_only(self.up, (3,), f"beam {self.start}-{self.end}: up"))


@dataclass(frozen=True)
class LumpedMass:
    """A rigid body fixed to a node.

    Parameters
    ----------
    node : str
    mass : float
        kg.
    inertia : array_like, shape (3, 3)
        Tensor at its own centre of mass, kg m2.
    offset : array_like, shape (3,)
        From the node to its centre of mass, m.
    name : str
        For error messages and reports.
    """

    node: str
    mass: float
    inertia: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    name: str = ""

    def __post_init__(self) -> None:
        what = f"lumped mass {self.name or 'at ' + self.node!r}"
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise InputError(f"{what}: mass must not be negative, got {self.mass} kg")
        object.__setattr__(self, "inertia", read_only(self.inertia, (3, 3), f"{what}, inertia"))
        object.__setattr__(self, "offset", read_only(self.offset, (3,), f"{what}, offset"))

    def matrix(self) -> FloatArray:
        """Mass matrix (6 x 6) at the node."""
        lever = tau(self.offset, np.zeros(3))
        return np.asarray(lever.T @ block_diag(self.mass * np.eye(3), self.inertia) @ lever, dtype=float)


@dataclass(frozen=True)
class BeamFrame:
    """Nodes, beams and lumped masses.

    Parameters
    ----------
    name : str
        Name of the body.
    nodes : mapping of str to array_like, shape (3,)
        Positions in the body frame, m.
    beams : tuple of Beam
    masses : tuple of LumpedMass

    Raises
    ------
    ValueError
        A beam or a mass at an unknown node, a beam of no length or with ``up`` along it.

    Examples
    --------
    The first frequency of a clamped beam is 3.516 sqrt(EI/(rho A L^4)), here in the softer plane:

    >>> frame = BeamFrame("beam", {"P": [0, 0, 0], "C": [1, 0, 0]},
    ...                   (Beam("P", "C", Section(1.0, 1.0, 1.0, 1.0, 1e-4, 4e-4, 1.0), elements=6),))
    >>> float(round(to_modal_data(frame, "P", ["C"], n_modes=1).frequencies[0], 5))
    0.03516
    """

    name: str
    nodes: Mapping[str, FloatArray]
    beams: tuple[Beam, ...]
    masses: tuple[LumpedMass, ...] = ()

    def __post_init__(self) -> None:
        nodes = {key: read_only(xyz, (3,), f"{self.name}: node {key!r}") for key, xyz in self.nodes.items()}
        object.__setattr__(self, "nodes", MappingProxyType(nodes))
        object.__setattr__(self, "beams", tuple(self.beams))
        object.__setattr__(self, "masses", tuple(self.masses))
        for beam in self.beams:
            for node in (beam.start, beam.end):
                if node not in nodes:
                    raise InputError(
                        f"{self.name}: ends of beam {beam.start}-{beam.end} must be nodes, got unknown node {node!r}"
                    )
            beam_axes(nodes[beam.start], nodes[beam.end], beam.up, f"{self.name}: beam {beam.start}-{beam.end}")
        for mass in self.masses:
            if mass.node not in nodes:
                raise InputError(f"{self.name}: lumped mass {mass.name!r} must be at a node, got {mass.node!r}")

    def divided(self) -> BeamFrame:
        """The same frame with every beam divided into its elements, the inner nodes named ``start-end:k``."""
        return self._divided

    @cached_property
    def _divided(self) -> BeamFrame:
        nodes, beams = dict(self.nodes), []
        for beam in self.beams:
            start, end = self.nodes[beam.start], self.nodes[beam.end]
            inner = [f"{beam.start}-{beam.end}:{k}" for k in range(1, beam.elements)]
            for k, node in enumerate(inner, start=1):
                nodes[node] = start + (end - start) * (k / beam.elements)
            chain = [beam.start, *inner, beam.end]
            beams += [Beam(a, b, beam.section, beam.up) for a, b in pairwise(chain)]
        return BeamFrame(self.name, nodes, tuple(beams), self.masses)


def assemble(frame: BeamFrame) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Mass and stiffness matrices of the free frame.

    Returns
    -------
    names : tuple of str
        Nodes in order, inner nodes of divided beams included; six rows each (translation, rotation).
    M, K : ndarray, shape (6 N, 6 N)
        kg, kg m, kg m2 and N/m, N, N m.
    """
    fine = frame.divided()
    names = tuple(fine.nodes)
    first = {name: 6 * i for i, name in enumerate(names)}
    M, K = np.zeros((6 * len(names),) * 2), np.zeros((6 * len(names),) * 2)
    for beam in fine.beams:
        start, end = fine.nodes[beam.start], fine.nodes[beam.end]
        axes = beam_axes(start, end, beam.up, f"{frame.name}: beam {beam.start}-{beam.end}")
        stiffness, mass = element_matrices(beam.section, float(np.sqrt((end - start) @ (end - start))))
        turn = np.zeros((12, 12))
        for k in range(0, 12, 3):
            turn[k : k + 3, k : k + 3] = axes
        index = np.add.outer((first[beam.start], first[beam.end]), np.arange(6)).ravel()
        rows = index[:, None]
        K[rows, index] += turn.T @ stiffness @ turn
        M[rows, index] += turn.T @ mass @ turn
    for lump in fine.masses:
        index = np.arange(first[lump.node], first[lump.node] + 6)
        M[np.ix_(index, index)] += lump.matrix()
    return names, 0.5 * (M + M.T), 0.5 * (K + K.T)


def rigid_body_modes(frame: BeamFrame, names: Sequence[str], point: ArrayLike) -> FloatArray:
    """Displacement of every node for unit rigid motions about a point, shape (6 N, 6)."""
    nodes = frame.divided().nodes
    return np.vstack([tau(nodes[name], point) for name in names])


def to_modal_data(
    frame: BeamFrame,
    parent: str,
    ports: Sequence[str],
    n_modes: int | None = None,
    damping: float | ArrayLike = 0.005,
) -> ModalData:
    """Modal data of a frame clamped at a node.

    The rigid mass matrix comes from the same mass matrix as the modes, so the residual mass is positive
    semidefinite by construction, whatever the number of modes.

    Parameters
    ----------
    frame : BeamFrame
    parent : str
        The node that is clamped: the parent point P.
    ports : sequence of str
        Nodes that become child ports.
    n_modes : int, optional
        Number of lowest modes to keep. Default: all.
    damping : float or array_like, shape (n_modes,)
        Damping ratios.

    Returns
    -------
    ModalData
        Modes in ascending order of frequency. The sign of each mode is chosen so that its largest
        participation (scaled by the rigid mass) is positive: the same frame always gives the same signs.

    Raises
    ------
    ValueError
        Unknown node, more modes than degrees of freedom, a mechanism (motion without stiffness) or a node
        without mass.
    """
    for node in (parent, *ports):
        if node not in frame.nodes:
            raise InputError(f"{frame.name}: parent and ports must be of {list(frame.nodes)}, got {node!r}")
    names, M, K = assemble(frame)
    first = {name: 6 * k for k, name in enumerate(names)}
    rigid = rigid_body_modes(frame, names, frame.nodes[parent])
    rows = {port: (frame.nodes[port], slice(first[port], first[port] + 6)) for port in ports}
    clamped = np.arange(first[parent], first[parent] + 6)
    free = FreeStructure(frame.name, M, K, rigid)
    return clamped_body(free, (parent, frame.nodes[parent]), clamped, rows, n_modes, damping)
