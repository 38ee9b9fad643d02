"""Indices of a star's image in each exposure of an error series, for requirements on them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.image.motion_blur import exposure_parts, missing, worst_transfer
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quality import figures
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.requirements.requirement import Requirement


def image_samples(series: ErrorSeries, requirement: Requirement, optics: Optics) -> tuple[FloatArray, int]:
    """One value of the index for each exposure [rad, or a number], and the number of exposures that are missing.

    Exposures are those of `pointing_analysis.image.motion_blur.exposures`: one of N periods has N + 1 samples.

    Raises
    ------
    ValueError
        The exposure is no whole number of samples, or longer than the run.
    """
    found: list[FloatArray] = []
    gone = 0
    for paths in exposure_parts(series.values, series.dt, requirement.times[0]):
        lost = missing(paths)
        gone += int(lost.sum())
        found.append(index_of(paths[~lost], requirement, optics))
    return np.concatenate(found), gone


def index_of(paths: FloatArray, requirement: Requirement, optics: Optics) -> FloatArray:
    """Index of each exposure: (m, N + 1, 2) [rad] -> (m,)."""
    if requirement.frequency is not None:
        return worst_transfer(paths, requirement.frequency.per_radian(optics.nyquist))[0]
    name = requirement.index.lower()
    return figures(paths, optics, (name,))[name]


def finite(values: FloatArray) -> FloatArray:
    """Values with the largest finite one in place of infinite ones, for the correlation of neighbours."""
    infinite = ~np.isfinite(values)
    if not infinite.any():
        return values
    there: Sequence[float] = values[~infinite].tolist()
    return np.where(infinite, max(there, default=0.0), values)


def share(values: FloatArray, probability: float, lower: bool) -> float:
    """Value that a part of the exposures is below, or above where its limit would be a lower one; NaN of none."""
    if not len(values):
        return math.nan
    return float(np.quantile(values, 1 - probability if lower else probability, method="lower" if lower else "higher"))
