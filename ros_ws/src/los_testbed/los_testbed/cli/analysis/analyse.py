"""Command ``los-testbed analyse``: metrics and verdicts of recorded runs, and their report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
from pointing_analysis.command.screen import Screen
from titop_plant.interface import STAGES

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording

ANALYSE_EXAMPLES = """Evaluate recorded runs and write a report, HTML or PDF.

**Examples**

    los-testbed analyse bags/run-20260101-120000

    los-testbed analyse bags/isolator bags/fsm+pma --output comparison.html --json

    los-testbed analyse bags/night --format pdf --paper letter --export night    # and each figure, each table as a file

    los-testbed analyse my_bag --los /my/los --unit arcsec --rate 512     # another bag: topic, or topic.field

    los-testbed analyse measured.csv --los x,y --unit mas --requirements mission.toml --output measured.html

    los-testbed analyse measured.csv --los x,y --unit mas --optics my_telescope.toml    # MTF, Strehl ratio, EE80

    los-testbed analyse measured.mat --los los --unit urad                # CSV, Parquet, .mat, HDF5, .npy, .npz

`los-testbed bag topics BAG` lists the topics of a bag that can be a line of sight.
"""


def analyse(
    bags: Bags,
    output: Annotated[
        Path | None,
        typer.Option(help="Report to write, .html or .pdf. Default: report.html in the folder of a single bag."),
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
    """See ANALYSE_EXAMPLES."""
    from lftkit.support.progress import Progress
    from los_testbed.run.summary.summary import print_summary, summarise_runs
    from pointing_analysis.read.los_source import open_los

    seconds("--transient", transient)
    require_different(bags)
    usual = bags[0] / "report" if len(bags) == 1 and bags[0].is_dir() else None
    outputs = report_files(output, usual, form, paper, export)
    asked = requirements_in(requirements, STAGES)

    def opener(bag: Path, limit: int) -> Recording:
        return open_los(bag, los=los, unit=unit, rate=rate, time=time, max_chunk=limit)

    with Progress("analysis"):
        runs = open_runs(bags, opener, max_chunk, optics)
        for run in runs:
            check_exposures(run, asked or (), transient)
        summaries = summarise_runs(runs, outputs, transient, requirements=asked)
    print_summary(Screen(stderr=json_), summaries)
    if json_:
        print_json(summaries.runs[0] if len(bags) == 1 else {"runs": list(summaries.runs)})
    leave_if_contradicted(text for summary in summaries.summaries for text in summary.contradictions)
    if gate:
        leave_by_gate(gate_of(summaries.summaries))
