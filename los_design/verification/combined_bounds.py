"""What proven bounds of tones and of noise make together, in the form of the budgets.

A tone of amplitude a along one axis and noise of r rms keep
:func:`titop_plant.telescope.error_budget.combined_level` in the part of windows or instants that the requirement behind
the stage's limit asks for; it grows with both, so that bounds of them give a bound. The part of the noise that can be
on the axis of the tone is proven with the noise. A fast tone counts with the least angle that it turns in a window:
that of the lower end of the part of the band that its bound is of.

Two things hold only for a required part of :data:`LEAST_PART` or more: a tone along one axis is worse than one whose
line of sight goes round an ellipse, and more noise is worse than less. For a smaller part the level that this part
keeps is the bound.

Slow and fast tones at once, with norm s and f, ``s^2 + f^2 = 1``, have amplitudes below ``s a_slow`` and ``f a_fast``,
and random phases (:func:`titop_plant.telescope.error_budget.two_tone_level`). The largest level over the shares is the
sum.

Each of the 22 channels of the reference at its own weight has norm sqrt(22) in all, and bounds grow by that factor at
most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy import optimize

from lftkit.proofs.trusted.noise import NoiseBound
from los_design.verification.error_sum import FAST, WITH_NOISE, ErrorSum, parts_of_band, required_probabilities
from los_loop.figures_of_merit import figure
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.telescope.error_budget import combined_level, two_tone_level
from titop_plant.telescope.telescope import Telescope

LEAST_PART = 0.9
"""Of the instants or windows: the least one for which sums are computed."""
SHARES = 17
"""Shares of slow and fast tones between which the largest sum is searched."""


def error_sums(
    telescope: Telescope, stage: str, tones: Mapping[str, float], noise: tuple[NoiseBound, NoiseBound] | None
) -> tuple[ErrorSum, ...]:
    """Sums of a stage; those of which a contribution is missing are left out.

    Parameters
    ----------
    telescope : Telescope
        Of the telescope.
    stage : str
    tones : mapping of str to float
        Bounds of the figures APE, slow and fast [rad], and of parts of the fast tones' band
        (:func:`los_design.verification.error_sum.parts_of_band`).
    noise : (NoiseBound, NoiseBound) or None
        Of the absolute and the relative error [rad].
    """
    ape, rpe = (figure(name).limit(telescope, stage) for name in ("APE", "RPE"))
    arcsec, mas = ape / RAD_PER_ARCSEC, rpe / RAD_PER_MAS
    slow = tones.get("slow", math.nan) / RAD_PER_MAS
    absolute = tones.get("APE", math.nan) / RAD_PER_ARCSEC
    fast = fast_pieces(telescope, {name: bound / RAD_PER_MAS for name, bound in tones.items()})
    found: list[tuple[str, float, float, str, float]] = []
    if noise is not None:
        instants, windows = required_probabilities(telescope, stage)
        wide, fine = _scaled(noise[0], RAD_PER_ARCSEC), _scaled(noise[1], RAD_PER_MAS)
        alone = max((_level(bound, fine, windows, turn) for turn, bound in fast), default=math.nan)
        both = max((_both(slow, bound, fine, windows, turn) for turn, bound in fast), default=math.nan)
        values = (_level(absolute, wide, instants), _level(slow, fine, windows), alone, both)
        limits = ((arcsec, "arcsec", instants), *((mas, "mas", windows),) * 3)
        found = [(name, value, *limit) for name, value, limit in zip(WITH_NOISE, values, limits)]
    sums = [ErrorSum(*row) for row in found if not math.isnan(row[1])]
    inputs = telescope.channels
    norm = math.sqrt(inputs)
    together = f"each of {inputs} channels at its own weight, norm {norm:.2f}"
    largest = tones.get(FAST, math.nan) / RAD_PER_MAS
    rows = (("APE", absolute, arcsec, "arcsec"), ("slow", slow, mas, "mas"), (FAST, largest, mas, "mas"))
    for name, tone, limit, unit in rows:
        if not math.isnan(tone):
            sums.append(ErrorSum(f"{name}, {together}, without noise", norm * tone, limit, unit))
    return tuple(sums)


def fast_pieces(telescope: Telescope, tones: Mapping[str, float]) -> list[tuple[float, float]]:
    """Least turn in a window [rad] and bound of each part of the fast tones' band; empty without a bound of all.

    Parts without a gap from the edge of the band on have bounds of their own where they are proven; above them the
    bound of the whole band counts.
    """
    if FAST not in tones:
        return []
    window, pieces, end = telescope.weights.rpe_window, [], telescope.weights.band_edge
    for name, (low, high) in parts_of_band(telescope).items():
        if name not in tones:
            break
        pieces.append((low * window, min(tones[name], tones[FAST])))
        end = high
    return [*pieces, (end * window, tones[FAST])]


def _scaled(bound: NoiseBound, unit: float) -> NoiseBound:
    """In another unit; along each of both axes the power is at most that along any."""
    return NoiseBound(min(bound.rms, math.sqrt(2.0) * bound.along) / unit, bound.along / unit)


def _level(tone: float, noise: NoiseBound, part: float, turn: float = 0.0) -> float:
    if math.isnan(tone + part):
        return math.nan
    return combined_level(tone, noise.rms, max(part, LEAST_PART), noise.on_axis, turn)


def _both(slow: float, fast: float, noise: NoiseBound, part: float, turn: float) -> float:
    """Largest level over the shares of both tones."""
    if math.isnan(slow + part):
        return math.nan
    part = max(part, LEAST_PART)

    def level(angle: float) -> float:
        return two_tone_level(math.cos(angle) * slow, math.sin(angle) * fast, noise.rms, part, noise.on_axis, turn)

    angles = np.linspace(0.0, 0.5 * math.pi, SHARES)
    values = [level(float(angle)) for angle in angles]
    k = int(np.argmax(values))
    ends = float(angles[max(k - 1, 0)]), float(angles[min(k + 1, SHARES - 1)])
    best = optimize.minimize_scalar(lambda angle: -level(float(angle)), bounds=ends, method="bounded")
    return max(values[k], -float(best.fun))
