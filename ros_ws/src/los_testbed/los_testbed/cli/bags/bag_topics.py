"""Command ``los-testbed bag topics``: what a bag has that could be a line of sight."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from los_testbed.cli.options.options import Json
from los_testbed.cli.output import print_json
from los_testbed.run.summary.screen import Screen, printable

TOPICS_EXAMPLES = """List what could be the line of sight in a bag of any program, for `analyse --los`.

**Example**

    los-testbed bag topics my_bag
"""


def topics(
    bag: Annotated[Path, typer.Argument(help="Bag of any program: folder or .mcap file.")],
    json_: Json = False,
) -> None:
    """See TOPICS_EXAMPLES."""
    from pointing_analysis.read.external_bag import candidates

    found = candidates(bag)
    table = Table(
        title=printable(f"{bag.name}: what could be the line of sight"), title_justify="left", box=None, padding=(0, 1)
    )
    table.add_column("--los", no_wrap=True, overflow="fold")  # to be copied
    for head in ("type", "values", "time", "count", "Hz"):
        table.add_column(head, justify="right" if head in ("count", "Hz") else "left", overflow="fold")
    for c in found:
        when = "header" if c.stamped else "log"
        table.add_row(
            c.name, c.schema.rpartition("/")[2], ", ".join(c.components), when, str(c.messages), f"{c.rate:.6g}"
        )
    Screen(stderr=json_).print(table if found else f"{bag}: no message with two numbers", soft_wrap=not found)
    if json_:
        rows = [{**asdict(c), "los": c.name, "rate": c.rate if c.rate == c.rate else None} for c in found]
        print_json({"bag": str(bag), "candidates": rows})
