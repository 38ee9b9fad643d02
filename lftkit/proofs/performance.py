"""Robust performance: the factor of all uncertainty that keeps a gain.

The box of the real elements is scaled about the nominal values, disks and bounds of the others about zero. What reaches
the level is looked for on the way to members that searches find; what stays below it is a proof, by cells or over the
frequency axis.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.proofs.axis.bounds import gain_over_axis
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.state_space.bounds import SHARE, DiskGainByCells, GainByCells, ProvenBounds, factor_of, named_member
from lftkit.proofs.state_space.cover import WHOLE
from lftkit.proofs.state_space.disk_search import DiskMember, DiskSearch
from lftkit.proofs.state_space.disks import DiskChannels, disks_of
from lftkit.proofs.state_space.search import Member, first_true, member_gain, scaled_box, worst_member
from lftkit.systems.system import System
from lftkit.uncertainty.elements import ComplexParameter
from lftkit.uncertainty.parameters import RealParameter

STEPS = 12
"""Most factors that are tried, by search and by proof."""
BELOW, LESS = 0.999, 0.75
"""Part of the smallest factor that reaches the level at which the next is looked for; of one not proven in time."""
SEARCH, PART = 0.4, 0.6
"""Part of the time after which no further factor is searched; part of what is left for the proof of a factor."""
RAY, PRECISION = 64, 1e-7
"""Points of a ray at which the gain is looked at, and the precision of the first one that reaches the level."""

Box = list[tuple[float, float]]


@dataclass(frozen=True)
class PerformanceProblem:
    """The question: a system in continuous time, with the channels of its real elements first, and a level.

    Parameters
    ----------
    system : System
    box : list of (low, high)
        Of its real elements.
    level : float
    options : BoundOptions
    over_axis : bool
        Whether proofs are those of the frequency axis; by cells otherwise.
    """

    system: System
    box: Box
    level: float
    options: BoundOptions
    over_axis: bool

    @cached_property
    def nominal(self) -> FloatArray:
        """Nominal values of the real elements (p,)."""
        return np.array([p.nominal for p in self.system.parameters])

    @cached_property
    def disks(self) -> list[DiskChannels]:
        """Complex and dynamic elements."""
        return disks_of(self.system)

    def bounds(self, largest: float) -> ProvenBounds:
        """Bounds of the factor, up to `largest`.

        Raises
        ------
        ValueError
            A nominal member outside of the box, or not stable.
        """
        start, wall_limit, gap = time.monotonic(), self.options.wall_limit, self.options.gap
        until = start + wall_limit
        if not all(low <= at <= high for at, (low, high) in zip(self.nominal, self.box)):
            raise InputError("box must contain the nominal values, got another")
        first = member_gain(self.system, self.nominal, WHOLE)
        if np.isinf(first.gain):
            raise InputError(f"{self.system.name}: the nominal member must be stable, got an unstable one")
        if first.gain >= self.level:
            return self._named(0.0, 0.0, first, None, "violated")
        worst = self._least_found(largest, start + SEARCH * wall_limit)
        lower, proof = 0.0, None
        aim = largest if worst is None else worst[0] / (1.0 + SHARE * gap)
        for _ in range(STEPS):
            left = until - time.monotonic()
            if left <= 0.0:
                break
            found, member = self._attempt(aim, PART * left)
            if found.status == "closed":
                lower, proof = aim, found.proof
                break
            met = self._first_on_way(member) if found.status in ("violated", "unstable") else None
            if met is not None:
                worst, aim = met, met[0] / (1.0 + SHARE * gap)
            else:
                aim *= LESS
        upper, member = (np.inf, first) if worst is None else worst
        closed = proof is not None and (upper <= (1.0 + gap) * lower or (worst is None and lower >= largest))
        return self._named(lower, upper, member, proof, "closed" if closed else "out_of_time")

    def _named(self, lower: float, upper: float, member: Member, proof: object, status: str) -> ProvenBounds:
        named = named_member(self.system, member) if np.isfinite(upper) else {}
        return ProvenBounds(lower, upper, named, member.frequency if named else 0.0, proof, status)

    def _scaled(self, factor: float) -> tuple[System, Box]:
        return scaled_elements(self.system, factor), scaled_box(self.system, self.box, factor)

    def _attempt(self, factor: float, seconds: float) -> tuple[ProvenBounds, Member]:
        """Try to prove the level for a factor; the bounds and the worst member."""
        scaled, ends = self._scaled(factor)
        options = replace(self.options, wall_limit=seconds)
        if self.over_axis:
            return gain_over_axis(scaled, ends, WHOLE, self.level, options)
        by_cells = DiskGainByCells if self.disks else GainByCells
        cells = by_cells(scaled, ends, WHOLE, self.level, options)
        return cells.run(), cells.worst

    def _least_found(self, largest: float, until: float) -> tuple[float, Member] | None:
        """The smallest factor at which a search finds a member that reaches the level, and that member; or None.

        No search begins after `until` but the first.
        """
        worst, factor = None, min(1.0, largest)
        for step in range(STEPS):
            if step and time.monotonic() > until:
                break
            scaled, ends = self._scaled(factor)
            if self.disks:
                member = DiskSearch(scaled, ends, WHOLE, self.options.seed).worst_member()
            else:
                member = worst_member(scaled, ends, WHOLE, seed=self.options.seed)
            met = self._first_on_way(member)
            if met is not None:
                worst, factor = met, met[0] * BELOW
            elif worst is not None or factor >= largest:
                break
            else:
                factor = min(2.0 * factor, largest)
        return worst

    def _first_on_way(self, member: Member) -> tuple[float, Member] | None:
        """The first member that reaches the level on the way from the nominal one to `member`, and its factor.

        Where there are complex elements or dynamics, the gain is that at the member's frequency. None where the level
        is not reached.
        """
        if not self.disks and member.gain < self.level:
            return None
        at = self._way_of_disks(member) if self.disks else self._way(member)
        part = first_true(lambda share: at(share).gain >= self.level, np.linspace(0.0, 1.0, RAY + 1)[1:], PRECISION)
        return None if np.isinf(part) else (self._size(at(part)), at(part))

    def _way(self, member: Member) -> Callable[[float], Member]:
        """Members by their part of the way to one, with their largest gain."""
        away = member.point - self.nominal
        return lambda part: member_gain(self.system, self.nominal + part * away, WHOLE)

    def _way_of_disks(self, member: Member) -> Callable[[float], DiskMember]:
        """The same, with their gain at its frequency."""
        search = DiskSearch(self.system, self.box, WHOLE, self.options.seed)
        M = search.response(member.frequency)
        given: Mapping[str, ComplexArray] = member.disks if isinstance(member, DiskMember) else {}
        disks = {d.name: given.get(d.name, np.zeros((d.outputs, d.inputs), complex)) for d in self.disks}

        def at(part: float) -> DiskMember:
            real = np.asarray(part * (member.point - self.nominal))
            values = {name: np.asarray(part * value, complex) for name, value in disks.items()}
            return DiskMember(search.gain(M, real, values), self.nominal + real, member.frequency, values)

        return at

    def _size(self, member: Member) -> float:
        """Factor of the uncertainty on whose surface a member is."""
        values = member.disks if isinstance(member, DiskMember) else {}
        sizes = [float(linalg.norm(values[d.name], 2)) / d.radius for d in self.disks if d.name in values]
        return max([factor_of(self.system, self.box, member.point), *sizes])


def scaled_elements(system: System, factor: float) -> System:
    """The system with the disks of its complex and the bounds of its dynamic elements times a factor."""
    elements = tuple(
        e
        if isinstance(e, RealParameter)
        else replace(e, radius=factor * e.radius)
        if isinstance(e, ComplexParameter)
        else replace(e, bound=factor * e.bound)
        for e in system.elements
    )
    return replace(system, elements=elements)
