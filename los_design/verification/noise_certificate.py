"""Proof of the noise of a stage: root mean square of the line of sight over the whole box of parameters.

One proof bounds the absolute and the relative error, whose weight grows with frequency
(:mod:`lftkit.proofs.sampled_loop.noise`). The level of each part of the band is as far above what members have as
:data:`ABOVE` says; where that can't be proven it is raised. Parts are kept as those of figures are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop import LoopModel
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.sampled_loop.noise import NoisePart, NoiseProof, mean_square
from lftkit.proofs.strips import Interval
from lftkit.proofs.verdict import ProofError
from los_design.verification.certify import (
    FigureBounds,
    PartResult,
    ProofPart,
    Prover,
    model_digest,
    nominal_stable,
    parts_of,
    stable_above,
)
from los_design.verification.loop_models import NYQUIST, Box, box_of, noise_model
from los_loop.implemented_loop import ImplementedLoop
from los_loop.sampled_loop_norms import noise_covariances, noise_rms
from pointing_analysis.files.atomic_output import atomic_file
from titop_plant.interface import DT

NOISE = "noise"
"""Name of the figure."""
ABOVE, RAISED, ROUNDS = 1.05, 1.3, 12
"""Level of a part over the largest gain seen, factor where that was not proven, and most times."""
LEAST = 0.1
"""Least level of a part, over that of white noise with the same mean square: lower ones would add less than 1 %."""
MEMBERS, FREQUENCIES, LOWEST = 12, 5, 1e-4
"""Members and frequencies at which the gain is looked at in each part; the least one [rad/s]."""


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
    model, box, limit = noise_model(loop), box_of(loop), float(loop.parameters["weights"]["ape_limit"])
    values = {p.name: p.nominal for p in loop.system.parameters}
    lower = noise_rms(noise_covariances(loop.system.at({}), *loop.pair, loop.parameters, loop=loop.stage))[0] / limit
    whole = (0.0, NYQUIST)
    if not nominal_stable(loop):
        return FigureBounds(loop.stage, NOISE, lower, math.inf, values, 0.0, "unstable", [whole])
    kept = folder / "parts" / f"{loop.stage}-{NOISE}-{model_digest(model, box)}"
    kept.mkdir(parents=True, exist_ok=True)
    seen = {(row, band): seen_gain(replace(model, rows=(row,)), box, band) for row, band in _rows_and_parts(model)}
    least = LEAST * math.sqrt(_mean(seen))
    levels = {key: max(ABOVE * gain, least) for key, gain in seen.items()}
    done: dict[tuple[int, Interval], PartResult] = {}
    for _ in range(ROUNDS):
        open_parts = [key for key in levels if key not in done or done[key].uncovered]
        parts = [_part(model, box, key, levels[key], until, kept) for key in open_parts]
        for key, result in zip(open_parts, prove(parts)):
            done[key] = result
            if result.uncovered:
                levels[key] = max(RAISED * levels[key], ABOVE * result.lower)
            report(sum(not found.uncovered for found in done.values()), len(levels))
        if not any(found.uncovered for found in done.values()) or not all(r.finished for r in done.values()):
            break
    return _bounds(
        loop, model, levels, done, FigureBounds(loop.stage, NOISE, lower, math.inf, values, 0.0, "", []), folder
    )


def _bounds(
    loop: ImplementedLoop,
    model: LoopModel,
    levels: dict[tuple[int, Interval], float],
    done: dict[tuple[int, Interval], PartResult],
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
    parts = tuple(NoisePart(row, band, levels[row, band], done[row, band].strips) for row, band in levels)
    names = tuple(p.name for p in loop.system.parameters)
    proof = NoiseProof(model, names, box_of(loop), parts, {"stage": loop.stage, "figure": NOISE})
    file = f"{loop.stage}-{NOISE}.npz"
    with atomic_file(folder / file) as temporary:
        proof.to_file(temporary)
    upper = math.sqrt(mean_square(replace(model, scale=1.0), parts, 0.0))
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
        slack = 1e-12 * max(abs(least), abs(largest))
        if low > least + slack or high < largest - slack:
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


def _rows_and_parts(model: LoopModel) -> Sequence[tuple[int, Interval]]:
    return [(row, band) for row in model.rows for band in parts_of((0.0, NYQUIST))]


def _mean(seen: dict[tuple[int, Interval], float]) -> float:
    """Mean square of both rows over the limit, by the gains that were seen."""
    return DT / math.pi * sum(gain**2 * (band[1] - band[0]) for (_, band), gain in seen.items())


def _part(model: LoopModel, box: Box, key: tuple[int, Interval], level: float, until: float, folder: Path) -> ProofPart:
    row, band = key
    file = folder / f"{row}-{band[0]:.9g}-{band[1]:.9g}-{level!r}.npz"
    return ProofPart(replace(model, rows=(row,)), box, band, level, until, file)
