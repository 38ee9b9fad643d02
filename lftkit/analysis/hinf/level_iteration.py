"""The level iteration behind every H-infinity norm (Bruinsma and Steinbuch 1990), and what it asks of a model.

A model of the gain over frequency searches peaks, says what gain is surely reached at one, and looks for a gain above a
level. The iteration raises the level until the model shows that there is none. The models:

=================================================================== ====================================================
:class:`lftkit.analysis.hinf.small_norm.SmallModel`                 up to 40 states, damping far from rounding
:class:`lftkit.analysis.hinf.interval_norm.IntervalModel`           modal form, intervals that cover the axis
:class:`lftkit.analysis.hinf.hamiltonian_norm.HamiltonianModel`     no modal form needed; the whole axis or a band
:class:`lftkit.analysis.circle.circle_norm.CircleModel`             discrete time, intervals that cover the unit circle
:class:`lftkit.analysis.circle.exact_circle_norm.ExactCircleModel`  discrete time, integer arithmetic
=================================================================== ====================================================

Models by intervals cover a range of frequencies or angles with them, and halve them until a bound of the gain is below
a level on each (:func:`above_level`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from lftkit.arrays import FloatArray

MAX_LEVELS = 40  # tested at most; the iteration converges quadratically
AGREEMENT = 0.1  # relative difference of a gain in modal form and by a direct solution over `rtol`, at most
MAX_INTERVALS = 40_000
PEAK_CUTS = 13  # first cuts around a peak: halvings of the distance of the nearest pole
INSIDE = 0.75  # an interval's half width over the distance of the nearest pole, at most: expansions converge

Bounds = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


class UndecidedError(ArithmeticError):
    """Rounding or the amount of work forbids an answer by this model."""


class Peak(NamedTuple):
    """A peak of the gain.

    Parameters
    ----------
    omega : float
        Frequency [rad/s], or angle on the unit circle [rad].
    gain : float
        Gain there, in the model.
    possible : float
        Gain that rounding does not exclude where the level was found to be exceeded.
    """

    omega: float
    gain: float
    possible: float = 0.0


class NormBracket(NamedTuple):
    """Gain that is reached at `omega`, level that is exceeded nowhere, and that frequency or angle."""

    value: float
    upper: float
    omega: float


class GainModel(Protocol):
    """A gain over frequency; every method may raise :class:`UndecidedError`."""

    def first_peak(self) -> Peak:
        """The highest peak that is found without a level."""

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain that is surely reached at `peak`, and the lowest level worth a test."""

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """A peak that exceeds `level`, or None where the gain stays below it at every frequency.

        `peak` is the highest one that is known.
        """


def bracketed_norm(model: GainModel) -> NormBracket:
    """Both sides of the largest gain of a model.

    Raises
    ------
    UndecidedError
        By the model, or after `MAX_LEVELS` levels.
    """
    peak = model.first_peak()
    value, level = model.bracket(peak)
    for _ in range(MAX_LEVELS):
        higher = model.higher_peak(level, peak)
        if higher is None:
            return NormBracket(value, level, peak.omega)
        better, next_level = model.bracket(higher)
        if better > value:
            value, peak = better, higher
        if not next_level > level:
            raise UndecidedError(f"the level {level} is exceeded by rounding alone")
        level = next_level
    raise UndecidedError(f"the H-infinity norm did not settle in {MAX_LEVELS} levels")


def above_level(
    bounds: Bounds, level: float, intervals: FloatArray, at_once: int = MAX_INTERVALS
) -> tuple[FloatArray, FloatArray] | None:
    """Centres of intervals at which a gain exceeds `level`, and those gains; None: it stays below on all intervals.

    Parameters
    ----------
    bounds : callable
        Of centres and half widths, both (N,): the gain at the centres, and a bound of it on the intervals, both (N,).
    level : float
    intervals : ndarray, shape (N, 2)
    at_once : int
        Intervals in one call of `bounds`.

    Raises
    ------
    UndecidedError
        More than `MAX_INTERVALS` intervals, or one that cannot be halved.
    """
    done = 0
    while len(intervals):
        done += len(intervals)
        if done > MAX_INTERVALS:
            raise UndecidedError(f"more than {MAX_INTERVALS} intervals")
        kept = []
        for start in range(0, len(intervals), at_once):
            part = intervals[start : start + at_once]
            centre, half = 0.5 * (part[:, 0] + part[:, 1]), 0.5 * (part[:, 1] - part[:, 0])
            gain, bound = bounds(centre, half)
            above = gain > level
            if above.any():
                return centre[above], gain[above]
            kept.append(part[~(bound <= level)])
        intervals = np.concatenate(kept)
        low, high = intervals.T
        middle = 0.5 * (low + high)
        if np.any((middle <= low) | (middle >= high)):
            raise UndecidedError("an interval cannot be halved")
        intervals = np.concatenate([np.column_stack([low, middle]), np.column_stack([middle, high])])
    return None
