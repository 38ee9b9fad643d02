"""Cells that cover a box of parameters and frequency: proven ones, and open ones that are bisected."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.proofs.settings import CELLS, CellSettings
from lftkit.proofs.state_space.cells import Cell, CellTest, SingularCellError
from lftkit.proofs.state_space.circle import over_axis, static_part
from lftkit.proofs.state_space.proof import proven_cell
from lftkit.proofs.trusted.cells import Inequality
from lftkit.support.progress import Progress
from lftkit.systems.system import System

WHOLE = (0.0, np.inf)
"""Band of all frequencies."""


@dataclass
class CellCover:
    """Cells that are proven and cells that are open."""

    test: CellTest
    inequality: Inequality
    open: list[tuple[float, int, Cell]]
    proven: list[dict[str, Any]] = field(default_factory=list)
    number: Any = field(default_factory=itertools.count)

    @classmethod
    def of(
        cls,
        system: System,
        claim: dict[str, Any],
        cell: Cell,
        static: bool = False,
        settings: CellSettings = CELLS,
    ) -> CellCover:
        """One open cell; `static`: of the channels without states."""
        part = static_part(system) if static else over_axis(system)
        radii = {disk["name"]: disk["radius"] for disk in claim["plant"].get("disks", [])}
        gain = claim["claim"]["property"] == "gain" and not static
        cover = cls(CellTest(part, gain, radii, settings), Inequality(claim, static), [])
        cover.push(0.0, cell)
        return cover

    def push(self, rank: float, cell: Cell) -> None:
        """Add an open cell; those of low rank are tried first."""
        heapq.heappush(self.open, (rank, next(self.number), cell))

    def prove(self, cell: Cell, level: float, until: float) -> int | None:
        """None if the cell is proven and kept, else the axis to bisect."""
        try:
            scalings, axis = self.test.solve(cell, level, until)
        except SingularCellError:
            return len(cell.intervals)
        if scalings is not None:
            content = proven_cell(cell, scalings)
            with suppress(ValueError, ArithmeticError):  # a number out of range: the cell stays open
                if self.inequality.ratio(content, level) >= 1.0:
                    self.proven.append(content)
                    return None
        return axis

    def run(
        self, level: Callable[[], float], failed: Callable[[Cell], bool], until: float, tests: int, bar: Progress
    ) -> bool:
        """Prove and bisect until nothing is open (True), time or tests are used up, or `failed` says stop."""
        for _ in range(tests):
            if not self.open:
                break
            bar.report(len(self.proven), len(self.proven) + len(self.open), best=level())
            if time.monotonic() > until:
                return False
            rank, _, cell = heapq.heappop(self.open)
            axis = self.prove(cell, level(), until)
            if axis is None:
                continue
            for half in cell.split(axis, self.test.reference):
                self.push(rank + 1.0, half)
            if failed(cell):
                return False
        return not self.open

    def leftover(self, level: float, until: float) -> float:
        """Try the open cells at higher levels; the level at which all are proven, infinite if some are not."""
        highest = level
        for factor in self.test.settings.raised:
            waiting, self.open = self.open, []
            for rank, number, cell in waiting:
                if time.monotonic() > until or self.prove(cell, factor * level, until) is not None:
                    self.open.append((rank, number, cell))
                else:
                    highest = factor * level
            if not self.open:
                return highest
        return np.inf


def posed_cells(
    system: System,
    claim: dict[str, Any],
    box: Sequence[tuple[float, float]],
    until: float,
    tests: int,
    settings: CellSettings = CELLS,
) -> list[dict[str, Any]] | None:
    """Cells that show that members are well posed, of a system in discrete time; None if they do not cover the box."""
    if not system.dt:
        return []
    cover = CellCover.of(system, claim, Cell(tuple(box), WHOLE), static=True, settings=settings)
    with Progress("well-posed members", False) as bar:
        return cover.proven if cover.run(lambda: 1.0, lambda cell: False, until, tests, bar) else None
