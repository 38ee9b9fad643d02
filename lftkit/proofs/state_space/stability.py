"""The largest factor of a box without unstable members, proven by cells."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.state_space.bounds import (
    SHARE,
    ProvenBounds,
    cells_of_system,
    named_member,
    require_nominal,
    smallest_unstable,
)
from lftkit.proofs.state_space.cells import Cell
from lftkit.proofs.state_space.circle import over_axis, reached
from lftkit.proofs.state_space.cover import WHOLE, CellCover, posed_cells
from lftkit.proofs.state_space.disks import scaled_radii
from lftkit.proofs.state_space.proof import Proof, finished, stable_member, statement
from lftkit.proofs.state_space.search import Member, member_gain, scaled_box
from lftkit.support.progress import Progress
from lftkit.systems.system import System

ATTEMPTS = 12
"""Factors of the box that are tried for stability, each 0.7 of the one before unless an unstable member was found."""


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
        self.factor, self.worst = smallest_unstable(self.axis, self.box, self.largest, self.options.seed)
        target = self._aim()
        proof, lower = None, 0.0
        left: tuple[Cell, ...] = ()
        with Progress("robust stability", self.options.progress) as bar:
            for _ in range(ATTEMPTS):
                if time.monotonic() > self.until:
                    break
                proof, found, left = self._attempt(target, self.options.max_tests if few is None else few, bar)
                if proof is not None:
                    lower = target
                    break
                if found is not None:
                    self.worst, self.factor = found, factor_of(self.system, self.box, found.point)
                    target = self._aim()
                    continue
                if few is not None:
                    break
                target *= 0.7
        gap = self.options.gap
        closed = proof is not None and (np.isinf(self.factor) or self.factor <= (1.0 + gap) * lower)
        worst, left = reached(self.system, self.worst), cells_of_system(self.system, () if proof else left)
        point, status = named_member(self.system, worst), "closed" if closed else "out_of_time"
        return ProvenBounds(lower, self.factor, point, worst.frequency, proof, status, left)

    def _aim(self) -> float:
        """Factor to be proven."""
        return self.factor / (1.0 + SHARE * self.options.gap) if np.isfinite(self.factor) else self.largest

    def _attempt(
        self, target: float, tests: int, bar: Progress
    ) -> tuple[Proof | None, Member | None, tuple[Cell, ...]]:
        """Proof of a factor, or an unstable member that was found, and the cells that are open."""
        ends, radii = scaled_box(self.system, self.box, target), scaled_radii(self.system, target)
        claim = statement(self.system, "stability", ends, None, WHOLE, radii)
        cover = CellCover.of(self.system, claim, Cell(tuple(ends), WHOLE))
        found: list[Member] = []

        def unstable(cell: Cell) -> bool:
            member = member_gain(self.axis, cell.middle(), WHOLE, gain=False)
            if np.isinf(member.gain):
                found.append(member)
            return bool(found)

        closed = cover.run(lambda: 1.0, unstable, 0.3 * time.monotonic() + 0.7 * self.until, tests, bar)
        left = tuple(cell for *_, cell in cover.open)
        stable = stable_member(self.system, claim, self.nominal) if closed and not found else None
        posed = posed_cells(self.system, claim, ends, self.until, tests) if stable is not None else None
        proof = finished(claim, cover.proven, stable, posed) if stable is not None and posed is not None else None
        return proof, found[0] if found else None, left


def factor_of(system: System, box: list[tuple[float, float]], point: FloatArray) -> float:
    """Factor of the scaled box on whose surface the point is."""
    factors = [0.0]
    for parameter, (low, high), value in zip(system.parameters, box, point):
        offset = value - parameter.nominal
        side = (low if offset < 0.0 else high) - parameter.nominal
        factors.append(offset / side if offset else 0.0)
    return float(max(factors))
