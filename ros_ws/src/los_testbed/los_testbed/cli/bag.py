"""Command group ``los-testbed bag``: repair damaged recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

REPAIR_EXAMPLES = """Make a readable bag from one whose recorder was killed or whose file is damaged.

**Example**

    los-testbed bag repair bags/run-20260101-120000
"""

bag_app = typer.Typer(help="Repair recorded runs.", no_args_is_help=True, rich_markup_mode="markdown")


@bag_app.callback()
def bag_group() -> None:
    """Repair recorded runs."""


@bag_app.command(help=REPAIR_EXAMPLES)
def repair(
    source: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    output: Annotated[Path | None, typer.Option(help="New bag; default: the old name with -repaired.")] = None,
) -> None:
    """See REPAIR_EXAMPLES."""
    from los_testbed.bags.repair import repair_bag

    target = output or source.with_name(f"{source.stem if source.is_file() else source.name}-repaired")
    found = repair_bag(source, target)
    console = Console()
    console.print(f"{found.messages} messages in {found.chunks} chunks", soft_wrap=True)
    for offset, reason in found.damaged:
        console.print(f"chunk at byte {offset}: {reason}; its messages are lost", soft_wrap=True)
    if found.cut_at is not None:
        console.print(f"the file is cut at byte {found.cut_at}: up to a second of data is missing", soft_wrap=True)
    console.print(f"bag     {target}", soft_wrap=True)
