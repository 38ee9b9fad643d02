"""Command group ``los-testbed bag``: repair damaged recordings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from los_testbed.cli.options.options import MAX_CHUNK_MB, Json, MaxChunk
from los_testbed.cli.output import chunk_limit, leave_if_contradicted, print_json
from los_testbed.run.summary.screen import Screen, say

REPAIR_EXAMPLES = """Make a readable bag from one whose recorder was killed or whose file is damaged.

It copies everything that a checksum proves right, says of each topic what is missing and where, and marks the new bag:
every later verdict about it repeats this.

**Example**

    los-testbed bag repair bags/run-20260101-120000
"""

bag_app = typer.Typer(
    help="Describe, check, sign and repair recorded runs.", no_args_is_help=True, rich_markup_mode="markdown"
)


@bag_app.callback()
def bag_group() -> None:
    """Describe, check, sign and repair recorded runs."""


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
        raise ValueError(f"--output must be given for {source}, which has no name")
    target = output or whole.with_name(f"{whole.stem if source.is_file() else whole.name}-repaired")
    with Progress("repair"):
        found = repair_bag(source, target, limit)
    console = Screen(stderr=json_)
    say(console, f"{found.messages} messages of {len(found.copied)} topics copied")
    for sentence in found.sentences():
        say(console, sentence)
    say(console, f"bag     {target}")
    if json_:
        lost = {loss.topic: {"messages": loss.missing, "places": [str(s) for s in loss.spans]} for loss in found.losses}
        content = {"bag": str(target), "messages": found.messages, "copied": found.copied, "lost": lost}
        content |= {"finished": found.finished, "problems": list(found.problems)}
        print_json({**content, "contradictions": list(found.contradictions)})
    leave_if_contradicted(found.contradictions)
