"""Command group ``los-testbed bag``: repair damaged recordings."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated

import typer

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.command.options import MAX_CHUNK_MB, From, Json, MaxChunk, To
from pointing_analysis.command.output import chunk_limit, leave_if_contradicted, print_json
from pointing_analysis.command.screen import Screen, say

REPAIR_EXAMPLES = """Make a readable bag from one whose recorder was killed or whose file is damaged.

Copies all records with a valid checksum, and counts separately those without one where the file was truncated. Reports
what is missing in each topic and where, and marks the new bag: every later verdict about it repeats this.

**Example**

    los-testbed bag repair bags/run-20260101-120000
"""

TRACE_EXAMPLES = """Write the ticks of a real-time run as a trace for ui.perfetto.dev or chrome://tracing.

One track has the ticks, and one each node: from the deadline to the plant's last sample, from there to the estimate,
from there to the commands, by the send times of the messages. Ticks whose commands were not sent within their period
are marked. 60 s take about 30 MB.

**Example**

    los-testbed bag trace bags/run-20260101-120000 --from 10 --to 12
"""

bag_app = typer.Typer(
    help="Describe, check, export, sign, repair and trace recorded runs.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@bag_app.callback()
def bag_group() -> None:
    """Describe, check, export, sign, repair and trace recorded runs."""


@bag_app.command(help=REPAIR_EXAMPLES)
def repair(
    source: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    output: Annotated[Path | None, typer.Option(help="New bag; default: the old name with -repaired.")] = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See REPAIR_EXAMPLES."""
    from lftkit.support.progress import Progress
    from los_testbed.bags.repair import repair_bag

    limit = chunk_limit(max_chunk)
    whole = Path(os.path.abspath(source))  # a name also for "." and ".."
    if output is None and not whole.name:
        raise InputError(f"--output must be given for {source}, which has no name")
    target = output or whole.with_name(f"{whole.stem if source.is_file() else whole.name}-repaired")
    with Progress("repair"):
        repaired = repair_bag(source, target, limit)
    console = Screen(stderr=json_)
    say(console, f"{counted(repaired.messages, 'message')} of {counted(len(repaired.copied), 'topic')} copied")
    for sentence in repaired.sentences():
        say(console, sentence)
    say(console, f"bag     {target}")
    if json_:
        lost = {
            loss.topic: {"messages": loss.missing, "places": [str(s) for s in loss.spans]} for loss in repaired.losses
        }
        content = {"bag": str(target), "messages": repaired.messages, "copied": repaired.copied, "lost": lost}
        content |= {"finished": repaired.finished, "problems": list(repaired.problems)}
        print_json({**content, "contradictions": list(repaired.contradictions)})
    leave_if_contradicted(repaired.contradictions)


@bag_app.command(help=TRACE_EXAMPLES)
def trace(
    source: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    output: Annotated[Path | None, typer.Option(help="New file; default: trace.json in the current folder.")] = None,
    start: From = 0.0,
    stop: To = math.inf,
    json_: Json = False,
) -> None:
    """See TRACE_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from los_testbed.bags.trace import write_trace
    from pointing_analysis.read.run import Run

    if not 0.0 <= start < stop:
        raise InputError(f"--from and --to must be increasing and not negative, got {start:g} and {stop:g}")
    target = output or Path("trace.json")
    check_output(target, "--output", new=True)
    ticks, late = write_trace(Run.open(source), target, start, stop)
    say(Screen(stderr=json_), f"{ticks} ticks, {late} without commands within their period: {target}")
    if json_:
        print_json({"output": str(target), "ticks": ticks, "late": late})
