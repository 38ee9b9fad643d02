"""Command ``los-testbed bag export``: signals of a bag for MATLAB, NumPy and tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from lftkit.support.progress import Progress
from pointing_analysis.command.options import MAX_CHUNK_MB, From, Json, MaxChunk, To
from pointing_analysis.command.output import chunk_limit, print_json
from pointing_analysis.command.recordings import check_bag
from pointing_analysis.command.screen import Screen, say

EXPORT_EXAMPLES = """Write the signals of a bag for MATLAB, NumPy or as a table, with names and units.

The suffix of --output is the format: .mat (a structure for each topic), .npz, .csv or .parquet (one table, a row for
each stamp, empty where a topic has no sample).

**Examples**

    los-testbed bag export bags/run-20260101-120000 --output run.mat

    los-testbed bag export bags/night --topics truth/los,fsm/command --from 10 --to 20 --output part.csv
"""


def export(
    bag: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    output: Annotated[Path, typer.Option(metavar="FILE", help="New file: .mat, .npz, .csv or .parquet.")],
    topics: Annotated[str, typer.Option(metavar="NAME,...", help="Topics without namespace; default: all.")] = "",
    mat_version: Annotated[
        str, typer.Option(metavar="5|7.3", help="Of a .mat file; default: 5, for variables above 2 GB 7.3.")
    ] = "",
    start: From = 0.0,
    stop: To = math.inf,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See EXPORT_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from pointing_analysis.read.run import Run
    from pointing_analysis.report.signal_files import check_format, signals_of, write_signals

    if not 0.0 <= start < stop:
        raise InputError(f"--from and --to must rise from 0, got {start:g} and {stop:g}")
    check_bag(bag)
    check_format(output, mat_version)
    check_output(output, "--output", new=True)
    with Progress("export"):
        run = Run.open(bag, start=start, stop=stop, max_chunk=chunk_limit(max_chunk))
        names = [name.strip().strip("/") for name in topics.split(",") if name.strip()]
        signals = signals_of(run, names)
        write_signals(signals, output, mat_version)
    samples = {signal.name: len(signal.stamp) for signal in signals}
    say(Screen(stderr=json_), f"{counted(len(samples), 'topic')}, {counted(sum(samples.values()), 'sample')}: {output}")
    if json_:
        print_json({"output": str(output), "samples": samples})
