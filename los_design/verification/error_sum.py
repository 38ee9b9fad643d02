"""One bound that others make together, against its limit, and the parts of a band that it is made of.

A window of the relative error is short beside fast tones near their edge to the slow ones, so that most of their error
adds up with that of slow tones and of noise (:mod:`titop_plant.telescope.error_budget`): sums need the bound of each
part. Names are those of proofs and of their files.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from pointing_analysis.formatting.number_text import at_most
from titop_plant.interface import FORCE_STAGES
from titop_plant.telescope.requirements import design_limits
from titop_plant.telescope.telescope import Telescope

FAST = "fast"
PART = f"{FAST}, "
"""Beginning of the name of a part of the fast tones' band."""
NEAR_EDGE = (1.0, 126.0 / 85.0, 128.5 / 85.0, 132.0 / 85.0, 138.0 / 85.0, 150.0 / 85.0, 200.0 / 85.0, 250.0 / 85.0)
"""Edges of the parts over that of the band: closer where tones of the reference telescope are largest."""

WITH_NOISE = {
    "APE, tone of norm 1 and noise": "APE",
    "RPE, slow tone of norm 1 and noise": "slow tone",
    "RPE, fast tone of norm 1 and noise": "fast tone",
    "RPE, slow and fast tone, norm 1 in all, and noise": "both",
}
"""Sums of tones and noise, and what they are called in a sentence."""
ABOVE = "bound above the limit"


def parts_of_band(telescope: Telescope) -> dict[str, tuple[float, float]]:
    """Band [rad/s] of each part of the fast tones' band that can have a bound of its own, by name.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> list(parts_of_band(load_telescope()))[:2]
    ['fast, 85 to 126', 'fast, 126 to 128.5']
    """
    edges = [float(f"{telescope.weights.band_edge * ratio:.9g}") for ratio in NEAR_EDGE]
    return {f"{PART}{low:g} to {high:g}": (low, high) for low, high in itertools.pairwise(edges)}


@dataclass(frozen=True)
class ErrorSum:
    """A sum of contributions against its limit.

    Parameters
    ----------
    name : str
        What acts.
    value, limit : float
        In `unit`.
    unit : str
    probability : float, optional
        With which the value is kept where noise acts: part of the instants or of the windows. None without noise.
    """

    name: str
    value: float
    limit: float
    unit: str
    probability: float | None = None

    @property
    def kept(self) -> bool:
        """Whether it is within the limit."""
        return self.value <= self.limit

    @property
    def text(self) -> str:
        """With its limit.

        Examples
        --------
        >>> ErrorSum("APE, tone and noise", 9.3312, 12.0, "arcsec").text
        'APE, tone and noise: 9.3312 of 12 arcsec'
        >>> ErrorSum("APE, tone and noise", 9.3312, 12.0, "arcsec", 0.997).text
        'APE, tone and noise: 9.3312 of 12 arcsec with probability 0.997'
        """
        how_often = "" if self.probability is None else f" {probability_text(self.probability)}"
        return f"{self.name}: {self._of_limit}{how_often}{'' if self.kept else f', {ABOVE}'}"

    @property
    def short_text(self) -> str:
        """A sum with noise as part of a sentence that says its probability elsewhere.

        Examples
        --------
        >>> ErrorSum("RPE, fast tone of norm 1 and noise", 42.96, 36.0, "mas").short_text
        'fast tone 42.96 of 36 mas (bound above the limit)'
        """
        return f"{WITH_NOISE.get(self.name, self.name)} {self._of_limit}{'' if self.kept else f' ({ABOVE})'}"

    @property
    def _of_limit(self) -> str:
        return f"{at_most(self.value, 5)} of {self.limit:g} {self.unit}"


def probability_text(part: float) -> str:
    """Words for a probability, with all its digits.

    Examples
    --------
    >>> probability_text(0.997), probability_text(0.99999999)
    ('with probability 0.997', 'with probability 0.99999999')
    """
    return f"with probability {part!r}"


def window_limit(stage: str) -> str:
    """Name of the limit of the relative error of a stage with fine control.

    Examples
    --------
    >>> window_limit("fsm"), window_limit("fsm+pma")
    ('rpe_limit', 'rpe_limit_fine')
    """
    return "rpe_limit_fine" if stage in FORCE_STAGES else "rpe_limit"


def required_probabilities(telescope: Telescope, stage: str) -> tuple[float, float]:
    """Parts of the instants, and of the windows, that must keep the limits of a stage with fine control.

    Each is of the requirement that the limit is made of: that on windows of the mirror alone may be another one than
    that of all actuators.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> required_probabilities(load_telescope(), "fsm")
    (0.997, 0.997)
    """
    rules = telescope.requirements
    made = design_limits(rules)[1]
    instants, of_windows = (float(rules[made[name][0]].probability) for name in ("ape_limit", window_limit(stage)))
    return instants, of_windows
