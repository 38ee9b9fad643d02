"""Command ``pointing-analysis``: verdicts on recorded lines of sight, without the testbed and its models."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.errors import InputError
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import MAX_CHUNK_MB, Gate, Json, MaxChunk, Transient
from pointing_analysis.command.output import gate_of, leave_by_gate, leave_if_contradicted, print_json, seconds
from pointing_analysis.command.recordings import (
    Bags,
    Los,
    OpticsFile,
    Rate,
    Requirements,
    Unit,
    check_exposures,
    open_runs,
    require_different,
    requirements_in,
)
from pointing_analysis.command.report_files import Export, Format, PaperSize, report_files
from pointing_analysis.command.screen import Screen, on_screen, printable, say

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording
    from pointing_analysis.requirements.summary import Summary

app = typer.Typer(add_completion=False, no_args_is_help=True, rich_markup_mode="markdown")


@app.callback()
def _group() -> None:
    """Verdicts on recorded lines of sight: tables and bags of any program."""


@app.command("report", help="As `analyse`, and write a report: report.html here, or --output.")
@app.command()
def analyse(
    context: typer.Context,
    recordings: Bags,
    output: Annotated[
        Path | None, typer.Option(help="Report to write, .html or .pdf; default of `analyse`: none.")
    ] = None,
    form: Format = None,
    paper: PaperSize = None,
    export: Export = None,
    transient: Transient = None,
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    time: Annotated[
        str | None, typer.Option(help="Its time stamps: header or log in a bag, column name in a table.")
    ] = None,
    requirements: Requirements = None,
    optics: OpticsFile = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    gate: Gate = False,
    json_: Json = False,
) -> None:
    """Evaluate recordings: verdicts, metrics, and a report where one is asked for.

    **Example**

        pointing-analysis analyse measured.csv --los x,y --unit mas --requirements mission.toml --output report.html
    """
    from lftkit.support.progress import Progress
    from pointing_analysis.read.los_source import open_los
    from pointing_analysis.report.report import report_content
    from pointing_analysis.requirements.summary import summarise_all

    seconds("--transient", transient)
    require_different(recordings)
    usual = Path("report") if context.info_name == "report" else None
    outputs = report_files(output, usual, form, paper, export)
    asked = requirements_in(requirements)

    def opener(path: Path, limit: int) -> Recording:
        return open_los(path, los=los, unit=unit, rate=rate, time=time, max_chunk=limit)

    with Progress("analysis"):
        runs = open_runs(recordings, opener, max_chunk, optics)
        for run in runs:
            check_exposures(run, asked or (), transient)
        summaries = summarise_all(runs, transient=transient, requirements=asked)
        if outputs:
            outputs.write(report_content(runs, transient=transient, requirements=asked, summaries=summaries))
    console = Screen(stderr=json_)
    _show(console, summaries)
    for written in filter(None, (outputs.path, outputs.export)):
        say(console, f"report  {written}")
    if json_:
        objects = [summary.as_dict() for summary in summaries]
        print_json(objects[0] if len(objects) == 1 else {"runs": objects})
    leave_if_contradicted(text for summary in summaries for text in summary.contradictions)
    if gate:
        leave_by_gate(gate_of(summaries))


def _show(console: Screen, summaries: Sequence[Summary]) -> None:
    """Requirements with their verdicts, metrics and notes of each recording."""
    from pointing_analysis.requirements.rows import BRIEF, requirement_table
    from pointing_analysis.requirements.summary import UNKNOWN

    for summary in summaries:
        start = f"first {summary.transient:g} s (start-up) excluded" if summary.transient else "nothing excluded"
        table = requirement_table(summary.rows).only(*BRIEF)
        console.print(on_screen(replace(table, title=f"{summary.path.name}, {summary.duration:g} s, {start}")))
        for figure in summary.figures:
            say(console, f"{figure.name}: {figure.text}")
        for text in (*summary.problems, *(() if summary.requirements_known else (UNKNOWN,))):
            say(console, text, "note")


def main() -> None:
    """Entry point: a mistake in the input is one line and exit code 2, a failure of the system 1."""
    try:
        app()
    except (InputError, OSError) as error:
        code = int(getattr(error, "code", ExitCode.USER_ERROR if isinstance(error, InputError) else ExitCode.FAILED))
        sys.stderr.write(f"pointing-analysis: {printable(str(error))}\n")
        sys.exit(code)


__all__ = ["app", "main"]
