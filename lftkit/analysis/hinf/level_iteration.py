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
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

MAX_LEVELS = 40  # tested at most; the iteration converges quadratically
AGREEMENT = 0.1  # relative difference of a gain in modal form and by a direct solution over `rtol`, at most


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
