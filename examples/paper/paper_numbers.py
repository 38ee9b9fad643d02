"""Numbers beside the paper's figures: gammas, decades between wheels and drives, what the proof masses take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from paper_case import DESIGNS, PaperCase

from lftkit.arrays import FloatArray
from los_design.synthesis.provenance import law_digest
from los_design.verification.verification import PAPER_NOMINAL, PAPER_ROBUST, SHORT_NAMES, check_paper
from los_loop.figures_of_merit import paper_figures
from pointing_analysis.formatting.number_text import number
from titop_plant.disturbances.responses import DRIVES, WHEELS, Curve
from titop_plant.interface import MIRROR_STAGES

BANDS = (1.0, 6.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Ends of the bands of frequency [rad/s]."""

PER_DECADE = 100
"""Columns in which a curve is compared, each with the highest value inside it: no resonance is lost."""

KIND = {"fsm": "k-fsm", "pma": "k-pma"}
PUBLISHED = {"robust": PAPER_ROBUST, "nominal": PAPER_NOMINAL}

Row = dict[str, Any]


def results(case: PaperCase) -> dict[str, Any]:
    """All numbers, as rows of tables, and what they are of; six digits, which are the same on all processors."""
    tables = {"gammas": gammas(case), "decades": decades(case), "reduction": reduction(case)}
    return {**names(case), **_rounded(tables)}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return number(round(value, 9))
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, list) else value


def names(case: PaperCase) -> dict[str, Any]:
    """Names of the telescope's parameters and of the designs' matrices."""
    designs = {name: [law_digest(system) for system in pair] for name, pair in case.pairs.items()}
    return {"telescope": case.telescope.parameters_hash, "designs": designs}


def gammas(case: PaperCase) -> list[Row]:
    """Certified gammas of the four designs beside the paper's, each of the paper's limit.

    Robust designs: the largest over the members that are drawn. Nominal designs: at the nominal member, and the largest
    over those members, for which they were not designed: these rows have no status.
    """
    family: list[Mapping[str, float]] = [*case.members]
    nominal: list[Mapping[str, float]] = [{}]
    asked = (("robust", "robust", family), ("nominal", "nominal", nominal), ("nominal", "nominal, family", family))
    rows: list[Row] = []
    for design, label, at in asked:
        found = check_paper(case.telescope, *case.pairs[design], at)
        for (short, stage), system in zip(SHORT_NAMES.items(), case.pairs[design]):
            names = [row.name for row in paper_figures(stage)]
            status = system.provenance.get("status", "") if label in DESIGNS else ""
            rows.append(_row(short, label, dict(zip(names, found[short])), status))
        if label in DESIGNS:
            for short, stage in SHORT_NAMES.items():
                names = [row.name for row in paper_figures(stage)]
                rows.append(_row(short, f"published, {label}", dict(zip(names, PUBLISHED[label][short]))))
    if case.alone is not None:
        pair = case.alone, case.pairs["robust"][1]
        found, (short, stage) = (
            check_paper(case.telescope, *pair, family),
            next(iter(SHORT_NAMES.items())),
        )
        names = [row.name for row in paper_figures(stage)]
        rows.insert(0, _row(short, "robust, alone", dict(zip(names, found[short])), case.alone.provenance["status"]))
    return sorted(rows, key=lambda row: row["design"])


def _row(short: str, variant: str, values: Mapping[str, float], status: str = "") -> Row:
    shown = {name: value if math.isfinite(value) else "inf" for name, value in values.items()}
    return {"design": KIND[short], "variant": variant, "gammas": shown, "status": status}


def decades(case: PaperCase) -> list[Row]:
    """Decades by which the wheels exceed the drives at the line of sight, in each band.

    Both normalised by their weights. The median over the frequencies of a band, of the nominal member; lowest and
    highest such median of all members.
    """
    responses = case.responses
    curves = [
        [responses.weighted(responses.isolated, values, inputs, BANDS[0], BANDS[-1]) for inputs in (WHEELS, DRIVES)]
        for values in case.members
    ]

    def medians(edges: FloatArray) -> list[float]:
        return [float(np.median(np.log10(one.columns(edges) / two.columns(edges)))) for one, two in curves]

    return _banded(medians)


def reduction(case: PaperCase) -> list[Row]:
    """Decibels that the proof masses take from the mirror's curve in each band, with the robust designs.

    The median over the frequencies of a band, of the nominal member and lowest and highest of all; and of the largest
    values of all members in the band. Members of an unstable loop are left out.
    """
    clouds = (case.clouds("robust")[stage] for stage in MIRROR_STAGES)
    stable = [pair for pair in zip(*clouds) if all(np.isfinite(curve.size).all() for curve in pair)]
    if not stable:
        return []
    alone, both = zip(*stable)

    def medians(edges: FloatArray) -> list[float]:
        return [_decibel(np.median(one.columns(edges) / two.columns(edges))) for one, two in zip(alone, both)]

    rows = _banded(medians)
    for row in rows:
        low, high = row["band"]
        highest = [max(_within(curve, low, high) for curve in cloud) for cloud in (alone, both)]
        row |= {"peaks": _decibel(highest[0] / highest[1]), "peak_mas": [1e3 * value for value in highest]}
    return rows


def _banded(of: Callable[[FloatArray], Sequence[float]]) -> list[Row]:
    """A row for each band of the value of the first member, and the range of all."""
    rows: list[Row] = []
    for low, high in pairwise(BANDS):
        count = max(1, round(PER_DECADE * math.log10(high / low)))
        values = of(np.asarray(np.geomspace(low, high, count + 1), dtype=float))
        rows.append({"band": [low, high], "nominal": values[0], "family": [min(values), max(values)]})
    return rows


def _within(curve: Curve, low: float, high: float) -> float:
    return float(curve.size[(curve.omega >= low) & (curve.omega <= high)].max())


def _decibel(ratio: Any) -> float:
    return float(20.0 * np.log10(ratio))
