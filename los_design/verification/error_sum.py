"""One bound that others make together, against its limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

WITH_NOISE = {
    "APE, tone of norm 1 and noise": "APE",
    "RPE, slow tone of norm 1 and noise": "slow tone",
    "RPE, fast tone of norm 1 and noise": "fast tone",
    "RPE, slow and fast tone, norm 1 in all, and noise": "both",
}
"""Sums of tones and noise, and what they are called in a sentence."""
ABOVE = "bound above the limit"


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
    """

    name: str
    value: float
    limit: float
    unit: str

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
        'APE, tone and noise: 9.332 of 12 arcsec'
        """
        return f"{self.name}: {self._of_limit}{'' if self.kept else f', {ABOVE}'}"

    @property
    def short_text(self) -> str:
        """A sum with noise as part of a sentence.

        Examples
        --------
        >>> ErrorSum("RPE, fast tone of norm 1 and noise", 42.96, 36.0, "mas").short_text
        'fast tone 42.96 of 36 mas (bound above the limit)'
        """
        return f"{WITH_NOISE.get(self.name, self.name)} {self._of_limit}{'' if self.kept else f' ({ABOVE})'}"

    @property
    def _of_limit(self) -> str:
        return f"{math.ceil(self.value * 1e3) / 1e3:g} of {self.limit:g} {self.unit}"
