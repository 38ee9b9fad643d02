"""Predicted and measured amplitudes of a run, tone by tone; the prediction comes from a model outside this package."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pointing_analysis.spectra.spectra import CLEAR


@dataclass(frozen=True)
class ToneComparison:
    """One tone of the disturbance in the line of sight.

    Parameters
    ----------
    omega : float
        rad/s.
    merged : int
        Number of tones merged in this one: the run is too short to resolve them.
    predicted, measured : float
        Amplitude [rad], norm of both axes: of the model, in the record.
    along, across : float
        Amplitude [rad] that noise alone would have there, rms: its component in the direction of the tone, and the
        other one (:func:`pointing_analysis.spectra.spectra.background`).

    Examples
    --------
    >>> ToneComparison(408.8, 1, predicted=2e-7, measured=2.1e-7, along=2e-9, across=0.0).in_noise
    False
    """

    omega: float
    merged: int
    predicted: float
    measured: float
    along: float
    across: float

    @property
    def in_noise(self) -> bool:
        """Whether neither the predicted nor the measured tone is above the noise."""
        return max(self.predicted, self.measured) < CLEAR * math.hypot(self.along, self.across)

    @property
    def ratio(self) -> float:
        """Measured over predicted."""
        return self.measured / self.predicted if self.predicted else float("inf")

    @property
    def uncertainty(self) -> float:
        """Two standard deviations of the ratio by noise.

        Half the mean square of the noise along the tone is in phase with it. What is across adds its square to that of
        the amplitude, exponentially distributed; its mean, which is an error of the ratio, too, is included.
        """
        if not self.predicted:
            return float("inf")
        along, across = self.along / self.predicted, self.across / self.predicted
        return math.hypot(math.sqrt(2.0) * along, math.sqrt(2.0) * across**2)


@dataclass(frozen=True)
class Prediction:
    """Predicted and measured tones of one run, or why there are none.

    Parameters
    ----------
    tones : tuple of ToneComparison
    start, stop : float
        The part of the run that both are fitted to [s].
    note : str
        Why nothing is predicted; empty where something is.
    """

    tones: tuple[ToneComparison, ...] = ()
    start: float = 0.0
    stop: float = 0.0
    note: str = ""
