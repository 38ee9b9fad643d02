"""A source of disturbance and the errors that it makes alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pointing_analysis.formatting.number_text import digits, percent
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from pointing_analysis.requirements.exposure import USUAL_PROBABILITY


@dataclass(frozen=True)
class SourceShare:
    """One source and its own errors.

    Attributes
    ----------
    name, kind, place : str
        Of the source.
    ape : float
        Quantile of its absolute error, both axes [arcsec].
    rpe : float
        Its relative error, rms of both axes in its windows [mas].
    share : float
        Its part of the sum of squares of the relative errors of all sources, between 0 and 1.
    part : float
        Of the instants, that the quantile holds for.
    settled : bool
        Whether the errors do not grow or fall beyond the time that was simulated.
    """

    name: str
    kind: str
    place: str
    ape: float
    rpe: float
    share: float
    part: float = USUAL_PROBABILITY
    settled: bool = True


def source_table(shares: Sequence[SourceShare], name: str = "sources") -> TextTable:
    """Sources of disturbance and their errors, each alone in the loop."""
    names = [s.name if s.settled else f"{s.name}, not settled" for s in shares]
    cells = [(name, s.kind, s.place, digits(s.ape), digits(s.rpe), percent(s.share)) for name, s in zip(names, shares)]
    parts = " and ".join(dict.fromkeys(percent(s.part, 10) for s in shares))
    heads = (*texts("source", "kind", "place"), *numbers(f"APE {parts} [arcsec]", "RPE rms [mas]", "share of the RPE"))
    return TextTable.of(heads, cells, "Sources, each alone in the loop; shares add up", name=name)
