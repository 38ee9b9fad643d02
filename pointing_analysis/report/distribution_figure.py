"""Distributions of the judged indices: for each index the share of its samples above each value, with its own limits.

The samples are those by which a requirement is judged, and a limit is shown in the picture of its own index only, with
the share that its requirement allows to be above it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from lftkit.errors import InputError
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, present
from pointing_analysis.report.figures import (
    LIMIT,
    Picture,
    RunView,
    _few_decades,
    _panels,
    legend_above,
    picture,
    stroke,
)
from pointing_analysis.requirements.requirement import Requirement, parse, time_text
from pointing_analysis.requirements.verdict import index_samples, series_of

LEFT = 0.99
"""Share of time above the smallest value of a picture of a distribution: below, the error only passes through zero."""

ALWAYS = ("|APE|", "|RPE({window})|")
"""Quantities that are always shown, the second one if the runs have its windows."""

ABSOLUTE = ("APE", "MPE")
"""Indices that are shown in arcsec, others in mas."""

SHOWN = (*ABSOLUTE, "RPE", "PDE")
"""Indices that one run without an estimate has."""


def distributions(views: Sequence[RunView], requirements: Sequence[Requirement]) -> list[Picture | str]:
    """A picture of each index that is required, and of those that are always shown, or why there is none.

    Parameters
    ----------
    views : of all runs
    requirements : of all runs; those on an index that a run does not have are left out
    """
    asked: dict[str, list[Requirement]] = {}
    for text in ALWAYS:
        quantity = text.format(window=time_text(views[0].window))
        asked[quantity] = []
    for requirement in requirements:
        if requirement.index in SHOWN:
            asked.setdefault(requirement.quantity, []).append(requirement)
    return [_distribution(views, quantity, of_quantity) for quantity, of_quantity in asked.items()]


def _distribution(views: Sequence[RunView], quantity: str, requirements: Sequence[Requirement]) -> Picture | str:
    """Share of the samples of an index above each value, or why a run has none."""
    requirement = requirements[0] if requirements else parse(f"prob({quantity} < 1 arcsec) >= 0.997 at 95 % confidence")
    unit, scale = ("arcsec", RAD_PER_ARCSEC) if requirement.index in ABSOLUTE else ("mas", RAD_PER_MAS)
    try:
        series = [series_of(requirement, view.run, view.series.start) for view in views]
        values = [present(index_samples(one, requirement).values) for one in series]
    except InputError as error:
        return f"No distribution of {quantity}: {error}."
    if without := [view.label for view, samples in zip(views, values) if not len(samples)]:
        return f"No distribution of {quantity}: {', '.join(without)} has no sample of it."

    samples = "windows" if requirement.of_windows else "samples"

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        smallest = [one.limit / scale for one in requirements]
        asked_for = sorted({one.probability for one in requirements})
        for i, (view, own_values) in enumerate(zip(views, values)):
            r = SortedValues(by_parts(lambda rows: rows / scale, own_values))
            # Even steps in the logarithm of the share: the tail keeps all of its points. Between two samples the share
            # is that of the larger one; the curve crosses each required share at the value of the verdict.
            ranks = [r.rank(p) for p in asked_for]
            pick = np.concatenate([r.size - np.geomspace(1, r.size, 400), ranks, np.add(ranks, 1)])
            pick = np.unique(pick.astype(int).clip(0, r.size - 1))
            pick = pick[r.at(pick) > 0.0]
            axis.loglog(r.at(pick), 1 - pick / r.size, ds="steps-pre", label=view.label, **stroke(i, len(views)))
            value = [r.quantile(p) for p in asked_for]
            axis.plot(value, np.subtract(1.0, asked_for), "o", mfc="none", **stroke(i, len(views)))
            smallest += [value for value in [r.quantile(1.0 - LEFT)] if value > 0.0]
        if requirements:
            axis.plot([], [], "o", mfc="none", color="#555555", label="value of the requirement")
        allowed = {(one.limit, one.probability): one for one in requirements}
        for limit, probability in sorted(allowed):
            text = f"limit {limit / scale:.6g} {unit} for {100 * probability:.6g} %"
            axis.axvline(limit / scale, color=LIMIT, ls="--", lw=0.9)
            axis.plot(limit / scale, 1.0 - probability, "v", color=LIMIT, ms=6, label=text)
        for share in sorted(1.0 - p for p in asked_for):
            axis.axhline(share, color="#555555", ls=":", lw=0.9, label=f"{100 * share:.4g} %")
        if smallest:
            axis.set_xlim(left=0.7 * min(smallest))
        _few_decades(axis)
        axis.set_xlabel(f"{quantity} [{unit}]")
        axis.set_ylabel(f"share of {samples} above")
        legend_above(figure, axis)

    alt = f"Share of the {samples} in which {quantity} exceeds each value{', with its limits' if requirements else ''}"
    name = "".join(c if c.isalnum() else "-" for c in quantity.lower()).strip("-")
    return picture(name, f"Distribution of {quantity}", alt, 3.8, draw)
