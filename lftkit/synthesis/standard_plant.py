"""Plants for synthesis: ports in two groups, what the Riccati equations assume of them, weights and chains."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import balanced
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.support.state_units import in_balanced_units
from lftkit.synthesis.extended_plant import ExtendedPlant
from lftkit.synthesis.settings import SETTINGS, SynthesisSettings
from lftkit.systems import lft
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port, names_of_ports
from lftkit.systems.system import System

Names = str | Sequence[str]


@dataclass(frozen=True)
class StandardPlant:
    """A plant with its ports in two groups."""

    system: System
    measured: tuple[Port, ...]
    commanded: tuple[Port, ...]
    disturbances: tuple[Port, ...]
    errors: tuple[Port, ...]

    @property
    def extended(self) -> ExtendedPlant:
        """Matrices by the groups."""
        rows = [self.system.output_indices([p.name for p in ports]) for ports in (self.errors, self.measured)]
        columns = [self.system.input_indices([p.name for p in ports]) for ports in (self.disturbances, self.commanded)]
        A, B, C, D = self.system.matrices
        (z, y), (w, u) = rows, columns
        return ExtendedPlant(
            A, B[:, w], B[:, u], C[z], C[y], D[np.ix_(z, w)], D[np.ix_(z, u)], D[np.ix_(y, w)], D[np.ix_(y, u)]
        )  # fmt: skip

    def closed(self, controller: System) -> System:
        """The loop from disturbances to errors."""
        names = [[p.name for p in ports] for ports in (self.disturbances, self.errors)]
        return close_loop(self.system, controller, *names)


def standard_plant(
    plant: System, measured: Names, commanded: Names, settings: SynthesisSettings = SETTINGS
) -> StandardPlant:
    """A plant with its ports in two groups.

    Raises
    ------
    ValueError
        An uncertain plant, a port that it does not have, a group without ports, a mode that is not stable and that no
        command reaches or no measurement sees.
    """
    system = as_system(plant)
    system.require_certain()
    groups = []
    for names, ports, kind in ((measured, system.outputs, "outputs"), (commanded, system.inputs, "inputs")):
        chosen = names_of_ports(names, kind)
        known = {p.name: p for p in ports}
        if missing := [name for name in chosen if name not in known]:
            raise InputError(f"{kind} must be of {', '.join(known)}, got {', '.join(missing)}")
        rest = tuple(p for p in ports if p.name not in chosen)
        if not chosen or not rest:
            raise InputError(
                f"{system.name}: some {kind} must be the controller's and some not, got {', '.join(chosen)}"
            )
        groups.append((tuple(known[name] for name in chosen), rest))
    (seen, errors), (driven, disturbances) = groups
    # The system with other units of its states: the equations lose digits where they are far apart
    A, B, C, D = system.matrices
    standard = StandardPlant(
        System(*balanced(A, B, C), D, system.inputs, system.outputs, system.name, system.dt),
        seen,
        driven,
        disturbances,
        errors,
    )
    _require_stabilisable(standard, settings)
    return standard


def _require_stabilisable(standard: StandardPlant, settings: SynthesisSettings) -> None:
    """Refuse a mode that is not stable and that no command reaches or no measurement sees."""
    A, B, C, _ = standard.system.matrices
    B = B[:, standard.system.input_indices([p.name for p in standard.commanded])]
    C = C[standard.system.output_indices([p.name for p in standard.measured])]
    poles = standard.system.poles()
    scale = float(linalg.norm(A))
    for pole in poles:
        slow = abs(pole) < 1.0 if standard.system.dt else pole.real < -settings.axis * scale
        if slow:
            continue
        shifted = A - pole * np.eye(len(A))
        reached = f"reached from {', '.join(p.name for p in standard.commanded)}"
        seen = f"seen in {', '.join(p.name for p in standard.measured)}"
        for left, right, what in ((shifted, B, reached), (shifted.T, C.T, seen)):
            if not _has_full_row_rank(left, right, settings.unreached):
                where = f"{pole.real:.4g}" + (f" {pole.imag:+.4g}j" if pole.imag else "")
                stable = "not stable" if pole.real >= 0.0 or standard.system.dt else "not stable beyond rounding"
                raise InputError(
                    f"{standard.system.name}: the mode at {where} is {stable} and must be {what}; of a weight, move "
                    "the pole to the left"
                )


def _has_full_row_rank(left: ComplexArray, right: FloatArray, least: float) -> bool:
    """Whether no row of ``[left, right]`` follows from the others, in units of states and signals that do not matter.

    States are in units in which the rows and columns of both are alike, signals in those in which they are as large as
    what moves the states.
    """
    n = len(left)
    size = float(np.abs(left).max(initial=0.0)) or 1.0
    columns = np.abs(right).max(axis=0, initial=0.0)
    right = right[:, columns > 0.0] / columns[columns > 0.0] * size
    bordered = np.zeros((n + 1, n + 1))
    bordered[:n, :n], bordered[:n, n] = np.abs(left), np.abs(right).max(axis=1, initial=0.0)
    units = in_balanced_units(bordered)[1][:n]
    matrix = np.hstack([left * units / units[:, None], right / units[:, None]])
    sizes = np.abs(matrix).max(axis=1, initial=0.0)
    if not sizes.all():
        return False
    return bool(linalg.svdvals(matrix / sizes[:, None])[-1] > least)


def has_rank(matrix: FloatArray, least: int, ratio: float, size: float = 1.0) -> bool:
    """Whether a matrix has at least this rank, not zero.

    A singular value counts where its ratio to the largest one, or to `size` where that is larger, is above `ratio`.
    """
    sizes = linalg.svdvals(matrix) if min(matrix.shape) else np.zeros(0)
    return len(sizes) >= least > 0 and bool(sizes[least - 1] > ratio * max(size, float(sizes[0])))


def only_port(ports: tuple[Port, ...], kind: str, system: System) -> tuple[Port]:
    """The port of a side that must have one."""
    if len(ports) != 1:
        raise InputError(f"{system.name}: must have one {kind} port, got {', '.join(p.name for p in ports)}")
    return (ports[0],)


def weight_of(name: str, model: Any, size: int, dt: float) -> System:
    """A weight with the ports ``in`` and ``out``: what :func:`lftkit.as_system` takes, one channel for each of them.

    A weight without states has the period of the plant.
    """
    weight = as_system(model)
    A, B, C, D = weight.matrices
    if D.shape == (1, 1) and size > 1:
        A, B, C, D = (linalg.block_diag(*[M] * size) for M in (A, B, C, D))
    elif D.shape[1] != size:
        raise InputError(f"{name} must have {size} inputs or one, got {D.shape[1]}")
    return System(A, B, C, D, (Port("in", size),), (Port("out", len(D)),), name, weight.dt if len(A) else dt)


def chain(*systems: System, names: tuple[Port, Port] | None = None) -> System:
    """Systems in series, the first one first; ports of the first and the last, or those of `names`."""
    matrices = functools.reduce(lft.series, (system.matrices for system in systems))
    first, last = names or (systems[0].inputs[0], systems[-1].outputs[0])
    return System(*matrices, (first,), (last,), systems[-1].name, systems[0].dt)
