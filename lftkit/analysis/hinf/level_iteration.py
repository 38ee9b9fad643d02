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
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class NormSettings(AlgorithmSettings):
    """Numbers of the H-infinity and H2 norms.

    Attributes
    ----------
    levels : levels that are tested at most; the iteration converges quadratically
    agreement : relative difference of a gain in modal form and by a direct solution over `rtol`, at most
    intervals : intervals that are tested at most
    peak_cuts : first cuts around a peak: halvings of the distance of the nearest pole
    inside : an interval's half width over the distance of the nearest pole, at most: expansions converge
    schur_rounding : relative error of the slowest decay in a Schur form, from which on modes give the H2 norm
    on_axis : distance of a pole from the imaginary axis over the largest magnitude of a pole that is none

    climb_steps : steps of Newton's method to a peak, at most
    fall : a step that would raise the gain by less than this times the tolerance is not taken
    starts : frequencies from which a peak is searched
    rival : part of the largest gain below which a frequency is no start

    small_states : states up to which a system is one of few states
    separation : rounding of the poles over the distance from the axis of the eigenvalues at the level, at most
    cancelled : roundings in the square of a level, relative to the square of the sum of the modal terms
    small_gap : relative distance of the squares of level and norm of D below which crossings may be displaced
    large : gains between this and its inverse have fourth powers that are numbers
    climbed : part of `rtol` to which a peak of few states is climbed
    direct : relative rounding of a direct solution without refinement over `rtol`, at most
    direct_of_map : the same with the rounding of a map, which a direct solution does not have
    map_condition : largest condition number of the matrix that a map to continuous time inverts

    chunk : entries of the arrays of one step of the interval test, so that they stay in the cache
    growth : ratio of the intervals away from a pole, in continuous time
    imaginary : real part of an imaginary eigenvalue over its magnitude, at most: one too many costs only a gain
    displaced : the same over the largest magnitude
    unpaired : twice a real part over the distance from the reflection of another one, of an imaginary eigenvalue
    samples : frequencies at which the terms of a gain are summed, at most

    order : order of the expansions on the unit circle
    circle_growth : ratio of the intervals away from a pole, on the unit circle
    circle_margin : part of `rtol` between a gain and the level above it: the rest is for its rounding
    settled : sum of a row of the residual over the distance of its pole from the circle, at most
    separate : the same, above which the eigenvectors are corrected
    circle_condition : largest condition number of the eigenvectors
    resolvents : entries of the inverses that are held at once
    variance_error : relative error of the variance by rounding, at most
    gramians : relative difference of the variances by both Gramians, at most

    exact_states : states up to which integer arithmetic is used
    exact_bits : bits between the largest and the smallest digit of the matrices, at most
    exact_depth : halvings of an interval in integer arithmetic, at most
    exact_parts : intervals in integer arithmetic, at most
    exact_starts : points of each half of the circle from which a peak is searched
    exact_steps : steps of the golden section to a peak
    """

    levels: int = 40
    agreement: float = 0.1
    intervals: int = 40_000
    peak_cuts: int = 13
    inside: float = 0.75
    schur_rounding: float = 1e-6
    on_axis: float = 1e-14

    climb_steps: int = 20
    fall: float = 0.01
    starts: int = 3
    rival: float = 0.7

    small_states: int = 40
    separation: float = 1e-3
    cancelled: float = 100.0
    small_gap: float = 1e-4
    large: float = 1e70
    climbed: float = 0.1
    direct: float = 1e-3
    direct_of_map: float = 1e-2
    map_condition: float = 1e4

    chunk: int = 40_000
    growth: float = 4.0
    imaginary: float = 1e-7
    displaced: float = 1e-13
    unpaired: float = 3.0
    samples: int = 40

    order: int = 4
    circle_growth: float = 2.0
    circle_margin: float = 0.9
    settled: float = 0.25
    separate: float = 1e-11
    circle_condition: float = 1e12
    resolvents: int = 200_000
    variance_error: float = 1e-9
    gramians: float = 1e-6

    exact_states: int = 24
    exact_bits: int = 400
    exact_depth: int = 120
    exact_parts: int = 20_000
    exact_starts: int = 16
    exact_steps: int = 40


SETTINGS = NormSettings()
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


def bracketed_norm(model: GainModel, levels: int) -> NormBracket:
    """Both sides of the largest gain of a model.

    Raises
    ------
    UndecidedError
        By the model, or after so many `levels`.
    """
    peak = model.first_peak()
    value, level = model.bracket(peak)
    for _ in range(levels):
        higher = model.higher_peak(level, peak)
        if higher is None:
            return NormBracket(value, level, peak.omega)
        better, next_level = model.bracket(higher)
        if better > value:
            value, peak = better, higher
        if not next_level > level:
            raise UndecidedError(f"the level {level} is exceeded by rounding alone")
        level = next_level
    raise UndecidedError(f"the H-infinity norm did not settle in {levels} levels")


def above_level(
    bounds: Bounds, level: float, intervals: FloatArray, most: int, at_once: int
) -> tuple[FloatArray, FloatArray] | None:
    """Centres of intervals at which a gain exceeds `level`, and those gains; None: it stays below on all intervals.

    Parameters
    ----------
    bounds : callable
        Of centres and half widths, both (N,): the gain at the centres, and a bound of it on the intervals, both (N,).
    level : float
    intervals : ndarray, shape (N, 2)
    most : int
        Intervals that are tested at most.
    at_once : int
        Intervals in one call of `bounds`.

    Raises
    ------
    UndecidedError
        More than `most` intervals, or one that cannot be halved.
    """
    done = 0
    while len(intervals):
        done += len(intervals)
        if done > most:
            raise UndecidedError(f"more than {most} intervals")
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
