"""Bounds that are proven for the loop of a run, beside what was measured.

A run of ten seconds shows no percentile at a stated confidence. Where a proof holds for the loop that ran and for the
tone that acted, its bound is in the table. A recording states no proof: who has the certificates and has compared the
recording with the loop that they are about gives the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

from pointing_analysis.formatting.number_text import at_most
from pointing_analysis.requirements.requirement import Requirement

NO_PROOF = "no proof of this run"
OTHER_DISTURBANCE = "no proof for this disturbance"
OTHER_QUANTITY = "no proof of this quantity"


@dataclass(frozen=True)
class ProvenBound:
    """Bound of a requirement's index that is proven for the loop and the tone that acts.

    Parameters
    ----------
    value : float
        [rad].
    probability : float
        Share of the instants, or of the windows, that keep it.
    """

    value: float
    probability: float

    def text(self, scale: float, unit: str) -> str:
        """The bound in a unit of `scale` [rad], rounded up.

        Examples
        --------
        >>> ProvenBound(3.99851e-7, 0.997).text(1e-9, "nrad")
        '399.9 nrad, proven (99.7 %)'
        """
        return f"{at_most(self.value / scale)} {unit}, proven ({100 * self.probability:.12g} %)"


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds with noise that are proven of the loop of a run, for the tones that act.

    Parameters
    ----------
    absolute, relative : ProvenBound or None
        Of the absolute error, and of the rms of the relative error in each window.
    window : float
        Length of these windows [s].
    """

    absolute: ProvenBound | None
    relative: ProvenBound | None
    window: float

    def of(self, requirement: Requirement) -> ProvenBound | None:
        """The bound of a requirement's index; None for another quantity, or a higher probability."""
        if requirement.lower or requirement.axis:
            return None
        windows = requirement.index == "RPE" and requirement.of_windows and requirement.times == (self.window,)
        bound = self.absolute if requirement.index == "APE" else self.relative if windows else None
        return bound if bound is not None and requirement.probability <= bound.probability else None
