"""Indices of a star's image in each exposure of an error series, for requirements on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.image.motion_blur import exposure_parts, missing, worst_transfer
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quality import figures
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.read.mapped_arrays import SortedValues
from pointing_analysis.requirements.requirement import Requirement


def image_samples(series: ErrorSeries, requirement: Requirement, optics: Optics) -> FloatArray:
    """One value of the index for each exposure [rad, or a number], NaN where a sample is missing.

    Exposures are those of `pointing_analysis.image.motion_blur.exposures`: one of N periods has N + 1 samples.

    Raises
    ------
    ValueError
        The exposure is no whole number of samples, or longer than the run.
    """
    every: list[FloatArray] = []
    for paths in exposure_parts(series.values, series.dt, requirement.times[0]):
        there = ~missing(paths)
        values = np.full(len(paths), np.nan)
        values[there] = index_of(paths[there], requirement, optics)
        every.append(values)
    return np.concatenate(every)


def index_of(paths: FloatArray, requirement: Requirement, optics: Optics) -> FloatArray:
    """Index of each exposure: (m, N + 1, 2) [rad] -> (m,)."""
    if requirement.frequency is not None:
        return worst_transfer(paths, requirement.frequency.per_radian(optics.nyquist))[0]
    name = requirement.index.lower()
    return figures(paths, optics, (name,))[name]


def finite(values: FloatArray) -> FloatArray:
    """Values with the largest finite one in place of infinite ones, for the correlation of neighbours."""
    infinite = np.isinf(values)
    if not infinite.any():
        return values
    there: Sequence[float] = values[np.isfinite(values)].tolist()
    return np.where(infinite, max(there, default=0.0), values)


def share(values: FloatArray, probability: float, lower: bool) -> float:
    """Value that a part of the exposures is below, or above where its limit would be a lower one; NaN of none.

    It is the quantile of a verdict on them.

    Examples
    --------
    >>> share(np.arange(334.0), 0.997, lower=True), share(np.arange(334.0), 0.997, lower=False)
    (1.0, 332.0)
    """
    sign = -1.0 if lower else 1.0
    return sign * SortedValues(sign * values).quantile(probability)
