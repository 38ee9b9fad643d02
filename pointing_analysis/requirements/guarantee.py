"""Bounds that are proven for the loop of a run, as its recording has them, beside what was measured.

A run of ten seconds shows no percentile at a stated confidence. Where a proof holds for the loop and for the tone that
acts, its bound is in the table. The recording states it; it is checked where certificates are
(`ProvenBound.checked`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pointing_analysis.formatting.number_text import at_most
from pointing_analysis.read.mcap.bag_metadata import BUDGET, BUDGET_EDGE
from pointing_analysis.read.recording import Recording
from pointing_analysis.requirements.image_guarantee import METADATA as PROOF_RPE
from pointing_analysis.requirements.requirement import Requirement

METADATA = "proof_bounds"
"""Key of a bag: bounds with noise, JSON, see :func:`proven_bound`."""

ABSOLUTE, SLOW, FAST, BOTH = "APE", "slow", "fast", "both"
"""Quantity of a bound: the absolute error; the relative error of slow, fast, or both kinds of tones."""

AS_STATED = "stated in the bag, not checked"
"""Said of what a bag states of proofs, unless it was compared with the certificates at hand."""

NO_PROOF = "no proof for this loop"
OTHER_DISTURBANCE = "no proof for this disturbance"
OTHER_QUANTITY = "no proof of this quantity"
NOISE = "proof_noise"
"""Key of a bag whose loop has a proof with noise, for any disturbance."""


@dataclass(frozen=True)
class ProvenBound:
    """Bound of a requirement's index that is proven for the loop and the tone that acts.

    Parameters
    ----------
    value : float
        [rad].
    probability : float
        Share of the instants, or of the windows, that keep it.
    condition : str
        What happened in the run that the proof does not cover; empty where it holds for the run.
    checked : bool
        Whether the local certificates confirm it for this loop. A bag can state any number.
    """

    value: float
    probability: float
    condition: str = ""
    checked: bool = False

    def text(self, scale: float, unit: str) -> str:
        """The bound in a unit of `scale` [rad], rounded up.

        Examples
        --------
        >>> ProvenBound(3.99851e-7, 0.997, checked=True).text(1e-9, "nrad")
        '399.9 nrad, proven (99.7 %)'
        >>> ProvenBound(3.99851e-7, 0.997, "16 missed ticks", checked=True).text(1e-9, "nrad")
        '399.9 nrad, proven (99.7 %) without the 16 missed ticks'
        >>> ProvenBound(3.99851e-7, 0.997).text(1e-9, "nrad")
        '399.9 nrad (99.7 %), stated in the bag, not checked'
        """
        proven, whose = (", proven", "") if self.checked else ("", f", {AS_STATED}")
        tail = f" without the {self.condition}" if self.condition else ""
        return f"{at_most(self.value / scale)} {unit}{proven} ({100 * self.probability:.12g} %){tail}{whose}"


def proven_bound(run: Recording, requirement: Requirement) -> ProvenBound | None:
    """The bound that a recording states to be proven of a requirement's index, unchecked.

    None where it states none, or one that is not for the tones that act.

    Parameters
    ----------
    run : Recording
        Its entry `METADATA` has ``window_s``, ``condition`` and for each of the kinds above a pair of a bound [rad] and
        a probability; ``tones_rad_s`` are the tones that act.
    requirement : Requirement
        On the absolute error, or on the rms of the relative error in a window.
    """
    found = run.parameters.get(METADATA)
    if not isinstance(found, Mapping) or requirement.lower or requirement.axis:
        return None
    kind = _kind(run, found, requirement)
    pair = found.get(kind) if kind else None
    if not isinstance(pair, (list, tuple)) or len(pair) != 2:
        return None
    value, probability = (float(x) if isinstance(x, (int, float)) else math.nan for x in pair)
    if not (0.0 < value < math.inf and requirement.probability <= probability <= 1.0):
        return None
    return ProvenBound(value, probability, str(found.get("condition", "")))


def without_bound(run: Recording) -> str:
    """Remark on a requirement without a proven bound; empty for a recording that names no loop."""
    if "loop" not in run.parameters:
        return ""
    if run.parameters.get(METADATA):
        return OTHER_QUANTITY
    proven = any(run.parameters.get(key) for key in (NOISE, PROOF_RPE))
    return OTHER_DISTURBANCE if proven else NO_PROOF


def _kind(run: Recording, found: Mapping[str, Any], requirement: Requirement) -> str:
    """Which of the bounds is of this requirement and of the tones that act; empty where none is."""
    if requirement.index == "APE":
        return ABSOLUTE
    window = found.get("window_s")
    if requirement.index != "RPE" or not requirement.of_windows or requirement.times != (window,):
        return ""
    budget = run.parameters.get(BUDGET)
    edge = budget.get(BUDGET_EDGE) if isinstance(budget, Mapping) else None
    tones = run.parameters.get("tones_rad_s")
    if not isinstance(edge, (int, float)) or not isinstance(tones, list) or not tones:
        return BOTH
    kinds = {SLOW if abs(float(tone)) <= edge else FAST for tone in tones}
    return kinds.pop() if len(kinds) == 1 else BOTH
