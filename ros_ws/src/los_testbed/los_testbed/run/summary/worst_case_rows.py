"""The scenario worst_case of the stage comparison: each stage at its own worst parameters, tone by tone.

For each index the run with the disturbance alone gives the measured amplitude of the tone, and the model gives gamma
times the limit. What a limit is compared with is the level that the required part of the instants, or windows, stays
below with this tone and the loop's sensor noise, over all draws of the noise
(:func:`titop_plant.telescope.window_noise.combined_level`): the quantile of a record of seconds is one draw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import linalg

from los_loop.noise import loop_noise
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_FILE, RunStart
from pointing_analysis.formatting.number_text import digits, percent, with_unit
from pointing_analysis.formatting.tables import Heading, numbers
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.requirement import Requirement
from pointing_analysis.requirements.summary import Summary, exposure_of_run
from titop_plant.interface import DT, MIRROR_STAGES
from titop_plant.simulation.plant_config import parameter_values
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.weights import rpe_weight, window_ratio
from titop_plant.telescope.window_noise import WindowNoise, combined_level

WORST_INDICES = ("APE", "slow", "fast")
"""Indices whose worst tones are compared; the worst RPE is that of a slow or of a fast tone."""


@dataclass(frozen=True)
class ToneLevel:
    """What a part of the instants, or windows, stays below, beside the limit of a requirement.

    Parameters
    ----------
    limit, value : float
        arcsec for the APE, else mas.
    probability : float
        The part.
    """

    limit: float
    value: float
    probability: float


@dataclass(frozen=True)
class WorstToneRun:
    """One tone of unit norm: what the model says of it and what a record shows.

    Parameters
    ----------
    index : str
    omega : float
        rad/s.
    gamma : float
    limit, predicted, measured : float
        Limit of the index and amplitude of the error; arcsec for the APE, else mas.
    levels : tuple of ToneLevel
        With sensor noise, for each requirement on the index.
    """

    index: str
    omega: float
    gamma: float
    limit: float
    predicted: float
    measured: float
    levels: tuple[ToneLevel, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of the amplitudes."""
        return "arcsec" if self.index == "APE" else "mas"

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON."""
        return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in asdict(self).items()}


def worst_tone_of(run: Run, parts: RunParts) -> WorstToneRun | None:
    """The tone of a run without noise, fitted to its record; None where the bag holds no worst-case tone.

    Parameters
    ----------
    run : Run
    parts : RunParts
        Of the run.
    """
    data = run.attachments.get(START_FILE)
    tone = None if data is None else RunStart.from_bytes(data).tone
    if tone is None:
        return None
    values, window = run["truth/los"].values[:, :2], exposure_of_run(run)
    angle = tone.omega * DT * np.arange(len(values))
    fit = linalg.lstsq(np.column_stack([np.cos(angle), np.sin(angle)]), values)[0]
    size = float(np.sqrt(np.sum(fit**2)))
    name, unit, weight, turn, ratio = "APE", RAD_PER_ARCSEC, 1.0, 0.0, 1.0
    if tone.index != "APE":
        name, unit, turn = "RPE", RAD_PER_MAS, tone.omega * window
        weight, ratio = float(rpe_weight(tone.omega, window)), float(window_ratio(turn))
    noise = _noise(parts)[name != "APE"]
    noise, gain = noise.changed(noise.rms / unit), tone.gain / unit
    levels = tuple(
        ToneLevel(r.limit / unit, combined_level(gain * ratio, noise, r.probability, turn), r.probability)
        for r in parts.telescope.requirements
        if judges(r, name, window)
    )
    return WorstToneRun(tone.index, tone.omega, tone.gamma, tone.limit / unit, gain, weight * size / unit, levels)


def _noise(parts: RunParts) -> tuple[WindowNoise, WindowNoise]:
    """Sensor noise in the line of sight [rad], of the instants and of windows: none where no mirror is commanded."""
    telescope, loop = parts.sampled_telescope, parts.config.loop
    if loop not in MIRROR_STAGES:
        return WindowNoise(0.0), WindowNoise(0.0)
    k_fsm, k_pma = (parts.models[name] for name in ("k_fsm", "k_pma"))
    plant = loop_plant(telescope, telescope.loop_ports.used_by(k_fsm, k_pma))
    return loop_noise(plant.at(parameter_values(parts.settings, telescope)), k_fsm, k_pma, telescope, loop=loop)


def judges(requirement: Requirement, index: str, window: float) -> bool:
    """Whether a requirement has a limit of an index: of both axes, the RPE in windows [s]."""
    windows = (window,) if index == "RPE" else ()
    return requirement.index == index and not requirement.axis and requirement.times == windows


def figure(value: float, unit: str) -> str:
    """Three digits and the unit, which a word in place of a number has not."""
    return with_unit(digits(value, infinite="diverged"), unit if math.isfinite(value) else "")


COLUMNS = (
    Heading("stage"),
    Heading("worst tone"),
    *numbers("rad/s", "Hz", "gamma", "predicted", "measured", "with noise, all draws", "windows of the run", "limits"),
)


def levels_text(tone: WorstToneRun) -> str:
    """Levels with noise, the part of each where they are of several: "36 mas (99.9 %), 31 mas (95 %)"."""
    levels = {level.probability: level.value for level in tone.levels}
    if len(levels) < 2:
        return "".join(figure(value, tone.unit) for value in levels.values())
    return ", ".join(f"{figure(value, tone.unit)} ({percent(p, 10)})" for p, value in levels.items())


def limits_met(tone: WorstToneRun) -> str:
    """Limits of an index that a tone with noise meets and exceeds: "meets 100, exceeds 40"."""
    ordered = sorted(tone.levels, key=lambda level: -level.limit)
    met, exceeded = (
        [f"{level.limit:g}" for level in ordered if (level.value <= level.limit) == within] for within in (True, False)
    )
    texts = (f"meets {' and '.join(met)}", f"exceeds {' and '.join(exceeded)}")
    return ", ".join(text for text, names in zip(texts, (met, exceeded)) if names)


def rows(cells: Sequence[tuple[str, WorstToneRun, Summary]]) -> list[list[str]]:
    """Rows of the table: stage, tone, run with noise, limits that it meets and exceeds."""
    table = []
    for loop, tone, summary in cells:
        # the slowest tone of the APE takes longer than most records: their share of its instants is no quantile of it
        of_windows = "" if tone.index == "APE" else figure(summary.rpe_windows_quantile, tone.unit)
        table.append(
            [
                loop,
                tone.index if tone.index == "APE" else f"RPE, {tone.index}",
                f"{tone.omega:.4g}",
                f"{tone.omega / (2.0 * math.pi):.4g}",
                f"{tone.gamma:.3f} of {tone.limit:g} {tone.unit}",
                figure(tone.predicted, tone.unit),
                figure(tone.measured, tone.unit),
                levels_text(tone),
                of_windows,
                limits_met(tone),
            ]
        )
    return table


__all__ = [
    "COLUMNS",
    "WORST_INDICES",
    "ToneLevel",
    "WorstToneRun",
    "figure",
    "levels_text",
    "limits_met",
    "rows",
    "worst_tone_of",
]
