"""Command ``los-testbed report``: one HTML page from one or several bags."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from lftkit.errors import InputError
from pointing_analysis.command.options import MAX_CHUNK_MB, From, Gate, Json, MaxChunk, To, Transient
from pointing_analysis.command.output import gate_of, leave_by_gate, leave_if_contradicted, print_json, seconds
from pointing_analysis.command.recordings import OpticsFile, Requirements, check_bag, open_runs, requirements_in
from pointing_analysis.command.report_files import Export, Format, PaperSize, report_files
from pointing_analysis.command.screen import Screen, on_screen, say
from pointing_analysis.formatting.tables import Marked, TextTable, numbers
from pointing_analysis.formatting.tables import texts as text_columns
from titop_plant.interface import STAGES

if TYPE_CHECKING:
    from pointing_analysis.requirements.summary import Summary

REPORT_EXAMPLES = """Write a report about one or several bags, a page or a PDF: verdict, figures, tables, provenance.

For bags of this testbed it also compares predicted and measured amplitudes of each tone of the disturbance. The page is
self-contained.

**Examples**

    los-testbed report bags/run-20260101-120000                    # into the bag's folder

    los-testbed report bags/none bags/isolator bags/fsm bags/fsm+pma --output stages.html

    los-testbed report bags/long --requirements mission.toml --transient 5

    los-testbed report bags/night --from 3600 --to 4200         # ten minutes of a large bag
"""


def report(
    bags: Annotated[list[Path], typer.Argument(help="Bags: folders or .mcap files.")],
    output: Annotated[
        Path | None,
        typer.Option(
            help="Report to write, .html or .pdf. Default: report.html in the folder of a single bag, else here."
        ),
    ] = None,
    form: Format = None,
    paper: PaperSize = None,
    export: Export = None,
    requirements: Requirements = None,
    optics: OpticsFile = None,
    transient: Transient = None,
    start: From = 0.0,
    stop: To = math.inf,
    namespace: Annotated[str | None, typer.Option(help="Namespace of the plant, in bags with several.")] = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    gate: Gate = False,
    json_: Json = False,
) -> None:
    """See REPORT_EXAMPLES."""
    from lftkit.support.progress import Progress
    from los_testbed.run.summary.summary import judged, say_outputs
    from pointing_analysis.read.run import Run
    from pointing_analysis.report.report import labels

    for option, value in (("--transient", transient), ("--from", start)):
        seconds(option, value)
    if not stop > start:
        raise InputError(f"--to must be after --from = {start:g} s, got {stop:g} s")
    for bag in bags:
        check_bag(bag)
    asked = requirements_in(requirements, STAGES)
    usual = bags[0] / "report" if len(bags) == 1 and bags[0].is_dir() else Path("report")
    outputs = report_files(output, usual, form, paper, export)

    def opener(bag: Path, limit: int) -> Run:
        return Run.open(bag, namespace=namespace, start=start, stop=stop, max_chunk=limit)

    with Progress("report"):
        result = judged(open_runs(bags, opener, max_chunk, optics), transient, asked)
        result.write_page(outputs)
    summaries, console, names = result.summaries, Screen(stderr=json_), labels(result.runs)
    show(console, names, summaries)
    for text in dict.fromkeys(text for texts in result.remarks for text in texts):
        whose = [name for name, texts in zip(names, result.remarks) if text in texts]
        say(console, text if len(whose) == len(names) else f"{', '.join(whose)}: {text}", "note")
    say_outputs(console, outputs)
    if json_:
        print_json({"report": str(outputs.path), "runs": [s.as_dict() for s in summaries]})
    leave_if_contradicted(text for s in summaries for text in s.contradictions)
    if gate:
        leave_by_gate(gate_of(summaries))


def show(console: Console, names: Sequence[str], summaries: Sequence[Summary]) -> None:
    """Print the metrics of some runs, one line each, and the problems of their bags."""
    from pointing_analysis.formatting.number_text import digits, percent
    from pointing_analysis.requirements.requirement import time_text
    from pointing_analysis.requirements.rows import css_class
    from pointing_analysis.requirements.summary import UNKNOWN

    absolute, relative = (
        " or ".join(dict.fromkeys(percent(getattr(s.probabilities, name), 10) for s in summaries))
        for name in ("ape", "rpe")
    )
    heads = (
        *text_columns("run", "verdict"),
        *numbers(f"APE max, {absolute} [arcsec]", f"RPE rms, {relative} [mas]", "left out", "lost"),
    )
    windows = ", ".join(dict.fromkeys(time_text(s.window) for s in summaries))
    rows = []
    for name, s in zip(names, summaries):
        ape, rpe = f"{digits(s.ape_max)}, {digits(s.ape_quantile)}", f"{digits(s.rpe_rms)}, {digits(s.rpe_quantile)}"
        verdict = Marked(s.overall, css_class(s.overall))
        rows.append((name, verdict, ape, rpe, f"{s.transient:g} s", s.lost_text()))
    table = TextTable.of(heads, rows, f"Pointing without start-up; windows of {windows}")
    console.print(on_screen(table, whole=("verdict",)))
    if not all(s.requirements_known for s in summaries):
        say(console, UNKNOWN, "note")
    for name, s in zip(names, summaries):
        for problem in s.problems:
            say(console, f"{name}: {problem}", "note")
