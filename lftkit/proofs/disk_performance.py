"""Robust performance of systems with complex or dynamic elements: the factor of all uncertainty that keeps a gain.

The box of the real elements is scaled about the nominal values, disks and bounds of the others about zero. What exceeds
the level is looked for along rays to members that searches find; what stays below it is a proof, by cells or over the
frequency axis.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.axis.bounds import gain_over_axis
from lftkit.proofs.state_space.bounds import SHARE, WHOLE, Bounds, DiskGainByCells, member_named, named_member
from lftkit.proofs.state_space.circle import over_axis as axis_system
from lftkit.proofs.state_space.circle import reached
from lftkit.proofs.state_space.disk_search import DiskMember, DiskSearch
from lftkit.proofs.state_space.search import Member, member_gain, scaled_box
from lftkit.systems.system import System
from lftkit.uncertainty.elements import ComplexParameter
from lftkit.uncertainty.parameters import RealParameter

STEPS = 12
"""Most factors that are tried, by search and by proof."""
BELOW, LESS = 0.999, 0.75
"""Part of the smallest factor that reaches the level at which the next is looked for; of one not proven in time."""
PART, MAX_CELLS = 0.6, 5000
"""Part of the time that is left for the proof of a factor, and its most cells."""
RAY, PRECISION = 64, 1e-7
"""Points of a ray at which the gain is looked at, and the precision of the first one that reaches the level."""

Box = list[tuple[float, float]]


def disk_performance(
    system: System, box: Box, level: float, largest: float, gap: float, until: float, seed: int, over_axis: bool
) -> Bounds:
    """Largest factor of all elements that keeps the gain below a level; ``time.monotonic()`` ends it.

    Parameters
    ----------
    system : System
        With the channels of its real elements first, and inputs and outputs.
    box : list of (low, high)
        Of its real elements.
    over_axis : bool
        Whether proofs are those of the frequency axis.

    Raises
    ------
    ValueError
        A nominal member outside of the box, or not stable.
    """
    nominal = np.array([p.nominal for p in system.parameters])
    if not all(low <= p.nominal <= high for p, (low, high) in zip(system.parameters, box)):
        raise ValueError("box must contain the nominal values, got another")
    first = member_gain(axis_system(system), nominal, WHOLE)
    if np.isinf(first.gain):
        raise ValueError(f"{system.name}: the nominal member must be stable, got an unstable one")
    if first.gain >= level:
        return _bounds(system, 0.0, 0.0, first, None, "violated")
    worst = _least_found(system, box, level, largest, seed)
    lower, proof = 0.0, None
    aim = largest if worst is None else worst[0] / (1.0 + SHARE * gap)
    for _ in range(STEPS):
        left = until - time.monotonic()
        if left <= 0.0:
            break
        found, member = _attempt(system, box, aim, level, gap, PART * left, seed, over_axis)
        if found.status == "closed":
            lower, proof = aim, found.proof
            break
        met = _on_ray(system, box, aim, level, member, seed) if found.status in ("violated", "unstable") else None
        if met is not None:
            worst, aim = met, met[0] / (1.0 + SHARE * gap)
        else:
            aim *= LESS
    upper, member = (np.inf, first) if worst is None else worst
    closed = proof is not None and (upper <= (1.0 + gap) * lower or (worst is None and lower >= largest))
    return _bounds(system, lower, upper, member, proof, "closed" if closed else "out_of_time")


def _bounds(system: System, lower: float, upper: float, member: Member, proof: object, status: str) -> Bounds:
    found = reached(system, member)
    named = named_member(system, found) if np.isfinite(upper) else {}
    return Bounds(lower, upper, named, found.frequency if named else 0.0, proof, status)


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


def _attempt(
    system: System, box: Box, factor: float, level: float, gap: float, seconds: float, seed: int, over_axis: bool
) -> tuple[Bounds, Member]:
    """Try to prove the level for a factor; the bounds and the member that they name."""
    scaled, ends = scaled_elements(system, factor), scaled_box(system, box, factor)
    if over_axis:
        found = gain_over_axis(scaled, ends, WHOLE, level, gap, seconds, seed)
        return found, member_named(scaled, found)
    cells = DiskGainByCells(scaled, ends, WHOLE, level, gap, seconds, MAX_CELLS, seed, False)
    return cells.run(), cells.worst


def _least_found(system: System, box: Box, level: float, largest: float, seed: int) -> tuple[float, Member] | None:
    """The smallest factor at which a search finds a member that reaches the level, and that member; or None."""
    worst, factor = None, min(1.0, largest)
    for _ in range(STEPS):
        scaled, ends = axis_system(scaled_elements(system, factor)), scaled_box(system, box, factor)
        member = DiskSearch(scaled, ends, WHOLE, seed).worst_member()
        met = _on_ray(system, box, factor, level, member, seed)
        if met is not None:
            worst, factor = met, met[0] * BELOW
        elif worst is not None or factor >= largest:
            break
        else:
            factor = min(2.0 * factor, largest)
    return worst


def _on_ray(
    system: System, box: Box, factor: float, level: float, member: Member, seed: int
) -> tuple[float, Member] | None:
    """The first member that reaches the level on the way from the nominal one to `member`, at its frequency.

    `factor`: that of the uncertainty which `member` is one of. None where the level is not reached there.
    """
    axis = axis_system(system)
    search = DiskSearch(axis, box, WHOLE, seed)
    M = search.response(member.frequency)
    nominal = np.array([p.nominal for p in system.parameters])
    given = member.disks if isinstance(member, DiskMember) else {}
    zeros = {d.name: np.zeros((d.outputs, d.inputs), complex) for d in search.disks}
    disks = {**zeros, **given}

    def at(part: float) -> tuple[FloatArray, dict[str, ComplexArray], float]:
        real = np.asarray(part * (member.point - nominal))
        values = {name: np.asarray(part * value, complex) for name, value in disks.items()}
        return real, values, search.gain(M, real, values)

    part = _first(lambda share: at(share)[2] >= level)
    if part is None:
        return None
    real, values, gain = at(part)
    return part * factor, DiskMember(gain, nominal + real, member.frequency, values)


def _first(condition: Callable[[float], bool]) -> float | None:
    """The least number in (0, 1] at which a condition holds, among :data:`RAY` and between two of them; or None."""
    low = 0.0
    for high in np.linspace(0.0, 1.0, RAY + 1)[1:]:
        if condition(float(high)):
            break
        low = float(high)
    else:
        return None
    up = float(high)
    while up - low > PRECISION * up:
        middle = 0.5 * (low + up)
        low, up = (low, middle) if condition(middle) else (middle, up)
    return up
