"""What proven bounds of tones and of noise make together, in the form of the budgets.

A tone of amplitude a along one axis and noise keep :func:`titop_plant.telescope.window_noise.combined_level` in the
part of windows or instants that the requirement behind the stage's limit asks for; it grows with both, so that bounds
of them give a bound. The part of the noise that can be on the axis of the tone, and its power in each band, are proven
with the noise. A fast tone counts with the angles that it turns in a window in the part of the band that its bound is
of: the largest level at :data:`TURNS` of them. Bounds have the rational weight of the paper; the error in windows is
up to 4.5 % larger (:func:`titop_plant.telescope.weights.window_ratio`), the largest ratio from a frequency to the next.

Two things hold only for a required part of :data:`LEAST_PART` or more: a tone along one axis is worse than one whose
line of sight goes round an ellipse, and more noise is worse than less. For a smaller part the level that this part
keeps is the bound.

Slow and fast tones at once, with norm s and f, ``s^2 + f^2 = 1``, have amplitudes below ``s a_slow`` and ``f a_fast``,
and random phases. The largest level over the shares is the sum.

Each of the 22 channels of the reference at its own weight has norm sqrt(22) in all, and bounds grow by that factor at
most.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import optimize

from lftkit.proofs.trusted.noise import NoiseBound
from los_design.verification.error_sum import FAST, WITH_NOISE, ErrorSum, parts_of_band, required_probabilities
from los_loop.figures_of_merit import figure
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import DT
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import window_ratio
from titop_plant.telescope.window_noise import WindowNoise, combined_level

LEAST_PART = 0.9
"""Of the instants or windows: the least one for which sums are computed."""
SHARES = 17
"""Shares of slow and fast tones between which the largest sum is searched."""
TURNS = 5
"""Frequencies of a part of the band, its ends among them, at which the level of its tones is computed."""
BETWEEN = 100
"""Angles from one of them to the next at which the error in windows is compared with the weight."""
BANDS, LOWEST = 60, 0.1
"""Bands of the noise, in each of which it counts as of one frequency, and the edge of the lowest one [rad/s]."""


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
    table: list[tuple[str, float, float, str, float]] = []
    if noise is not None:
        instants, windows = (max(part, LEAST_PART) for part in required_probabilities(telescope, stage))
        window = telescope.weights.rpe_window
        wide, fine = window_noise(noise[0], RAD_PER_ARCSEC), window_noise(noise[1], RAD_PER_MAS, window)
        alone, both = _largest(0.0, fast, fine, windows), _largest(slow, fast, fine, windows)
        values = (_level(absolute, wide, instants), _level(slow, fine, windows), alone, both)
        asked = required_probabilities(telescope, stage)
        limits = ((arcsec, "arcsec", asked[0]), *((mas, "mas", asked[1]),) * 3)
        table = [(name, value, *limit) for name, value, limit in zip(WITH_NOISE, values, limits)]
    sums = [ErrorSum(*row) for row in table if not math.isnan(row[1])]
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
    """Angles that fast tones turn in a window [rad], and bounds of their errors there; empty without a bound of all.

    Parts without a gap from the edge of the band on have bounds of their own where they are proven; above them the
    bound of the whole band counts.
    """
    if FAST not in tones:
        return []
    bands, end = [], telescope.weights.band_edge
    for name, (low, high) in parts_of_band(telescope).items():
        if name not in tones:
            break
        bands.append((low, high, min(tones[name], tones[FAST])))
        end = high
    window = telescope.weights.rpe_window
    bands.append((end, max(math.pi / DT, end), tones[FAST]))
    pieces = []
    for low, high, bound in bands:
        turns = window * np.geomspace(low, high, TURNS)
        ratios = [float(window_ratio(np.linspace(*ends, BETWEEN)).max()) for ends in itertools.pairwise(turns)]
        largest = np.maximum([ratios[0], *ratios], [*ratios, ratios[-1]])  # on either side
        pieces += [(float(turn), bound * float(ratio)) for turn, ratio in zip(turns, largest)]
    return pieces


def window_noise(bound: NoiseBound, unit: float, window: float = 0.0) -> WindowNoise:
    """Noise of a bound in another unit, its power in bands as proven; along each of both axes at most that along any.

    Parameters
    ----------
    bound : NoiseBound
    unit : float
    window : float
        Of the relative error [s]; zero: of the absolute error, whose instants have no shape.
    """
    scaled = NoiseBound(min(bound.rms, math.sqrt(2.0) * bound.along) / unit, bound.along / unit)
    if not window or not bound.powers:
        return WindowNoise(scaled.rms, scaled.on_axis)
    low, high, power = np.array(bound.powers).T
    turns = window * np.sqrt(np.maximum(low, 0.5 * high) * high)
    return WindowNoise.of_spectrum(scaled.rms, scaled.on_axis, turns, power)


def in_few_bands(bound: NoiseBound) -> NoiseBound:
    """The same bound with at most :data:`BANDS` bands of its powers, of equal ratios."""
    rows = np.array(bound.powers)
    edges = np.geomspace(LOWEST, max(float(rows[-1, 1]), 2.0 * LOWEST), BANDS)
    band = np.searchsorted(edges, rows[:, 1], side="left")
    parts = [rows[band == k] for k in np.unique(band)]
    merged = ((float(part[0, 0]), float(part[-1, 1]), math.fsum(part[:, 2])) for part in parts)
    return replace(bound, powers=tuple(merged))


def _level(tone: float, noise: WindowNoise, part: float) -> float:
    return math.nan if math.isnan(tone + part) else combined_level(tone, noise, part)


def _largest(slow: float, fast: Sequence[tuple[float, float]], noise: WindowNoise, part: float) -> float:
    """Largest level of a fast tone, and of a slow one beside it where that is not zero, over the shares of both."""
    if not fast or math.isnan(slow + part):
        return math.nan

    def level(turn: float, bound: float, angle: float, least: float = 0.0) -> float:
        tone, beside = math.sin(angle) * bound, math.cos(angle) * slow
        return combined_level(tone, noise, part, turn, slow=beside, least=least)

    most = 0.5 * math.pi
    angles = np.linspace(0.0, most, SHARES).tolist() if slow else [most]
    largest, at = 0.0, (0.0, 0.0, 0.0)
    for turn, bound in fast:
        for angle in angles:
            if (value := level(turn, bound, angle, largest)) > largest:
                largest, at = value, (turn, bound, angle)
    if not slow:
        return largest
    turn, bound, angle = at
    ends = max(angle - most / (SHARES - 1), 0.0), min(angle + most / (SHARES - 1), most)
    best = optimize.minimize_scalar(lambda x: -level(turn, bound, float(x)), bounds=ends, method="bounded")
    return max(largest, -float(best.fun))
