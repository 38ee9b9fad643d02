"""Worst-case gain and robust stability of systems with many states and parameters, proven over the frequency axis.

The prover is that of :mod:`lftkit.proofs.sampled_loop`: scalings at frequencies, interpolated, bisection of the box
where there are none. Members with large gains and unstable members are searched as for
:mod:`lftkit.proofs.state_space`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.proofs.axis.proof import AxisModel, AxisProof
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.sampled_loop.bounds import BisectionOptions, prove_level
from lftkit.proofs.settings import BOUNDS
from lftkit.proofs.state_space.bounds import ProvenBounds, least_level, named_member, smallest_unstable
from lftkit.proofs.state_space.cells import Cell
from lftkit.proofs.state_space.cover import WHOLE
from lftkit.proofs.state_space.disk_search import DiskMember, DiskSearch, searched_member
from lftkit.proofs.state_space.disks import DiskChannels, disks_of, real_first, scaled_radii
from lftkit.proofs.state_space.search import Member, climbed, member_gain, scaled_box
from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL, Interval, Strip
from lftkit.support.state_units import in_balanced_units
from lftkit.systems.system import System

SEPARATE = "the nominal member must be in the box, stable, with separate poles, got another"
Box = tuple[Interval, ...]
Piece = tuple[bool, Box, Interval]


@dataclass
class _Axis:
    """The proof of one claim as far as it is: strips on both sides of the border, and the pieces that are left."""

    proof: AxisProof
    model: AxisModel
    disks: list[DiskChannels]
    pieces: list[Piece]
    options: BoundOptions
    strips: dict[bool, list[Strip]] = field(default_factory=lambda: {False: [], True: []})
    worst: DiskMember | None = None

    @classmethod
    def of(
        cls,
        system: System,
        kind: str,
        box: Sequence[Interval],
        band: Interval,
        radii: Mapping[str, float] | None = None,
        options: BoundOptions | None = None,
    ) -> _Axis:
        """An empty proof for a system whose channels are sorted, those of real elements first.

        `radii`: of complex numbers and dynamics by name, in the place of their own.

        Raises
        ------
        ValueError
            There is no element, or a matrix of dynamics occurs more than once; the nominal member is not in the box,
            not stable, or its poles can't be separated.
        """
        if not system.elements:
            raise InputError("the system must have uncertain elements, got none")
        options = options or BoundOptions()
        q, disks = len(system.channels), disks_of(system, radii)
        inner = slice(0, q if kind == "stability" else None)
        names = [p.name for p in system.parameters]
        groups = [tuple(i for i, channel in enumerate(system.channels) if channel == name) for name in names]
        poles, T, X = modal_form(system.A, options.settings.basis)
        fastest = 4.0 * float(np.abs(poles).max(initial=0.25))
        border = 2.0 ** math.ceil(math.log2(max(fastest, band[0], 1e-100)))
        model = AxisModel(
            np.array(system.A),
            np.array(system.B[:, inner]),
            np.array(system.C[inner]),
            np.array(system.D[inner, inner]),
            poles,
            T,
            X,
            (*groups, *(disk.channels for disk in disks)),
            (*(REAL for _ in names), *(FULL if disk.full else COMPLEX for disk in disks)),
            False,
        )
        proof = AxisProof(
            kind,
            None,
            (*names, *(disk.name for disk in disks)),
            (*(p.nominal for p in system.parameters), *(0.0 for _ in disks)),
            (*((float(low), float(high)) for low, high in box), *((-disk.radius, disk.radius) for disk in disks)),
            band,
            model,
            border,
        )
        if not all(low <= 0.0 <= high for low, high in proof.deviations) or not proof.system.nominal_stable():
            raise InputError(SEPARATE)
        widths = [p.upper - p.lower or options.cells.no_scale for p in system.parameters]
        least = [options.cells.narrow * width for width in widths]  # deviations are wide enough for scalings
        whole = tuple(
            (min(low, -half), max(high, half)) if high - low < half else (low, high)
            for (low, high), half in zip(proof.deviations, least)
        )
        whole += proof.deviations[len(widths) :]
        high = min(band[1], border) if math.isinf(band[1]) else band[1]
        pieces: list[Piece] = [(False, whole, (band[0], high))] if band[0] < high else []
        if math.isinf(band[1]):
            pieces.append((True, whole, (0.0, 1.0 / border)))
        return cls(proof, model, disks, pieces, options)

    def prove(self, level: float, until: float) -> bool:
        """Prove the pieces that are left, those of one band together; True if none is left now."""
        waiting, self.pieces = _together(self.pieces), []
        options = BisectionOptions(self.options.settings.axis_part, seed=self.options.seed)
        for number, (beyond, box, band) in enumerate(waiting):
            if time.monotonic() > until or (self.worst is not None and self.worst.gain >= level):
                self.pieces += waiting[number:]
                break
            model = replace(self.model, beyond=beyond)
            proof = prove_level(model, box, band, level, until=until, options=options, part=True)
            self.strips[beyond] += proof.strips
            self.pieces += [(beyond, piece, ends) for piece, ends in proof.uncovered]
            if proof.point is not None and (self.worst is None or proof.lower > self.worst.gain):
                # A member that was met, in which complex and dynamic elements have real values
                omega = 1.0 / proof.omega if beyond else proof.omega
                values = np.clip(proof.point + np.array(self.proof.nominal), *np.array(self.proof.box).T)
                count = len(values) - len(self.disks)
                of_disks = zip(self.disks, values[count:])
                disks = {
                    disk.name: value * np.eye(disk.outputs, disk.inputs, dtype=complex) for disk, value in of_disks
                }
                self.worst = DiskMember(proof.lower, values[:count], omega, disks)
        return not self.pieces

    def finished(self, level: float | None) -> AxisProof:
        """The proof with its strips."""
        return replace(self.proof, level=level, below=tuple(self.strips[False]), above=tuple(self.strips[True]))

    def uncovered(self) -> tuple[Cell, ...]:
        """Pieces that are left, as cells."""
        cells = []
        real = len(self.proof.box) - len(self.disks)
        for beyond, box, (low, high) in self.pieces:
            ends = tuple((at + a, at + b) for at, (a, b) in zip(self.proof.nominal[:real], box))
            above = 1.0 / low if low > 0.0 else math.inf
            cells.append(Cell(ends, (1.0 / high, above) if beyond else (low, high)))
        return tuple(cells)


def axis_takes(system: System, box: Sequence[Interval]) -> bool:
    """Whether a box of a system is one for this method: the nominal member in it, stable, with separate poles."""
    try:
        _Axis.of(real_first(system), "stability", box, WHOLE)
    except ValueError:
        return False
    return True


def gain_over_axis(
    system: System,
    box: list[Interval],
    band: Interval,
    level: float | None,
    options: BoundOptions,
) -> tuple[ProvenBounds, Member]:
    """Worst-case gain of a system with sorted channels, and the worst member found.

    `box` has intervals in the order of the parameters, which may leave their ranges.

    Raises
    ------
    ValueError
        The nominal member is not in the box, is not stable, or its poles can't be separated; no uncertain element.
    """
    start, gap, wall_limit, settings = time.monotonic(), options.gap, options.wall_limit, options.settings
    worst = searched_member(system, box, band, options.seed, options.search)
    axis = _Axis.of(system, "gain", box, band, options=options) if np.isfinite(worst.gain) else None

    def bounds(upper: float, status: str) -> tuple[ProvenBounds, Member]:
        proof = axis.finished(upper) if axis is not None and np.isfinite(upper) else None
        left = axis.uncovered() if axis is not None and proof is None and status == "out_of_time" else ()
        return ProvenBounds(worst.gain, upper, named_member(system, worst), worst.frequency, proof, status, left), worst

    if axis is None:
        return bounds(np.inf, "unstable")
    while True:
        least = least_level(system, worst, settings)
        target = level if level is not None else max((1.0 + settings.share * gap) * worst.gain, least)
        if worst.gain >= target:
            return bounds(np.inf, "violated")
        closed = axis.prove(target, start + settings.first * wall_limit)
        if axis.worst is None or axis.worst.gain <= worst.gain:
            break
        # A member that was met in the proof, climbed
        met, before = axis.worst, worst
        if met.disks:
            reached: Member = DiskSearch(system, box, band, options.seed, options.search).climbed(met)
        else:
            reached = member_gain(system, met.point, band)
            reached = climbed(system, box, band, reached, settings=options.search)  # an unstable one as it is
        worst = reached if reached.gain > worst.gain else worst
        if np.isinf(worst.gain):
            return bounds(np.inf, "unstable")
        if closed or worst.gain <= before.gain * (1.0 + 1e-6) or time.monotonic() - start > settings.first * wall_limit:
            break
    if level is not None and worst.gain >= level:
        return bounds(np.inf, "violated")
    upper = target
    for factor in () if closed else settings.axis_raised:
        upper = factor * max(target, worst.gain)
        now = time.monotonic()
        if axis.prove(upper, now + 0.5 * (start + wall_limit - now)):
            break
    if axis.pieces:
        return bounds(np.inf, "out_of_time")
    aim = max((1.0 + gap) * worst.gain, least_level(system, worst, settings)) if level is None else level
    return bounds(upper, "closed" if upper <= aim else "out_of_time")


def stability_over_axis(
    system: System,
    box: list[Interval],
    largest: float,
    options: BoundOptions,
    known: tuple[float, Member] | None = None,
) -> ProvenBounds:
    """Factor of the box that stays stable, up to `largest`; system, box and errors as for :func:`gain_over_axis`.

    `known`: the smallest factor with an unstable member, and the member, where that was searched already.
    """
    until, gap, settings = time.monotonic() + options.wall_limit, options.gap, options.settings
    nominal = np.array([p.nominal for p in system.parameters])
    first = member_gain(system, nominal, WHOLE, gain=False)
    if np.isinf(first.gain):
        return ProvenBounds(0.0, 0.0, named_member(system, first), first.frequency, None, "unstable")
    factor, worst = known or smallest_unstable(system, box, largest, options.seed, options.search)
    point = named_member(system, worst)
    aim = factor / (1.0 + settings.share * gap) if np.isfinite(factor) else largest
    left: tuple[Cell, ...] = ()
    for number, part in enumerate(settings.axis_lowered):
        scaled = scaled_box(system, box, part * aim), WHOLE, scaled_radii(system, part * aim)
        axis = _Axis.of(system, "stability", *scaled, options)
        now = time.monotonic()
        share = settings.first if number == 0 else 0.5
        if axis.prove(1.0, now + share * (until - now)):
            lower = part * aim
            closed = (np.isinf(factor) and part == 1.0) or factor <= (1.0 + gap) * lower
            status = "closed" if closed else "out_of_time"
            return ProvenBounds(lower, factor, point, worst.frequency, axis.finished(None), status)
        left = axis.uncovered()
    return ProvenBounds(0.0, factor, point, worst.frequency, None, "out_of_time", left)


def modal_form(A: FloatArray, least: float = BOUNDS.basis) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles of A, its eigenvectors as columns and their inverse, as far as they are separate.

    Raises
    ------
    ValueError
        A has no basis of eigenvectors: with columns of norm 1, its smallest singular value is `least` or below.
    """
    if not len(A):
        return np.zeros(0, complex), np.zeros((0, 0), complex), np.zeros((0, 0), complex)
    balanced, scale = in_balanced_units(A)
    poles, T = linalg.eig(balanced)
    factors, pivots, _ = linalg.lapack.zgetrf(np.asarray(T, complex))
    inverse, singular = linalg.lapack.zgetri(factors, pivots)
    if singular or not 1.0 / linalg.norm(inverse, 2) > least:
        raise InputError(SEPARATE)
    return np.asarray(poles, complex), np.asarray(scale[:, None] * T, complex), np.asarray(inverse / scale, complex)


def _together(pieces: Sequence[Piece]) -> list[Piece]:
    """Pieces that contain those given, one for all whose bands overlap: what a raised level needs is less bisected."""
    joined: list[Piece] = []
    for beyond, box, (low, high) in sorted(pieces, key=lambda piece: (piece[0], piece[2])):
        if joined and joined[-1][0] == beyond and low < joined[-1][2][1]:
            _, before, (first, last) = joined[-1]
            hull = tuple((min(a, c), max(b, d)) for (a, b), (c, d) in zip(before, box))
            joined[-1] = beyond, hull, (first, max(last, high))
        else:
            joined.append((beyond, box, (low, high)))
    return joined
