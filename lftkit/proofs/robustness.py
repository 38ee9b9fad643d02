"""Robust stability, worst-case gain and robust performance of uncertain systems: the method follows from the size."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.proofs.axis.bounds import axis_takes, gain_over_axis, stability_over_axis
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.state_space.bounds import (
    DiskGainByCells,
    GainByCells,
    ProvenBounds,
    StabilityByCells,
    checked_band,
    factor_of,
    intervals_of,
    named_member,
    require_nominal,
)
from lftkit.proofs.state_space.cover import WHOLE
from lftkit.proofs.state_space.disk_search import DiskMember, DiskSearch, searched_member
from lftkit.proofs.state_space.disks import disks_of, real_first
from lftkit.proofs.state_space.search import Member, first_true, member_gain, scaled_box
from lftkit.support.scalars import as_positive
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.system import System
from lftkit.uncertainty.elements import ComplexParameter, RealParameter

Box = list[tuple[float, float]]


@checked
def worst_case_gain(
    system: Any,
    box: Mapping[str, tuple[float, float]] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    band: tuple[float, float] = WHOLE,
    level: float | None = None,
    *,
    options: BoundOptions | None = None,
) -> ProvenBounds:
    """Largest gain of an uncertain system over a box of constant real parameters and a band of frequencies.

    Parameters
    ----------
    system : System, or what :func:`lftkit.systems.exchange.as_system` takes, as an expression
        In continuous or discrete time.
    box : mapping of str to (lowest, highest), optional
        Intervals inside the ranges of the parameters; the whole range of a parameter that is not named.
    inputs, outputs : sequence of str, optional
        Ports; all by default.
    band : (lower, upper)
        Frequencies [rad/s]; upper may be infinite. Only for the whole axis is every member shown to be stable.
    level : float, optional
        Prove the gain below this level, or find a member that exceeds it; without it the bounds are brought together.
    options : BoundOptions, optional

    Returns
    -------
    ProvenBounds
        `lower` is reached at `point` and `frequency`; `upper` is proven: ``check_proof(bounds.proof)``.

    Raises
    ------
    ValueError
        Unknown names; intervals outside the ranges; a band or a level that makes no sense; a method that cannot be
        used.

    Examples
    --------
    A resonance of damping ratio 0.05 with an uncertain stiffness; its peak is 1 / (2 zeta sqrt(1 - zeta^2) k):

    >>> from lftkit import Port, RealParameter
    >>> from lftkit.proofs import check_proof
    >>> k = RealParameter("stiffness", 1.0, 0.8, 1.2)
    >>> A, B, C = [[0, 1], [-1, -0.1]], [[0, 0], [-1, 1]], [[1, 0], [1, 0]]
    >>> mode = System(A, B, C, [[0, 0], [0, 0]], [("force", 1)], [("x", 1)], channels=("stiffness",), elements=(k,))
    >>> bounds = worst_case_gain(mode)
    >>> bounds.status, bounds.lower < bounds.upper < 1.05 * bounds.lower, round(bounds.point["stiffness"], 3)
    ('closed', True, 0.8)
    >>> check_proof(bounds.proof).level == bounds.upper
    True
    """
    checked_band(band, level)
    options = options or BoundOptions()
    chosen = real_first(as_system(system).select(inputs=inputs, outputs=outputs))
    ends = intervals_of(chosen, box)
    over_axis = _over_axis(chosen, ends, options, bool(chosen.inputs and chosen.outputs))
    with one_thread():
        if over_axis:
            return gain_over_axis(chosen, ends, band, level, options)[0]
        by_cells = DiskGainByCells if disks_of(chosen) else GainByCells
        return by_cells(chosen, ends, band, level, options).run()


def _over_axis(system: System, box: Box, options: BoundOptions, usual: bool = True) -> bool:
    """Whether the frequency axis is the method; what is chosen by size where none is given."""
    if options.method == "axis":
        system.require_continuous()
    if options.method is not None:
        return options.method == "axis"
    return usual and not system.dt and system.order > options.settings.few_states and axis_takes(system, box)


@checked
def robust_stability(
    system: Any,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    largest: float = 10.0,
    options: BoundOptions | None = None,
) -> ProvenBounds:
    """Largest factor by which the box, scaled about the nominal values, stays free of unstable members.

    Above 1 the box itself is stable. Factors up to `largest` are looked at: `upper` is infinite if no unstable member
    was found there.

    Parameters
    ----------
    system, options
        As for :func:`worst_case_gain`; ports do not matter.
    box : mapping of str to (lowest, highest), optional
        Intervals inside the ranges of the parameters that contain the nominal values.
    largest : float

    Returns
    -------
    ProvenBounds
        `lower` is proven, ``check_proof(bounds.proof)``; the member at `point`, on the surface of the box `upper`
        times as large, is unstable.

    Raises
    ------
    ValueError
        As for :func:`worst_case_gain`; also a box without the nominal values.

    Examples
    --------
    ``x' = (-1 + p) x`` with p in [-0.5, 0.5] is stable up to p = 1, twice the box:

    >>> from lftkit import RealParameter
    >>> p = RealParameter("p", 0.0, -0.5, 0.5)
    >>> lag = System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], (), (), channels=("p",), elements=(p,))
    >>> bounds = robust_stability(lag)
    >>> bounds.lower <= 2.0, round(bounds.upper, 6), bounds.upper / bounds.lower < 1.05
    (True, 2.0, True)
    """
    as_positive(largest, "largest")
    options = options or BoundOptions()
    chosen = real_first(as_system(system).select(inputs=(), outputs=()))
    ends = intervals_of(chosen, box)
    require_nominal(chosen, ends)
    over_axis = _over_axis(chosen, ends, options)
    with one_thread():
        if over_axis:
            return stability_over_axis(chosen, ends, largest, options)
        cells = StabilityByCells(chosen, ends, largest, options)
        few = options.settings.few_cells
        both = options.method is None and not chosen.dt and options.max_tests > few and axis_takes(chosen, ends)
        bounds = cells.run(few if both else None)
        if not both or bounds.status != "out_of_time":
            return bounds
        rest = replace(options, wall_limit=max(cells.until - time.monotonic(), 1e-3))
        return stability_over_axis(chosen, ends, largest, rest, (cells.factor, cells.worst))


@checked
def robust_performance(
    system: Any,
    level: float = 1.0,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    largest: float = 10.0,
    options: BoundOptions | None = None,
) -> ProvenBounds:
    """Largest factor by which the box, scaled about the nominal values, keeps the worst-case gain below a level.

    Disks of complex elements and bounds of dynamics are scaled by the same factor.

    Parameters
    ----------
    system : System, or what :func:`lftkit.systems.exchange.as_system` takes, as an expression
        In continuous time. Gain from all inputs to all outputs, over all frequencies; without any of them stability is
        what is left.
    level : float
    box : mapping of str to (lowest, highest), optional
        It contains the nominal values.
    largest : float
        Largest factor that is looked at.
    options : BoundOptions, optional
        The gap is that of the factors, the number of cells that of each factor.

    Returns
    -------
    ProvenBounds
        `lower` is a factor for which the level is proven; the member at `point`, on the surface of the box `upper`
        times as large, exceeds the level at `frequency` or is unstable. Status ``violated``: the nominal member does.

    Raises
    ------
    ValueError
        As for :func:`worst_case_gain`; also a nominal member that is outside of the box, or not stable.

    Examples
    --------
    The gain of ``1 / (s + 1 - p)`` with p in [-0.5, 0.5] is ``1 / (1 - p)``: 2 is reached at the end of the box.

    >>> from lftkit import Port, RealParameter
    >>> p, u, y = RealParameter("p", 0.0, -0.5, 0.5), (Port("u", 1),), (Port("y", 1),)
    >>> lag = System([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0, 0], [0, 0]], u, y, channels=("p",), elements=(p,))
    >>> bounds = robust_performance(lag, level=2.0)
    >>> bounds.lower <= 1.0 <= bounds.upper <= 1.05 * bounds.lower
    True
    """
    checked_band(WHOLE, level)
    as_positive(largest, "largest")
    options = options or BoundOptions()
    system = as_system(system)
    if not (system.inputs and system.outputs):
        return robust_stability(system, box, largest=largest, options=options)
    system.require_continuous()
    chosen = real_first(system)
    ends = intervals_of(chosen, box)
    usual = (chosen.order > options.settings.few_states or not disks_of(chosen)) and axis_takes(chosen, ends)
    over_axis = usual if options.method is None else options.method == "axis"
    with one_thread():
        return PerformanceProblem(chosen, ends, level, options, over_axis).bounds(largest)


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
    def search(self) -> DiskSearch:
        """The search of members of the box, with the nominal values and the complex and dynamic elements."""
        return DiskSearch(self.system, self.box, WHOLE, self.options.seed, self.options.search)

    def bounds(self, largest: float) -> ProvenBounds:
        """Bounds of the factor, up to `largest`.

        Raises
        ------
        ValueError
            A nominal member outside of the box, or not stable.
        """
        start, wall_limit, gap = time.monotonic(), self.options.wall_limit, self.options.gap
        until, settings = start + wall_limit, self.options.settings
        if not all(low <= at <= high for at, (low, high) in zip(self.search.nominal, self.box)):
            raise InputError("box must contain the nominal values, got another")
        first = member_gain(self.system, self.search.nominal, WHOLE)
        if np.isinf(first.gain):
            raise InputError(f"{self.system.name}: the nominal member must be stable, got an unstable one")
        if first.gain >= self.level:
            return self._named(0.0, 0.0, first, None, "violated")
        worst = self._least_found(largest, start + settings.search * wall_limit)
        lower, proof = 0.0, None
        aim = largest if worst is None else worst[0] / (1.0 + settings.share * gap)
        for _ in range(settings.factors):
            left = until - time.monotonic()
            if left <= 0.0:
                break
            bounds, member = self._attempt(aim, settings.attempt * left)
            if bounds.status == "closed":
                lower, proof = aim, bounds.proof
                break
            crossing = self._first_on_way(member) if bounds.status in ("violated", "unstable") else None
            if crossing is not None:
                worst, aim = crossing, crossing[0] / (1.0 + settings.share * gap)
            else:
                aim *= settings.less
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
        by_cells = DiskGainByCells if self.search.disks else GainByCells
        cells = by_cells(scaled, ends, WHOLE, self.level, options)
        return cells.run(), cells.worst

    def _least_found(self, largest: float, until: float) -> tuple[float, Member] | None:
        """The smallest factor at which a search finds a member that reaches the level, and that member; or None.

        No search begins after `until` but the first.
        """
        worst, factor, options = None, min(1.0, largest), self.options
        for step in range(options.settings.factors):
            if step and time.monotonic() > until:
                break
            scaled, ends = self._scaled(factor)
            member = searched_member(scaled, ends, WHOLE, options.seed, options.search)
            met = self._first_on_way(member)
            if met is not None:
                worst, factor = met, met[0] * options.settings.below
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
        if not self.search.disks and member.gain < self.level:
            return None
        away = member.point - self.search.nominal
        at: Callable[[float], Member] = (
            self._way_of_disks(member)
            if self.search.disks
            else lambda part: member_gain(self.system, self.search.nominal + part * away, WHOLE)
        )
        settings = self.options.settings
        grid = np.linspace(0.0, 1.0, settings.ray + 1)[1:]
        part = first_true(lambda share: at(share).gain >= self.level, grid, settings.ray_precision)
        return None if np.isinf(part) else (self._size(at(part)), at(part))

    def _way_of_disks(self, member: Member) -> Callable[[float], DiskMember]:
        """The same, with their gain at its frequency."""
        M = self.search.response(member.frequency)
        of_member: Mapping[str, ComplexArray] = member.disks if isinstance(member, DiskMember) else {}
        disks = {d.name: of_member.get(d.name, np.zeros((d.outputs, d.inputs), complex)) for d in self.search.disks}

        def at(part: float) -> DiskMember:
            real = np.asarray(part * (member.point - self.search.nominal))
            values = {name: np.asarray(part * value, complex) for name, value in disks.items()}
            return DiskMember(self.search.gain(M, real, values), self.search.nominal + real, member.frequency, values)

        return at

    def _size(self, member: Member) -> float:
        """Factor of the uncertainty on whose surface a member is."""
        values = member.disks if isinstance(member, DiskMember) else {}
        sizes = [float(linalg.norm(values[d.name], 2)) / d.radius for d in self.search.disks if d.name in values]
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
