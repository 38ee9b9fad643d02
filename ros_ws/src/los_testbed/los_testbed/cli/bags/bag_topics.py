"""Command ``los-testbed bag topics``: topics of a bag that can be the line of sight."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pointing_analysis.command.options import Json
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import Screen, on_screen
from pointing_analysis.formatting.tables import TextTable, numbers, texts

TOPICS_EXAMPLES = """List topics of any bag that can be the line of sight, for `analyse --los`.

Attitudes have one line for each axis of the body that can be the line of sight; its angles are those about the mean.
"--unit" in place of a unit: state it.

**Example**

    los-testbed bag topics my_bag
"""


def topics(
    bag: Annotated[Path, typer.Argument(help="Bag of any program: folder or .mcap file.")],
    json_: Json = False,
) -> None:
    """See TOPICS_EXAMPLES."""
    from pointing_analysis.read.external_bag import candidates

    usable = candidates(bag)
    rows = [
        (
            c.name,
            c.schema.rpartition("/")[2],
            ", ".join(c.components),
            c.unit or "--unit",
            "header" if c.stamped else "log",
            str(c.messages),
            f"{c.rate:.6g}",
        )
        for c in usable
    ]
    heads = (*texts("--los", "type", "values", "unit", "time"), *numbers("count", "Hz"))
    table = TextTable.of(heads, rows, f"{bag.name}: what --los takes")
    shown = on_screen(table, whole=("--los",), box=None, padding=(0, 1))
    Screen(stderr=json_).print(
        shown if usable else f"{bag}: no message with two numbers or a quaternion", soft_wrap=not usable
    )
    if json_:
        content = [{**asdict(c), "los": c.name, "rate": c.rate if c.rate == c.rate else None} for c in usable]
        print_json({"bag": str(bag), "candidates": content})
