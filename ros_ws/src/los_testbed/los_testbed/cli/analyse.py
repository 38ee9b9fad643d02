"""Command ``los-testbed analyse``: metrics and verdicts of recorded runs, and their report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from los_testbed.cli.output import MAX_CHUNK_MB, Json, MaxChunk, chunk_limit, print_json, seconds

ANALYSE_EXAMPLES = """Evaluate recorded runs and write an HTML report.

**Examples**

    los-testbed analyse bags/run-20260101-120000

    los-testbed analyse bags/isolator bags/fsm+pma --report comparison.html --json
"""


def analyse(
    bags: Annotated[list[Path], typer.Argument(help="Bags: folders or .mcap files.")],
    report: Annotated[Path | None, typer.Option(help="HTML file to write.")] = None,
    transient: Annotated[float | None, typer.Option(help="Seconds to leave out at the start.")] = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See ANALYSE_EXAMPLES."""
    from los_testbed.run.summary import print_summary, summarise_runs

    seconds("--transient", transient)
    target = report
    if target is None and len(bags) == 1 and bags[0].is_dir():
        target = bags[0] / "report.html"
    summaries = summarise_runs(bags, target, transient, chunk_limit(max_chunk))
    print_summary(Console(stderr=json_), summaries)
    if json_:
        print_json(summaries.runs[0] if len(bags) == 1 else {"runs": list(summaries.runs)})
