"""What is proven of a recorded run: of the loop that its record shows to have run, and of no other."""

from __future__ import annotations

from dataclasses import replace

from lftkit.proofs.trusted.proof import ProofError
from los_testbed.run.proven_loop import bounds_of, proof_of
from los_testbed.run.summary.ran_loop import RanLoop
from pointing_analysis.requirements.guarantee import NO_PROOF, OTHER_DISTURBANCE, OTHER_QUANTITY
from pointing_analysis.requirements.image_guarantee import proven_text
from pointing_analysis.requirements.summary import Summary
from titop_plant.interface import MIRROR_STAGES

NONE_AT_HAND = "none of these controllers on this telescope is at hand"
ABOVE = 1.1
"""Part of a proven bound up to which a quantile of a record may be, which scatters."""


def with_proof(loop: RanLoop, summary: Summary) -> tuple[Summary, tuple[str, ...]]:
    """The summary of a run with the bounds that are proven of it, and the lines that say so, or why nothing is.

    A record far above a bound is not one of the proven loop. A stage without fine control has neither.
    """
    if loop.run.parameters.get("loop") not in MIRROR_STAGES:
        return summary, ()
    against, proven = loop.against_proof(), None
    if not against and loop.parts is not None:
        try:
            proven = proof_of(loop.parts)
            against = [] if proven else [NONE_AT_HAND]
        except ProofError as error:
            against = [f"the bundle beside the controllers is not used: {error}"]
    if proven is None or loop.parts is None:
        return summary, (f"{NO_PROOF}: {'; '.join(against)}",)
    bounds = bounds_of(loop.parts, proven)
    of_verdicts = [None if bounds is None else bounds.of(verdict.requirement) for verdict in summary.verdicts]
    for bound, verdict in zip(of_verdicts, summary.verdicts):
        if bound is not None and verdict.quantile.value > ABOVE * bound.value:
            return summary, (f"{NO_PROOF}: {verdict.requirement.quantity} of the record is above the proven bound",)
    other = OTHER_DISTURBANCE if bounds is None else OTHER_QUANTITY
    beside = tuple(
        replace(one, proven=bound, unproven="" if bound else other) for one, bound in zip(summary.beside, of_verdicts)
    )
    lines = [proven.text, proven.noise_text]
    if proven.relative is not None and summary.star is not None:
        window = loop.parts.telescope.weights.rpe_window
        lines.append(proven_text(proven.relative, window, summary.star.optics, summary.star.figures))
    return replace(summary, beside=beside), tuple(text for text in lines if text)
