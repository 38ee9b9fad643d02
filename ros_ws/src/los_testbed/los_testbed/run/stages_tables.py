"""Tables of the stage comparison: on the screen, as Markdown, as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from los_testbed.parts.run_parts import RunParts
from los_testbed.run.stages import WORST, Plan, StageResult, provenance, select, stages_of
from los_testbed.run.summary import worst_case_rows
from pointing_analysis.formatting.number_text import ABSENT, digits, percent
from pointing_analysis.formatting.tables import Heading, TextTable, numbers, texts
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.requirements.exposure import Probabilities, exposure_of, probabilities_of
from pointing_analysis.requirements.requirement import time_text
from pointing_analysis.requirements.rows import BRIEF, requirement_table

TONES_SHOWN = 12
SETTLED = 0.02
"""The settled response of the model is shown where it differs by more from that in the record."""
HEADS = {
    "ape_max_arcsec": "APE max [arcsec]",
    "ape_quantile_arcsec": "APE {ape} [arcsec]",
    "rpe_rms_mas": "RPE rms [mas]",
    "rpe_windows_quantile_mas": "RPE {windows} of windows [mas]",
    "mtf_nyquist": "MTF at Nyquist, {image}",
    "strehl": "Strehl ratio, {image}",
}
"""Headings, with the part that a quantile holds for, by the names of ``Probabilities``."""
LOWER = ("mtf_nyquist", "strehl")
"""Metrics of which the smallest is the worst."""
ALONE = ("ape_max_arcsec", "rpe_rms_mas")
PART_METRICS = {"all": tuple(HEADS), "disturbance": ALONE, "noise": ALONE}
"""Metrics shown for each part of the error."""


DIVERGED = "diverged"
"""In place of a metric of a run without a summary."""


def cell(results: Sequence[StageResult], scenario: str, loop: str, part: str, metric: str) -> str:
    """Metric of the nominal telescope and, in brackets, the worst of all telescopes."""
    chosen = select(results, scenario, loop, part)
    values = {name: r.metrics[metric] for name, r in chosen.items() if metric in r.metrics}
    if "nominal" not in values:
        return ABSENT
    sign = -1.0 if metric in LOWER else 1.0
    worst = max(values, key=lambda name: math.inf if math.isnan(values[name]) else sign * values[name])
    # a run that is too short for an index has a summary without it, one that diverged has no summary
    missing = [DIVERGED if chosen[name].summary is None else ABSENT for name in ("nominal", worst)]
    texts = [digits(values[name], none=none, infinite=none) for name, none in zip(("nominal", worst), missing)]
    return texts[0] if len(values) == 1 else f"{texts[0]} ({texts[1]})"


def worst_rows(results: Sequence[StageResult], plan: Plan) -> list[list[str]]:
    """Rows of the table of the scenario worst_case."""
    cells = []
    for loop in plan.stages:
        whole = select(results, WORST, loop, "all")
        for index, alone in select(results, WORST, loop, "disturbance").items():
            summary = whole[index].summary
            if alone.worst is not None and summary is not None:
                cells.append((loop, alone.worst, summary))
    return worst_case_rows.rows(cells)


def columns(results: Sequence[StageResult], probabilities: Probabilities) -> list[tuple[str, str, str]]:
    """Part, metric and heading of each column."""
    values = {name: percent(part, 10) for name, part in vars(probabilities).items()}
    heads = {metric: head.format(**values) for metric, head in HEADS.items()}
    parts = dict.fromkeys(r.run.part for r in results if r.run.scenario != WORST)
    return [
        (part, metric, heads[metric] if part == "all" else f"{part} alone: {heads[metric]}")
        for part in parts
        for metric in PART_METRICS[part]
    ]


def rows(results: Sequence[StageResult], scenario: str, chosen: Sequence[tuple[str, str, str]]) -> list[list[str]]:
    """Rows of the table of a scenario: the stages."""
    return [
        [loop, *(cell(results, scenario, loop, part, metric) for part, metric, _ in chosen)]
        for loop in stages_of(results)
    ]


def tone_rows(results: Sequence[StageResult], scenario: str) -> tuple[list[list[str]], int]:
    """Transmissibility of the nominal telescope at the strongest tones, stage by stage, and the number of all tones."""
    stages = stages_of(results)
    tones = {
        loop: {t.omega: t for t in select(results, scenario, loop, "disturbance")["nominal"].tones} for loop in stages
    }
    omegas = sorted(set().union(*tones.values()), key=lambda w: -max(f[w].model for f in tones.values() if w in f))
    table = []
    for omega in sorted(omegas[:TONES_SHOWN]):
        row = [f"{omega / (2 * math.pi):.3f}"]
        for loop in stages:
            tone = tones[loop].get(omega)
            if tone is None:
                row.append(ABSENT)
                continue
            scale = tone.disturbance * RAD_PER_MAS
            text = f"{digits(tone.measured / scale)} / {digits(tone.expected / scale)}"
            settled = abs(tone.model / tone.expected - 1.0) < SETTLED
            row.append(text if settled else f"{text} ({digits(tone.model / scale)})")
        table.append(row)
    return table, len(omegas)


def requirements(results: Sequence[StageResult], scenario: str) -> TextTable:
    """Table of the requirements of the nominal telescope, stage by stage."""
    nominal = [(loop, select(results, scenario, loop, "all").get("nominal")) for loop in stages_of(results)]
    rows = [replace(row, run=loop) for loop, r in nominal if r is not None and r.summary for row in r.summary.rows]
    table = requirement_table(rows, several=True).only("run", *BRIEF)
    heads = (Heading("stage"), *table.columns[1:])
    return replace(table, columns=heads, title=f"{scenario}: requirements, nominal telescope")


def tables(results: Sequence[StageResult], plan: Plan) -> Iterable[tuple[str, TextTable]]:
    """Tables of all scenarios, each with what stands above it in Markdown; those without a row are left out."""
    required = RunParts(plan.base).telescope.requirements
    window = time_text(exposure_of(required))
    for scenario in plan.scenarios:
        title = f"{scenario}: {worst_caption(plan) if scenario == WORST else caption(results, plan)}"
        above = f"**Scenario `{scenario}`** ({title.partition(': ')[2]}; RPE: windows of {window})"
        if scenario == WORST:
            yield above, TextTable.of(worst_case_rows.COLUMNS, worst_rows(results, plan), title)
            continue
        shown = columns(results, probabilities_of(required))
        heads = (*texts("stage"), *numbers(*(head for _, _, head in shown)))
        yield above, TextTable.of(heads, rows(results, scenario, shown), title)
        yield "Requirements, nominal telescope:", requirements(results, scenario)
        tones, total = tone_rows(results, scenario) if "disturbance" in plan.parts else ([], 0)
        title = f"{scenario}: transmissibility [mas per N], measured / model (when settled), {_of(tones, total)}"
        above = (
            "Transmissibility [mas per N; 1 Nm counts as 1 N] of the nominal telescope, measured / model (model "
            f"when settled, if different), {_of(tones, total)}:"
        )
        yield above, TextTable.of((*texts("Hz"), *numbers(*plan.stages)), tones, title)


def screen(results: Sequence[StageResult], plan: Plan) -> Iterable[TextTable]:
    """Tables for the terminal; parts of the error, each alone, have one of their own."""
    for _, table in tables(results, plan):
        alone = [head for head in table.heads if " alone: " in head]
        if alone:
            yield table.only(*(head for head in table.heads if head not in alone))
            yield replace(table.only("stage", *alone), title="contributions to the error, each alone")
        elif table.rows:
            yield table


def _of(tones: Sequence[Any], total: int) -> str:
    return f"the {len(tones)} strongest of {total} tones" if len(tones) < total else f"{total} tones"


def worst_caption(plan: Plan) -> str:
    """Description of the rows of the scenario worst_case."""
    return (
        f"{plan.base.duration:g} s, {plan.base.start} start, seed {plan.base.seed}, {plan.base.mode}; each stage at "
        "its own worst parameters, with its worst tone of unit norm"
    )


def caption(results: Sequence[StageResult], plan: Plan) -> str:
    """Conditions of the metrics."""
    settled = max((r.transient for r in results if r.run.scenario != WORST), default=0.0)
    start = f"first {settled:g} s excluded" if settled else f"{plan.base.start} start"
    text = f"{plan.base.duration:g} s, {start}, seed {plan.base.seed}, {plan.base.mode}"
    return text + (f"; in brackets the worst of {plan.samples} telescopes" if plan.samples > 1 else "")


def markdown(results: Sequence[StageResult], plan: Plan) -> str:
    """All tables as Markdown."""
    lines = [line for above, t in tables(results, plan) if t.rows for line in (above, "", t.markdown(), "")]
    return "\n".join(lines)


def as_json(results: Sequence[StageResult], plan: Plan) -> dict[str, Any]:
    """Everything as one JSON object."""
    return {
        "command": "los-testbed stages",
        **provenance(plan),
        "runs": [r.as_dict() for r in results],
        "transmissibility": [
            {
                "scenario": r.run.scenario,
                "telescope": r.run.member,
                "loop": r.run.loop,
                "tones": [tone.as_dict() for tone in r.tones],
            }
            for r in results
            if r.tones and r.run.scenario != WORST
        ],
    }
