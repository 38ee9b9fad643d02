"""Proof of the noise of a stage: root mean square of the line of sight over the whole box of parameters.

One proof bounds the absolute and the relative error, whose weight grows with frequency
(:mod:`lftkit.proofs.trusted.noise`), both of all axes together and along any axis. Parts of the band are narrow
where the response of the nominal member changes much in them (:data:`EXCESS`). The level of each part is as far above
what members have as :data:`ABOVE` says; where that can't be proven it is raised. Parts are kept as those of figures
are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop import LoopModel
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.sampled_loop.files import write_loop_proof
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof, noise_bound, power_area
from lftkit.proofs.trusted.proof import Interval, ProofError
from lftkit.support.atomic_output import atomic_file
from los_design.verification.certify import (
    FigureBounds,
    PartResult,
    ProofPart,
    Prover,
    model_digest,
    nominal_stable,
    stable_above,
)
from los_design.verification.loop_models import NYQUIST, Box, box_of, noise_model
from los_loop.figures_of_merit import figure
from los_loop.implemented_loop import ImplementedLoop
from los_loop.noise import noise_covariances, noise_rms
from titop_plant.interface import DT, MIRROR_STAGES

NOISE = "noise"
"""Name of the figure."""
ABOVE, RAISED, ROUNDS = 1.003, 0.006, 10
"""Level of a part over the largest gain seen, first raise where that was not proven (each further one is twice the
one before), and most times."""
LEAST = 0.05
"""Least level of a part, over that of white noise with the same mean square, of the absolute and of the relative error:
lower ones would add less than 0.2 %."""
EXCESS, MOST_PARTS = 0.011, 700
"""What the largest gains of parts add to the mean squares, at the nominal member, and most parts. That of the relative
error counts by the square of the finest limit over that of the stage."""
PLAIN = 0.4
"""How much of that counts for the absolute error, which is far from its limit."""
WHOLE = 0
"""Bisections of the box: noise hardly depends on the parameters, and a level that is raised is found sooner."""
USEFUL = 0.004
"""What the mean squares may gain by parts whose single rows have no bounds of their own beside that of all rows."""
WIDEST, GRID = 0.16, 0.01
"""Widths of the widest parts and of the steps in which they are cut, of log frequency."""
MEMBERS, FREQUENCIES, LOWEST = 12, 3, 1e-4
"""Members and frequencies at which the gain is looked at in each part; the least one [rad/s]."""

Rows = tuple[int, ...]


def certify_noise(
    loop: ImplementedLoop, folder: Path, prove: Prover, until: float, report: Callable[[int, int], None]
) -> FigureBounds:
    """Bound of the noise of a stage; its proof goes to ``STAGE-noise.npz`` in the folder.

    Parameters
    ----------
    loop : ImplementedLoop
    folder : Path
    prove : callable
        What proves the parts, a :data:`los_design.verification.certify.Prover`.
    until : float
        ``time.monotonic()`` after which it stops.
    report : callable
        Told how many parts are done, and of how many.

    Returns
    -------
    FigureBounds
        Values are root mean squares over the limit of the absolute error; the lower one is that of the nominal member.
    """
    model, box, limit = noise_model(loop), box_of(loop), loop.telescope.weights.ape_limit
    values = {p.name: p.nominal for p in loop.system.parameters}
    lower = noise_rms(noise_covariances(loop.system.at({}), *loop.pair, loop.telescope, loop=loop.stage))[0] / limit
    whole = (0.0, NYQUIST)
    if not nominal_stable(loop):
        return FigureBounds(loop.stage, NOISE, lower, math.inf, values, 0.0, "unstable", [whole])
    kept = folder / "parts" / f"{loop.stage}-{NOISE}-{model_digest(model, box)}"
    kept.mkdir(parents=True, exist_ok=True)
    window = loop.telescope.weights.rpe_window
    limits = [figure("RPE").limit(loop.telescope, stage) for stage in MIRROR_STAGES]
    relative = (min(limits) / figure("RPE").limit(loop.telescope, loop.stage)) ** 2
    levels = _first_levels(model, box, noise_parts(model, window, relative), window)
    done: dict[tuple[Rows, Interval], PartResult] = {}
    for turn in range(ROUNDS):
        open_parts = [key for key in levels if key not in done or done[key].uncovered]
        parts = [_part(model, box, key, levels[key], until, kept) for key in open_parts]
        for key, result in zip(open_parts, prove(parts)):
            done[key] = result
            if result.uncovered:
                levels[key] = max((1.0 + RAISED * 2.0**turn) * levels[key], ABOVE * result.lower)
            report(sum(not one.uncovered for one in done.values()), len(levels))
        if not any(one.uncovered for one in done.values()) or not all(r.finished for r in done.values()):
            break
    return _bounds(
        loop, model, levels, done, FigureBounds(loop.stage, NOISE, lower, math.inf, values, 0.0, "", []), folder
    )


def _bounds(
    loop: ImplementedLoop,
    model: LoopModel,
    levels: dict[tuple[Rows, Interval], float],
    done: dict[tuple[Rows, Interval], PartResult],
    bounds: FigureBounds,
    folder: Path,
) -> FigureBounds:
    """What was found, and the file of the proof where all parts are proven."""
    uncovered = sorted({(float(a), float(b)) for result in done.values() for a, b in result.uncovered})
    bounds = replace(
        bounds,
        status="open" if uncovered else "proven",
        uncovered=uncovered,
        strips=sum(len(result.strips) for result in done.values()),
        windows=sum(result.windows for result in done.values()),
        seconds=sum(result.seconds for result in done.values()),
    )
    if uncovered:
        return bounds
    parts = tuple(NoisePart(rows, band, levels[rows, band], done[rows, band].strips) for rows, band in levels)
    names = tuple(p.name for p in loop.system.parameters)
    proof = NoiseProof(model, names, box_of(loop), parts, {"stage": loop.stage, "figure": NOISE})
    file = f"{loop.stage}-{NOISE}.npz"
    with atomic_file(folder / file) as temporary:
        write_loop_proof(proof, temporary)
    upper = noise_bound(replace(model, scale=1.0), parts, 0.0).rms
    return replace(bounds, upper=upper, proof=file, stable=stable_above(loop))


def noise_of_loop(proof: NoiseProof, loop: ImplementedLoop) -> NoiseProof:
    """The proof of a file as one of a loop: its model is made anew.

    Raises
    ------
    ProofError
        The file has other parameters, or claims less than the whole box.
    """
    if proof.names != tuple(p.name for p in loop.system.parameters):
        raise ProofError(f"{loop.stage}, {NOISE}: the proof must be of the telescope's parameters, got others")
    for (low, high), (least, largest) in zip(proof.box, box_of(loop)):
        if low > least or high < largest:
            raise ProofError(f"{loop.stage}, {NOISE}: the proof must be of the whole box, got another")
    return replace(proof, model=noise_model(loop), about={"stage": loop.stage, "figure": NOISE})


def seen_gain(model: LoopModel, box: Box, band: Interval) -> float:
    """Largest gain at some members and frequencies of a band."""
    rng = np.random.default_rng(0)
    ends = np.array(box)
    points = rng.uniform(size=(MEMBERS, len(box)))
    points[::2] = np.round(points[::2])
    members: FloatArray = np.vstack([np.zeros(len(box)), ends[:, 0] + points * np.ptp(ends, axis=1)])
    omega = np.linspace(max(band[0], LOWEST), band[1], FREQUENCIES)
    return max(float(member_gains(model, float(w), members).max()) for w in omega)


def noise_parts(model: LoopModel, window: float, relative: float = 1.0) -> list[Interval]:
    """Parts of the band in which the largest gains of the nominal member add little to its mean squares.

    Parameters
    ----------
    model : LoopModel
    window : float
        Of the relative error [s].
    relative : float
        How much of what is added counts for the relative error.
    """
    first = LOWEST * 100.0
    steps = math.ceil(math.log(NYQUIST / first) / GRID)
    grid = np.concatenate([np.linspace(LOWEST, first, 9)[:-1], np.geomspace(first, NYQUIST, steps + 1)])
    squares = np.array([_nominal_squares(model, float(w)) for w in grid])
    width = np.array([[b - a, power_area(float(a), float(b), window)] for a, b in itertools.pairwise(grid)])
    pieces = 0.5 * (squares[1:] + squares[:-1])[:, :, None] * width[:, None, :]
    total = pieces.sum(axis=0)

    def excess(low: int, high: int) -> float:
        largest = squares[low : high + 1].max(axis=0)[:, None] * width[low:high].sum(axis=0)
        return float(((largest - pieces[low:high].sum(axis=0)) / total * [PLAIN, relative]).max())

    cuts = [0, 8, *range(8 + round(WIDEST / GRID), len(grid) - 1, round(WIDEST / GRID)), len(grid) - 1]
    parts = {ends: excess(*ends) for ends in itertools.pairwise(cuts)}
    while sum(parts.values()) > EXCESS and len(parts) < MOST_PARTS:
        low, high = max(parts, key=lambda ends: parts[ends] if ends[1] - ends[0] > 1 else 0.0)
        if high - low < 2:
            break
        del parts[low, high]
        middle = (low + high) // 2
        parts |= {(low, middle): excess(low, middle), (middle, high): excess(middle, high)}
    intervals = [(float(grid[low]), float(grid[high])) for low, high in sorted(parts)]
    return [(0.0, intervals[0][1]), *intervals[1:-1], (intervals[-1][0], NYQUIST)]


def _nominal_squares(model: LoopModel, omega: float) -> FloatArray:
    """Squared gains of the nominal member at a frequency, of each row and of all rows together."""
    e = model.at(omega)[1][:, model.sizes[0] :]
    weight, amplitude = model.amplitudes(omega)
    rows = np.abs(weight * e * amplitude) ** 2
    largest = float(linalg.svdvals(weight * e * amplitude)[0]) ** 2
    return np.array([*rows.sum(axis=1), largest])


def _first_levels(
    model: LoopModel, box: Box, bands: Sequence[Interval], window: float
) -> dict[tuple[Rows, Interval], float]:
    """Levels of the parts of all rows, and of single rows where they help: a little above what is seen, or little."""
    sets: list[Rows] = [*((row,) for row in model.rows), model.rows]
    seen = {(rows, band): seen_gain(replace(model, rows=rows), box, band) for rows in sets for band in bands}
    widths = {band: np.array([band[1] - band[0], power_area(*band, window)]) for band in bands}
    levels = {}
    for rows in sets:
        mean = DT / math.pi * np.sum([seen[rows, band] ** 2 * widths[band] for band in bands], axis=0)
        for band in bands:
            power = np.maximum(widths[band] / (band[1] - band[0]), 1e-12)
            levels[rows, band] = max(ABOVE * seen[rows, band], LEAST * float(np.sqrt(mean / power).min()))
    singles: list[Rows] = [(row,) for row in model.rows] if len(model.rows) > 1 else []
    total = np.sum([levels[rows, band] ** 2 * widths[band] for rows in singles for band in bands], axis=0)
    saved = {}
    for band in bands if singles else ():
        less = len(singles) * levels[model.rows, band] ** 2 - sum(levels[rows, band] ** 2 for rows in singles)
        saved[band] = float((less * widths[band] / total * [PLAIN, 1.0]).max())
    ordered = sorted(saved, key=lambda band: saved[band])
    for band, lost in zip(ordered, itertools.accumulate(max(saved[band], 0.0) for band in ordered)):
        for rows in singles if lost < USEFUL else ():
            del levels[rows, band]
    return levels


def _part(
    model: LoopModel, box: Box, key: tuple[Rows, Interval], level: float, until: float, folder: Path
) -> ProofPart:
    rows, band = key
    file = folder / f"{'-'.join(map(str, rows))}-{band[0]:.9g}-{band[1]:.9g}-{level!r}.npz"
    return ProofPart(replace(model, rows=rows), box, band, level, until, file, deepest=WHOLE)
