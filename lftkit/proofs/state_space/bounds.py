"""Bounds of an uncertain system by cells, for :func:`lftkit.proofs.worst_case_gain` and ``robust_stability``.

Branch and bound over the parameters and frequency: a cell whose inequality holds at the level is proven; one whose
inequality fails is bisected where that helps most, and looked into for a member with a larger gain.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.settings import BOUNDS, SEARCH, BoundSettings, SearchSettings
from lftkit.proofs.state_space.cells import Cell
from lftkit.proofs.state_space.circle import band_over_axis, over_axis, reached
from lftkit.proofs.state_space.cover import WHOLE, CellCover, posed_cells
from lftkit.proofs.state_space.disk_search import DiskMember, DiskSearch
from lftkit.proofs.state_space.disks import disks_of, dynamics_with, scaled_radii, without_disks
from lftkit.proofs.state_space.proof import Proof, finished, stable_member, statement
from lftkit.proofs.state_space.search import (
    Member,
    climbed,
    member_gain,
    scaled_box,
    smallest_unstable_factor,
    worst_member,
)
from lftkit.proofs.trusted.cells import frequencies
from lftkit.support.progress import Progress
from lftkit.systems.system import System
from lftkit.uncertainty.elements import ComplexParameter, RealParameter


@dataclass(frozen=True)
class ProvenBounds:
    """Two-sided bound.

    Parameters
    ----------
    lower : float
        Reached at `point` and `frequency`: a gain; for stability the factor of the box that is proven stable.
    upper : float
        Proven never to be exceeded; for stability the factor of the box with an unstable member at `point`.
        Infinite where nothing was proven (found).
    point : mapping of str to float
        Parameters of the worst member found: complex numbers for complex elements, for dynamics a stable
        :class:`System` that has this value at `frequency`.
    frequency : float
        Where it is worst [rad/s].
    proof : Proof, AxisProof or None
        Of `upper` (of `lower` for stability).
    status : str
        ``closed`` (the gap is reached), ``out_of_time``, ``unstable`` (the box contains an unstable member, or one
        that is not well posed: `point`), ``violated`` (the given level is exceeded at `point`).
    uncovered : tuple of Cell
        What no proof covers.
    """

    lower: float
    upper: float
    point: Mapping[str, float]
    frequency: float
    proof: Any
    status: str
    uncovered: tuple[Cell, ...] = ()


def checked_band(band: tuple[float, float], level: float | None) -> None:
    """Refuse a band or a level that makes no sense with a ValueError."""
    if level is not None and not level > 0.0:
        raise InputError(f"level must be positive, got {level}")
    if not 0.0 <= band[0] < band[1]:
        raise InputError(f"band must be two frequencies with 0 <= lower < upper, got {band}")


def intervals_of(system: System, box: Mapping[str, tuple[float, float]] | None) -> list[tuple[float, float]]:
    """Intervals in the order of the system's parameters.

    Raises
    ------
    ValueError
        Unknown names, or those of complex and dynamic elements, whose disk is always whole; ends in the wrong order or
        outside the range of the parameter.
    """
    stated = dict(box or {})
    for name, (low, high) in stated.items():
        parameter = system.parameter(name)
        if not low <= high:
            raise InputError(f"box of {name!r} must have lower <= upper, got {low} and {high}")
        parameter.check(low), parameter.check(high)
    return [
        (float(stated[p.name][0]), float(stated[p.name][1])) if p.name in stated else (p.lower, p.upper)
        for p in system.parameters
    ]


def require_nominal(system: System, box: Sequence[tuple[float, float]]) -> None:
    """Raise a ValueError where a box, in the order of the parameters, does not contain the nominal values."""
    if not all(low <= p.nominal <= high for p, (low, high) in zip(system.parameters, box)):
        raise InputError("box must contain the nominal values, got another")


def least_level(system: System, worst: Member, settings: BoundSettings = BOUNDS) -> float:
    """Level to be proven where the largest gain found is zero, or rounding of paths that cancel.

    In continuous time; the same in all units of signals, states and parameters, unless nothing goes through at all.
    """
    values = {p.name: float(v) for p, v in zip(system.parameters, worst.point)}
    A, B, C, D = without_disks(system).at(values, beyond_range=True).matrices
    paths = np.abs(D)
    if len(A) and np.isfinite(worst.frequency):
        unit = np.eye(len(A), dtype=complex)
        *_, inverse, info = linalg.lapack.zgesv(1j * worst.frequency * unit - A, unit)
        paths = paths if info else paths + np.abs(C) @ np.abs(inverse) @ np.abs(B)
    least = settings.negligible * float(linalg.norm(paths))
    if least == 0.0 and worst.gain == 0.0:
        q = len(system.channels)
        sides = (system.B[:, q:], system.D[:, q:]), (system.C[q:], system.D[q:])
        least = settings.negligible * max(float(np.hypot(linalg.norm(a), linalg.norm(b))) for a, b in sides)
    return max(least, settings.smallest)


@dataclass
class GainByCells:
    """Worst-case gain of a system with sorted channels; `box`: intervals in the order of its parameters.

    Members are searched over the axis that the frequencies of a system in discrete time are mapped to.
    """

    system: System
    box: list[tuple[float, float]]
    band: tuple[float, float]
    level: float | None
    options: BoundOptions

    def __post_init__(self) -> None:
        self.axis, self.over = over_axis(self.system), band_over_axis(self.band, self.system.dt)

    def run(self) -> ProvenBounds:
        """The bounds, with the proof of the upper one."""
        start, wall_limit, max_tests = time.monotonic(), self.options.wall_limit, self.options.max_tests
        self.worst = self.searched()
        if np.isinf(self.worst.gain):
            return self._bounds(np.inf, None, "unstable")
        self.least = least_level(self.axis, self.worst, self.options.settings)
        if self._violated():
            return self._bounds(np.inf, None, "violated")
        claim = statement(self.system, "gain", self.box, 1.0, self.over)
        cells = self.options.cells
        cover = CellCover.of(self.system, claim, Cell(tuple(self.box), self.over), settings=cells)
        with Progress("worst-case gain", self.options.progress) as bar:
            closed = cover.run(self._target, self._failed, start + 0.8 * wall_limit, max_tests, bar)
        if np.isinf(self.worst.gain):
            return self._bounds(np.inf, None, "unstable")
        if self._violated():
            return self._bounds(np.inf, None, "violated")
        upper = self._target()
        if not closed:
            upper = cover.leftover(upper, start + wall_limit)
        if np.isinf(upper):
            return self._bounds(np.inf, None, "out_of_time", tuple(cell for *_, cell in cover.open))
        point = np.array([0.5 * (low + high) for low, high in self.box])
        whole = self.over == WHOLE
        stable = stable_member(self.system, claim, point) if whole else None
        posed = posed_cells(self.system, claim, self.box, start + wall_limit, max_tests, cells)
        if posed is None or (whole and stable is None):
            return self._bounds(np.inf, None, "out_of_time", (Cell(tuple(self.box), self.over),))
        claim["claim"]["level"] = upper
        proof = finished(claim, cover.proven, stable, posed)
        return self._bounds(upper, proof, "closed" if closed else "out_of_time")

    def searched(self) -> Member:
        """The worst member that a search of the box finds before cells are proven."""
        options = self.options
        return worst_member(self.axis, self.box, self.over, seed=options.seed, settings=options.search)

    def _at_middle(self, cell: Cell) -> Member:
        """A member of a cell, or one that it leads to."""
        member = member_gain(self.axis, cell.middle(), self.over)
        if not member.gain > 0.98 * self.worst.gain:
            return member
        return climbed(self.axis, self.box, self.over, member, 60, self.options.search)

    def _target(self) -> float:
        """Level to be proven: that given, or a part of the gap above the largest gain found."""
        if self.level is not None:
            return self.level
        return max((1.0 + self.options.settings.share * self.options.gap) * self.worst.gain, self.least)

    def _violated(self) -> bool:
        return self.level is not None and self.worst.gain >= self.level

    def _failed(self, cell: Cell) -> bool:
        """Look for a larger gain in a cell that was not proven; True when there is nothing left to prove."""
        member = self._at_middle(cell)
        if member.gain > self.worst.gain:
            self.worst = member
        return bool(np.isinf(self.worst.gain)) or self._violated()

    def _bounds(self, upper: float, proof: Proof | None, status: str, uncovered: tuple[Cell, ...] = ()) -> ProvenBounds:
        worst, left = reached(self.system, self.worst), cells_of_system(self.system, uncovered)
        return ProvenBounds(worst.gain, upper, named_member(self.system, worst), worst.frequency, proof, status, left)


class DiskGainByCells(GainByCells):
    """The same for systems with complex or dynamic elements, members of which have values at a frequency."""

    def searched(self) -> Member:
        """The worst member that a search finds, values of complex and dynamic elements included."""
        self._search = DiskSearch(self.axis, self.box, self.over, self.options.seed, self.options.search)
        return self._search.worst_member()

    def _at_middle(self, cell: Cell) -> Member:
        low, high = cell.band
        return self._search.gain_near(cell.middle(), 0.5 * (low + high) if np.isfinite(high) else 2.0 * low)


def smallest_unstable(
    axis: System, box: list[tuple[float, float]], largest: float, seed: int, settings: SearchSettings = SEARCH
) -> tuple[float, Member]:
    """Smallest factor of the box that is found to have an unstable member, infinite if none was, and the member."""
    real = without_disks(axis)
    factor, point, frequency = smallest_unstable_factor(real, box, largest, seed=seed, settings=settings)
    worst = Member(np.inf, point, frequency)
    if disks_of(axis):
        unstable = DiskSearch(axis, box, WHOLE, seed, settings).unstable(min(largest, factor))
        if unstable is not None and unstable[0] < factor:
            factor, worst = unstable
    return factor, worst


def cells_of_system(system: System, cells: Sequence[Cell]) -> tuple[Cell, ...]:
    """Cells with frequencies in rad/s."""
    return tuple(Cell(cell.intervals, frequencies(cell.band, system.dt)) for cell in cells)


def named_member(system: System, member: Member) -> dict[str, Any]:
    """Values of a member's elements by name, as in :attr:`ProvenBounds.point`."""
    values: dict[str, Any] = {p.name: float(v) for p, v in zip(system.parameters, member.point)}
    for e in system.elements:
        if isinstance(e, RealParameter):
            continue
        deviation = member.disks.get(e.name) if isinstance(member, DiskMember) else None
        if isinstance(e, ComplexParameter):
            values[e.name] = e.nominal + (0.0 if deviation is None else complex(deviation[0, 0]))
        else:
            deviation = np.zeros((e.outputs, e.inputs), complex) if deviation is None else deviation
            values[e.name] = dynamics_with(deviation, member.frequency, system.dt)
    return values


