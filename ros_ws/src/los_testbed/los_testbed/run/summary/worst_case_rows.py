"""The scenario worst_case of the stage comparison: each stage at its own worst parameters, tone by tone.

For each index the run with the disturbance alone gives the measured amplitude of the tone, the model gives gamma times
the limit, and the run with noise as well gives the noise and the quantile of its windows. What the limits of the RPE
are compared with is the level that 99.7 % of the windows stay below with tone and noise
(:func:`titop_plant.telescope.window_noise.combined_level`), from the tone and the noise of the record: the quantile of
its windows has the scatter of the few that are largest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import linalg, special

from los_testbed.parts.start import START_FILE, RunStart
from pointing_analysis.formatting.number_text import digits, with_unit
from pointing_analysis.formatting.tables import Heading, numbers
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.requirement import Requirement
from pointing_analysis.requirements.summary import Summary, exposure_of_run
from titop_plant.interface import DT
from titop_plant.telescope.weights import rpe_weight
from titop_plant.telescope.window_noise import ON_AXIS, WindowNoise, combined_level

WORST_INDICES = ("APE", "slow", "fast")
"""Indices whose worst tones are compared; the worst RPE is that of a slow or of a fast tone."""

SHOWN = 0.997
"""Part of the instants, or windows, that the table's levels hold for: that of the quantiles of a summary."""

CONFIDENCE = 0.95
"""Of the statement that a limit is met, or exceeded."""


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
    """

    index: str
    omega: float
    gamma: float
    limit: float
    predicted: float
    measured: float

    @property
    def unit(self) -> str:
        """Unit of the amplitudes."""
        return "arcsec" if self.index == "APE" else "mas"

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON."""
        return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in asdict(self).items()}


def worst_tone_of(run: Run) -> WorstToneRun | None:
    """The tone of a run without noise, fitted to its record; None where the bag holds no worst-case tone."""
    data = run.attachments.get(START_FILE)
    tone = None if data is None else RunStart.from_bytes(data).tone
    if tone is None:
        return None
    values = run["truth/los"].values[:, :2]
    angle = tone.omega * DT * np.arange(len(values))
    fit = linalg.lstsq(np.column_stack([np.cos(angle), np.sin(angle)]), values)[0]
    size = float(np.sqrt(np.sum(fit**2)))
    unit, weight = RAD_PER_ARCSEC, 1.0
    if tone.index != "APE":
        unit, weight = RAD_PER_MAS, float(rpe_weight(tone.omega, exposure_of_run(run)))
    return WorstToneRun(tone.index, tone.omega, tone.gamma, tone.limit / unit, tone.gain / unit, weight * size / unit)


def level(summary: Summary, index: str, omega: float, errors: float = 0.0) -> float:
    """Level that is compared with the limits of an index: 99.7 % of the APE [arcsec]; tone and noise of the RPE [mas].

    `omega` is the frequency of the tone [rad/s]; `errors` standard errors of the record's noise are added to the noise
    of the RPE. NaN where tone and noise of the record cannot be distinguished.
    """
    if index == "APE" or summary.budget is None:
        return summary.ape_p997 if index == "APE" else summary.rpe_windows_p997
    budget = summary.budget
    if not math.isfinite(budget.noise + budget.slow + budget.fast):
        return budget.noise + budget.slow + budget.fast
    scatter = errors * budget.noise_error if math.isfinite(budget.noise_error) else 0.0
    noise = WindowNoise(max(0.0, budget.noise + scatter))
    if budget.spectrum is not None:
        hertz, power = budget.spectrum
        noise = WindowNoise.of_spectrum(noise.rms, ON_AXIS, 2.0 * math.pi * summary.window * hertz, power)
    return combined_level(max(budget.slow, budget.fast), noise, SHOWN, omega * summary.window)


def limits_met(summary: Summary, index: str, omega: float, requirements: Sequence[Requirement]) -> str:
    """Limits of an index that a run meets and exceeds: "meets 100, exceeds 40".

    :func:`level` is compared with each limit. The noise of a short record scatters: a limit is met if the level with
    the upper one-sided bound of the noise at :data:`CONFIDENCE` is within it, exceeded if that with the lower bound is
    not; else it is "within the scatter". Nothing is said where there is no level.
    """
    errors = float(special.ndtri(CONFIDENCE))
    least, most = level(summary, index, omega, -errors), level(summary, index, omega, errors)
    if math.isnan(least):
        return "tones not resolved"
    name = "APE" if index == "APE" else "RPE"
    unit = RAD_PER_ARCSEC if name == "APE" else RAD_PER_MAS
    bounds = sorted({r.limit / unit for r in requirements if judges(r, name, summary.window)}, reverse=True)
    met = [f"{b:g}" for b in bounds if most <= b]
    scattered = [f"{b:g}" for b in bounds if least <= b < most]
    exceeded = [f"{b:g}" for b in bounds if b < least]
    texts = (
        f"meets {' and '.join(met)}",
        f"{' and '.join(scattered)} within the scatter",
        f"exceeds {' and '.join(exceeded)}",
    )
    return ", ".join(text for text, names in zip(texts, (met, scattered, exceeded)) if names)


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
    *numbers("rad/s", "Hz", "gamma", "predicted", "measured", "with noise, 99.7 %", "windows, 99.7 %", "limits"),
)


def rows(cells: Sequence[tuple[str, WorstToneRun, Summary]], requirements: Sequence[Requirement]) -> list[list[str]]:
    """Rows of the table: stage, tone, run with noise, limits that it meets and exceeds."""
    table = []
    for loop, tone, summary in cells:
        quantile = summary.ape_p997 if tone.index == "APE" else summary.rpe_windows_p997
        table.append(
            [
                loop,
                tone.index if tone.index == "APE" else f"RPE, {tone.index}",
                f"{tone.omega:.4g}",
                f"{tone.omega / (2.0 * math.pi):.4g}",
                f"{tone.gamma:.3f} of {tone.limit:g} {tone.unit}",
                figure(tone.predicted, tone.unit),
                figure(tone.measured, tone.unit),
                figure(level(summary, tone.index, tone.omega), tone.unit),
                "" if tone.index == "APE" else figure(quantile, tone.unit),
                limits_met(summary, tone.index, tone.omega, requirements),
            ]
        )
    return table


__all__ = ["COLUMNS", "WORST_INDICES", "WorstToneRun", "level", "limits_met", "rows", "worst_tone_of"]
