"""Command ``pointing-analysis``: verdicts on recorded lines of sight, without the testbed and its models.

``los-testbed analyse`` has the same options, more formats, and what is known of a loop that it has run.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from lftkit.errors import InputError

EXIT_CODES = {False: 7, None: 8}
"""Of requirements that are not met, and of those that are not demonstrated, with ``--gate``; 5: the bag contradicts its
own digests."""

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

Files = Annotated[list[Path], typer.Argument(help="Recordings: bag (folder or .mcap), CSV, Parquet, .mat, .npz ...")]
Los = Annotated[str | None, typer.Option(help="Line of sight: topic of a bag, two columns of a table (X,Y).")]
Unit = Annotated[str | None, typer.Option(help="Unit of the samples: rad, mrad, urad, arcsec, mas ...")]
Rate = Annotated[float | None, typer.Option(help="Sampling rate [Hz], where the samples have no times.")]
Time = Annotated[str | None, typer.Option(help="Time stamps: header or log in a bag, column of a table.")]
Transient = Annotated[float | None, typer.Option(help="Start-up that is left out [s].")]
Requirements = Annotated[Path | None, typer.Option(help="TOML or YAML file of requirements.")]
Output = Annotated[Path | None, typer.Option(help="Report to write, .html.")]
Gate = Annotated[bool, typer.Option("--gate", help="Exit code 7 if a requirement is not met, 8 if not demonstrated.")]


@app.command()
def analyse(
    files: Files,
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    time: Time = None,
    requirements: Requirements = None,
    transient: Transient = None,
    output: Output = None,
    gate: Gate = False,
    json_: Annotated[bool, typer.Option("--json", help="Last line of the output is one JSON object.")] = False,
) -> None:
    """Print verdicts and metrics of recordings, and write a report where one is asked for."""
    from pointing_analysis.read.los_source import open_los
    from pointing_analysis.report.report import write_report
    from pointing_analysis.requirements.requirement import load
    from pointing_analysis.requirements.rows import BRIEF, requirement_table
    from pointing_analysis.requirements.status import MET
    from pointing_analysis.requirements.summary import summarise

    asked = None if requirements is None else load(requirements)
    runs = [open_los(file, los=los, unit=unit, rate=rate, time=time) for file in files]
    summaries = [summarise(run, transient=transient, requirements=asked) for run in runs]
    for run, summary in zip(runs, summaries):
        typer.echo(f"{run.title}, {summary.duration:g} s, first {summary.transient:g} s excluded")
        typer.echo(requirement_table(summary.rows).only(*BRIEF).markdown())
        for figure in summary.figures:
            typer.echo(f"{figure.name}: {figure.text}")
        for text in (*summary.problems, *(() if summary.requirements_known else ("no requirements are known",))):
            typer.echo(f"note: {text}")
    if output is not None:
        typer.echo(f"report: {write_report(runs, output, transient=transient, requirements=asked)}")
    if json_:
        typer.echo(json.dumps({"runs": [summary.as_dict() for summary in summaries]}))
    if any(summary.contradictions for summary in summaries):
        raise typer.Exit(5)
    met = [MET.get(verdict.status) for summary in summaries for verdict in summary.verdicts] or [None]
    for wanted, code in EXIT_CODES.items():
        if gate and wanted in met:
            raise typer.Exit(code)


@app.command()
def report(
    files: Files,
    output: Annotated[Path, typer.Option(help="Report to write, .html.")],
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    time: Time = None,
    requirements: Requirements = None,
    transient: Transient = None,
) -> None:
    """Write the report alone."""
    from pointing_analysis.read.los_source import open_los
    from pointing_analysis.report.report import write_report
    from pointing_analysis.requirements.requirement import load

    runs = [open_los(file, los=los, unit=unit, rate=rate, time=time) for file in files]
    asked = None if requirements is None else load(requirements)
    typer.echo(f"report: {write_report(runs, output, transient=transient, requirements=asked)}")


def main() -> None:
    """Run the command; a mistake in the input is one line and exit code 2."""
    try:
        app()
    except (InputError, FileNotFoundError) as error:
        sys.stderr.write(f"pointing-analysis: {error}\n")
        sys.exit(2)


__all__ = ["app", "main"]