@dataclass
class StabilityByCells:
    """Factor of the box that stays stable, up to `largest`, of a system with sorted channels.

    Raises
    ------
    ValueError
        A box without the nominal values.
    """

    system: System
    box: list[tuple[float, float]]
    largest: float
    options: BoundOptions

    def __post_init__(self) -> None:
        require_nominal(self.system, self.box)
        self.axis, self.until = over_axis(self.system), time.monotonic() + self.options.wall_limit
        self.nominal = np.array([p.nominal for p in self.system.parameters])

    def run(self, few: int | None = None) -> ProvenBounds:
        """The bounds; with `few` only the first factor is tried, with so many cells at most."""
        first = reached(self.system, member_gain(self.axis, self.nominal, WHOLE, gain=False))
        if np.isinf(first.gain):
            return ProvenBounds(0.0, 0.0, named_member(self.system, first), first.frequency, None, "unstable")
        options, settings = self.options, self.options.settings
        self.factor, self.worst = smallest_unstable(self.axis, self.box, self.largest, options.seed, options.search)
        target = self._aim()
        proof, lower = None, 0.0
        left: tuple[Cell, ...] = ()
        with Progress("robust stability", options.progress) as bar:
            for _ in range(settings.attempts):
                if time.monotonic() > self.until:
                    break
                proof, unstable, left = self._attempt(target, options.max_tests if few is None else few, bar)
                if proof is not None:
                    lower = target
                    break
                if unstable is not None:
                    self.worst, self.factor = unstable, factor_of(self.system, self.box, unstable.point)
                    target = self._aim()
                    continue
                if few is not None:
                    break
                target *= settings.lowered
        closed = proof is not None and (np.isinf(self.factor) or self.factor <= (1.0 + options.gap) * lower)
        worst, left = reached(self.system, self.worst), cells_of_system(self.system, () if proof else left)
        point, status = named_member(self.system, worst), "closed" if closed else "out_of_time"
        return ProvenBounds(lower, self.factor, point, worst.frequency, proof, status, left)

    def _aim(self) -> float:
        """Factor to be proven."""
        share = self.options.settings.share
        return self.factor / (1.0 + share * self.options.gap) if np.isfinite(self.factor) else self.largest

    def _attempt(
        self, target: float, tests: int, bar: Progress
    ) -> tuple[Proof | None, Member | None, tuple[Cell, ...]]:
        """Proof of a factor, or an unstable member that was found, and the cells that are open."""
        ends, radii = scaled_box(self.system, self.box, target), scaled_radii(self.system, target)
        claim = statement(self.system, "stability", ends, None, WHOLE, radii)
        cover = CellCover.of(self.system, claim, Cell(tuple(ends), WHOLE), settings=self.options.cells)
        members: list[Member] = []

        def unstable(cell: Cell) -> bool:
            member = member_gain(self.axis, cell.middle(), WHOLE, gain=False)
            if np.isinf(member.gain):
                members.append(member)
            return bool(members)

        closed = cover.run(lambda: 1.0, unstable, 0.3 * time.monotonic() + 0.7 * self.until, tests, bar)
        left = tuple(cell for *_, cell in cover.open)
        stable = stable_member(self.system, claim, self.nominal) if closed and not members else None
        posed = (
            posed_cells(self.system, claim, ends, self.until, tests, self.options.cells) if stable is not None else None
        )
        proof = finished(claim, cover.proven, stable, posed) if stable is not None and posed is not None else None
        return proof, members[0] if members else None, left


def factor_of(system: System, box: list[tuple[float, float]], point: FloatArray) -> float:
    """Factor of the scaled box on whose surface the point is."""
    factors = [0.0]
    for parameter, (low, high), value in zip(system.parameters, box, point):
        offset = value - parameter.nominal
        side = (low if offset < 0.0 else high) - parameter.nominal
        factors.append(offset / side if offset else 0.0)
    return float(max(factors))
