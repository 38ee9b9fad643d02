"""Guaranteed bounds of the figures of a pair of controllers, over the whole box of the telescope's parameters.

The loop that is proven is that of :mod:`los_loop.implemented_loop`: commands held for a tick, one tick of delay,
images of held commands through the nominal telescope, the camera's hold by its fundamental. The band of a figure is cut
into parts; each is proven by itself and kept in a file, so that an interrupted proof goes on.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.proofs.proof_files import arrays_of, packed, unpacked, write_content
from lftkit.proofs.sampled_loop import LoopModel, LoopProof, prove_level
from lftkit.proofs.sampled_loop.bounds import BisectionOptions
from lftkit.proofs.sampled_loop.files import write_loop_proof
from lftkit.proofs.trusted.entries import FORMAT, Form, each, file_content, header_of, index, number, pair, text, truth
from lftkit.proofs.trusted.proof import Interval, ProofError, Strip, require_cover
from lftkit.proofs.trusted.stability import nominal_windows, whole_axis, windows_above
from lftkit.proofs.trusted.strips import check_strip, require_strip, windows_of
from lftkit.support.atomic_output import atomic_file
from lftkit.support.job import Job
from los_design.search.worst_points import WorstPoint
from los_design.verification.loop_models import Box, box_of, figures_of, provable, telescope_model
from los_loop.implemented_loop import ImplementedLoop, LoopMetric
from titop_plant.interface import DT
from titop_plant.physical_settings import ANGLE

LOWEST = 1e-2
"""Frequency [rad/s] from which on the worst cases are searched; the proofs begin at zero."""
PART = 0.04
"""Length of a part of a band, of log frequency."""
SLOWEST_PARTS = (0.01, 0.3)
"""Upper ends of the first parts of a band that begins at zero [rad/s]."""


PART_KIND = "part of a proof"
PART_ENTRIES: dict[str, Form] = {
    "names": each(text),
    "uncovered": each(pair),
    "point": each(number),
    "windows": index,
    "finished": truth,
    **dict.fromkeys(("lower", "omega", "seconds"), number),
}
PROBES, MOST_OTHERS = 6, 3
"""Windows of another proof that are tried, and most other proofs."""


@dataclass(frozen=True)
class FigureBounds:
    """Bounds of one figure, over its limit.

    Parameters
    ----------
    stage, figure : str
    lower : float
        Largest value found.
    upper : float
        Proven; infinite where parts are not covered.
    point : mapping of str to float
        Parameters of the largest value.
    frequency : float
        Its frequency [rad/s].
    status : str
        ``proven``, ``violated`` (a member is above the limit, or above a level beyond it that was asked for), ``open``
        (parts are not covered), ``unstable`` (the nominal loop was not proven stable; nothing else was tried).
    uncovered : list of (low, high)
        Frequencies [rad/s] of the parts that are not covered.
    stable : bool
        Whether every member was proven stable, its poles above half of the sampling rate included; the band of the
        proof must be the whole one. As a loop without sidebands: docs/certificates.md.
    proof : str or None
        Name of its file.
    strips, windows : int
    seconds : float
        Processor time of the proof.
    """

    stage: str
    figure: str
    lower: float
    upper: float
    point: dict[str, float]
    frequency: float
    status: str
    uncovered: list[Interval]
    stable: bool = False
    proof: str | None = None
    strips: int = 0
    windows: int = 0
    seconds: float = 0.0

    def to_mapping(self) -> dict[str, Any]:
        """For JSON; an infinite upper bound is null."""
        return {**vars(self), "upper": self.upper if math.isfinite(self.upper) else None}


@dataclass(frozen=True)
class ProofLevel:
    """Level below which a figure is to be proven.

    Parameters
    ----------
    limit_fraction : float
        Level over the limit of the figure. Where a larger value is known, the level is above it by `raised`, up to
        the limit.
    gap : float, optional
        The level is above the largest value known by at most this fraction instead.
    raised : float
    """

    limit_fraction: float = 1.0
    gap: float | None = None
    raised: float = 0.01

    def above(self, known: float) -> float:
        """Level over the limit for the largest value known over the limit."""
        if self.gap is not None:
            return (1.0 + 0.95 * self.gap) * known
        return self.limit_fraction if known < self.limit_fraction else min((1.0 + self.raised) * known, 1.0)


def parts_of(band: Interval) -> list[Interval]:
    """A band cut into parts."""
    low, high = band
    first = min(max(low, SLOWEST_PARTS[-1]), high)
    count = math.ceil(math.log(high / first) / PART)
    cuts = {low, first, high, *(first * (high / first) ** (k / count) for k in range(1, count))}
    cuts |= {at for at in SLOWEST_PARTS if low < at < high}
    return list(itertools.pairwise(sorted(cuts)))


@dataclass(frozen=True)
class ProofPart:
    """A part of a band to be proven."""

    model: LoopModel
    box: Box
    band: Interval
    level: float
    until: float
    file: Path
    others: tuple[Path, ...] = ()
    """The same part for other levels and figures, the best one first: what holds of it need not be found again."""
    deepest: int = BisectionOptions.deepest
    """Most bisections of the box."""


@dataclass(frozen=True)
class PartResult:
    """Outcome of a part; `finished` is false where time was up."""

    strips: tuple[Strip, ...]
    uncovered: list[Interval]
    lower: float
    point: list[float]
    omega: float
    windows: int
    seconds: float
    finished: bool


@dataclass(frozen=True)
class PartTask:
    """A part without files, for a process on any machine.

    Parameters
    ----------
    model, box, band, level
        As of :class:`ProofPart`.
    seconds : float
        After which it stops.
    others : tuple of tuple of Strip
        The same part of other proofs, the best one first.
    deepest : int
        Most bisections of the box.
    """

    model: LoopModel
    box: Box
    band: Interval
    level: float
    seconds: float
    others: tuple[tuple[Strip, ...], ...] = ()
    deepest: int = BisectionOptions.deepest


Prover = Callable[[Sequence[ProofPart]], Iterable[PartResult]]
"""Proves parts and keeps them, in their order; ``functools.partial(workers.each, prove_part)`` on this machine."""


def prove_part(part: ProofPart) -> PartResult:
    """Prove a part, or read what was proven before."""
    kept = kept_part(part)
    if kept is not None:
        return kept
    result = prove_task(task_of(part))
    keep_part(part, result)
    return result


def kept_part(part: ProofPart) -> PartResult | None:
    """What was proven before, or that there is no time; None where the part is to be proven.

    What a file says is checked again. One that cannot be read, as one whose end is missing after a loss of power, or
    that does not pass is proven again; one line says so.
    """
    if part.file.exists():
        try:
            result = _read_part(part.file)
            # Refuse strips that do not prove a part; what a part leaves open needs no proof
            if not result.uncovered:
                require_cover(result.strips, part.box, part.band, "rad/s")
            for place, strip in enumerate(result.strips):
                require_strip(place, strip, part.model)
                outcome = check_strip((part.model, strip, part.level))
                if isinstance(outcome, str):
                    raise ProofError(f"strip {place}: {outcome}")
            return result
        except ProofError as error:
            words = f"is damaged ({error}) and is proven again"
            sys.stderr.write(f"part {part.file.parent.name}/{part.file.name} {words}\n")
    if time.monotonic() > part.until:
        return PartResult((), [part.band], 0.0, [], 0.0, 0, 0.0, False)
    return None


def task_of(part: ProofPart) -> PartTask:
    """What has to be known to prove a part now."""
    others = tuple(map(_strips, part.others))
    return PartTask(part.model, part.box, part.band, part.level, part.until - time.monotonic(), others, part.deepest)


def prove_task(task: PartTask) -> PartResult:
    """Prove a part; no file is read or written."""
    until = time.monotonic() + task.seconds
    known = next((strips for strips in task.others if _useful(task, strips)), ())
    claim = task.model, task.box, task.band, task.level
    level = prove_level(*claim, until=until, known=known, options=BisectionOptions(deepest=task.deepest))
    return PartResult(
        tuple(level.strips),
        sorted({band for _, band in level.uncovered}),
        level.lower,
        [] if level.point is None else level.point.tolist(),
        level.omega,
        level.windows,
        level.seconds,
        time.monotonic() <= until,
    )


def keep_part(part: ProofPart, result: PartResult) -> None:
    """Write a part that is finished to its file."""
    if result.finished:
        summary = {name: value for name, value in vars(result).items() if name != "strips"}
        header = {"format": FORMAT, "kind": PART_KIND, "names": [""] * len(part.box), **summary}
        with atomic_file(part.file, durable=True) as temporary:
            write_content(temporary, (header, packed(result.strips, len(part.box))))


def _strips(file: Path) -> tuple[Strip, ...]:
    """Strips of a part that was proven, none if it was not covered or cannot be read."""
    try:
        result = _read_part(file)
    except ProofError:  # these strips are a help only
        return ()
    return () if result.uncovered else result.strips


def _read_part(file: Path) -> PartResult:
    """What the file of a part says; a ProofError where it cannot be read."""
    content, arrays = file_content(file)
    header = header_of(content, PART_KIND, PART_ENTRIES)
    strips = unpacked(arrays_of(arrays, {}, len(header["names"])), len(header["names"]))
    uncovered = list(header["uncovered"])
    rest = {name: header[name] for name in ("lower", "omega", "windows", "seconds", "finished")}
    return PartResult(strips, uncovered, point=list(header["point"]), **rest)


def _useful(part: PartTask, strips: tuple[Strip, ...]) -> bool:
    """Whether strips of another proof cover a part, and most of some windows hold for it."""
    try:
        require_cover(strips, part.box, part.band, "rad/s")
    except ProofError:
        return False
    tried = [(strip, number) for strip in strips for number in range(len(strip.nodes) - 1)]
    tried = tried[:: math.ceil(len(tried) / PROBES)]
    held = sum(windows_of(part.model, strip, number, part.level, 2) > 0 for strip, number in tried)
    return held >= 0.6 * len(tried)


def certify_figure(
    loop: ImplementedLoop,
    name: str,
    level: ProofLevel,
    known: Sequence[WorstPoint],
    folder: Path,
    prove: Prover,
    until: float,
    report: Callable[[int, int], None],
) -> FigureBounds:
    """Bounds of one figure; its proof goes to ``STAGE-FIGURE.npz`` in the folder.

    Parameters
    ----------
    loop : ImplementedLoop
    name : str
    level : ProofLevel
    known : sequence of WorstPoint
        Of a search; the lower bound.
    folder : Path
    prove : callable
        What proves the parts, a :data:`Prover`.
    until : float
        ``time.monotonic()`` after which it stops.
    report : callable
        Told how many parts are done, and of how many.
    """
    metric = provable(loop.telescope, loop.stage, loop.ports)[name]
    model, box = telescope_model(loop, metric), box_of(loop)
    lower, omega, values = 0.0, 0.0, {p.name: p.nominal for p in loop.system.parameters}
    for point in known:
        if point.requirement == name and point.stage == loop.stage:
            gain = float(loop.gain(point.omega, metric, loop.point(dict(point.parameters)))[0])
            if gain > lower:
                lower, omega, values = gain, point.omega, dict(point.parameters)
    if not level.above(lower) > 0.0:
        raise InputError(f"a level, or a worst point of {name}, must be given")

    def bounds(status: str, uncovered: list[Interval], results: Sequence[PartResult] = ()) -> FigureBounds:
        strips, windows = sum(len(r.strips) for r in results), sum(r.windows for r in results)
        seconds = sum(r.seconds for r in results)
        whole = loop.stage, name, lower, math.inf, values, omega, status, uncovered
        return FigureBounds(*whole, strips=strips, windows=windows, seconds=seconds)

    if level.above(lower) > lower and time.monotonic() > until:
        return bounds("open", [metric.band])
    if not nominal_stable(loop):
        return bounds("unstable", [metric.band])
    results: list[PartResult] = []
    # A member that the proof finds above the level raises it; parts that hold below the new one are not sought again.
    while (target := level.above(lower)) > lower:
        parts, results = _parts(model, box, target, until, folder / "parts", loop.stage, metric), []
        for result in prove(parts):
            results.append(result)
            report(len(results), len(parts))
            if result.lower > lower:
                lower, omega, values = result.lower, result.omega, _values(loop, result.point)
        if lower < target:
            break
    else:
        return bounds("violated", [metric.band], results)
    uncovered = [(float(low), float(high)) for result in results for low, high in result.uncovered]
    if uncovered:
        return bounds("open", uncovered, results)
    strips = tuple(strip for result in results for strip in result.strips)
    about = {"stage": loop.stage, "figure": name, "limit": metric.limit}
    names = tuple(p.name for p in loop.system.parameters)
    proof = LoopProof(model, names, box, metric.band, target, strips, about)
    file = f"{loop.stage}-{name}.npz"
    with atomic_file(folder / file) as temporary:
        write_loop_proof(proof, temporary)
    stable = whole_axis(metric.band, DT) and stable_above(loop)
    return replace(bounds("proven", [], results), upper=target, proof=file, stable=stable)


def _parts(
    model: LoopModel, box: Box, level: float, until: float, folder: Path, stage: str, metric: LoopMetric
) -> list[ProofPart]:
    """Parts of a band; their files are in a folder ``STAGE-FIGURE-DIGEST-LEVEL``."""
    start = f"{stage}-{metric.name}-{model_digest(model, box)}-"
    kept = folder / f"{start}{level!r}"
    kept.mkdir(parents=True, exist_ok=True)
    others: list[tuple[bool, float, Path]] = []
    for other in sorted(folder.glob(f"{stage}-*-*-*")):
        with suppress(ValueError):
            distance = abs(math.log(float(other.name.rsplit("-", 1)[1]) / level))
            others.append((not other.name.startswith(start), distance, other))
    parts = []
    for band in parts_of(metric.band):
        file = f"{band[0]:.9g}-{band[1]:.9g}.npz"
        same = tuple(other / file for *_, other in sorted(others) if other != kept and (other / file).exists())
        parts.append(ProofPart(model, box, band, level, until, kept / file, same[:MOST_OTHERS]))
    return parts


@lru_cache(maxsize=4)
def nominal_stable(loop: ImplementedLoop) -> bool:
    """Whether the nominal loop was proven stable."""
    metric = next(iter(figures_of(loop.telescope, loop.stage, loop.ports).values()))
    return nominal_windows(telescope_model(loop, metric)) > 0


@lru_cache(maxsize=4)
def stable_above(loop: ImplementedLoop) -> bool:
    """Whether it was proven that no pole of a member crosses the axis above half of the sampling rate."""
    metric = next(iter(figures_of(loop.telescope, loop.stage, loop.ports).values()))
    return windows_above(telescope_model(loop, metric), box_of(loop)) > 0


def model_digest(model: LoopModel, box: Box) -> str:
    """SHA-256 of all that a proof is about but its band and level: the box and every field of the model."""
    values = {field.name: getattr(model, field.name) for field in fields(model)}
    return Job("proof", {"box": box, **values}).digest


def _values(loop: ImplementedLoop, point: Sequence[float]) -> dict[str, float]:
    """Parameter values of deviations from the nominal ones."""
    return {
        p.name: math.tan(0.25 * value) if p.name == ANGLE else p.nominal + value
        for p, value in zip(loop.system.parameters, point)
    }
