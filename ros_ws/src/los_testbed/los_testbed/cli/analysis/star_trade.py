"""Command ``los-testbed image trade``: guide star and frame rate against pointing, with redesigned controllers."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from los_testbed.cli.command_group import HelpAll
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import Designs, Json, NewFolder, chosen, with_settings
from los_testbed.cli.output import number, numbers, print_json
from los_testbed.config.run_settings import SIMULATED
from los_testbed.run.summary.screen import Screen, on_screen, say, warn

if TYPE_CHECKING:
    from los_testbed.run.star_trade import Trade

TRADE_EXAMPLES = """Trade guide-star magnitude and frame rate against APE, RPE and MTF.

The camera takes images (`camera = "image"`), with the exposure as long as the time between frames. For each star and
rate both controllers are designed, as `design all --effort short` does it, and one run is made in one process with the
same seed. `--keep-controllers`, or controller files, skip the designs. Writes trade.md, trade.json, trade.png,
and a folder with parameter file, designs and bag for each. Run the same command again to resume after an interrupt or
the time limit; the exit code is 1 after the time limit.

**Examples**

    los-testbed image trade --duration 20 --output trade

    los-testbed image trade --magnitudes 12,14,15.5 --rates 50,25 --scenario imbalance --time-limit 1800 --output trade

    los-testbed image trade --keep-controllers

    los-testbed image trade --parameters my_telescope.toml --designs designs/mine
"""

UNFINISHED = 1
"""Exit code where the wall limit ended the trade."""


@with_cluster
@with_settings([*(name for name in SIMULATED if name != "camera_rate"), "seed"])
def trade(
    *,
    magnitudes: Annotated[
        str, typer.Option(help="Magnitudes of the guide stars, separated by commas.")
    ] = "10,12,14,15,15.5",
    rates: Annotated[str, typer.Option(help="Frame rates [Hz], separated by commas.")] = "50,25",
    given: dict[str, Any],
    keep: Annotated[
        bool, typer.Option("--keep-controllers", help="Use the stored controllers, without design.")
    ] = False,
    designs: Designs = None,
    time_limit: Annotated[float, typer.Option(help="Wall-clock limit [s]; run again to resume.")] = 7200.0,
    cluster: Cluster,
    output: NewFolder = None,
    json_: Json = False,
    help_all: HelpAll = False,
) -> None:
    """See TRADE_EXAMPLES."""
    import json

    from lftkit.support.atomic_output import write_text
    from los_testbed.config.run_config import RunConfig
    from los_testbed.config.run_settings import with_stage
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.run import star_trade

    number("--time-limit", time_limit, 1e-3, 1e7, "s")
    base = RunConfig.from_mapping(with_stage({"mode": "inprocess", **chosen(given, designs)}))
    stars, each = numbers("--magnitudes", magnitudes), numbers("--rates", rates)
    folder = output or Path("bags") / f"{datetime.now():%Y%m%d-%H%M%S}-trade"
    warnings, redesign = RunParts(base).check(), not (keep or base.k_fsm or base.k_pma)
    warn(() if redesign else warnings)
    found = star_trade.Trade.begin(base, folder, stars, each, redesign)
    with resume_hint("stars and rounds so far", folder):
        rows, finished = _rows(found, cluster, time_limit)
    console = Screen(stderr=json_)
    if rows:
        table = star_trade.table(rows)
        console.print(on_screen(table))
        write_text(folder / "trade.md", table.markdown() + "\n")
        write_text(folder / "trade.json", json.dumps(rows, indent=1) + "\n")
        star_trade.draw(rows, folder / "trade.png")
        for name in ("trade.md", "trade.json", "trade.png"):
            say(console, str(folder / name))
    if json_:
        print_json({"trade": rows, "finished": finished})
    if not finished:
        say(console, f"ended by the time limit after {len(rows)} of {len(found.points)}: run again to resume", "note")
        raise typer.Exit(UNFINISHED)


def _rows(trade: Trade, cluster: Cluster, time_limit: float) -> tuple[list[dict[str, Any]], bool]:
    """Rows of the table, and whether all are there."""
    from lftkit.support.progress import Progress

    end = time.monotonic() + time_limit
    rows: list[dict[str, Any]] = []
    with cluster.workers() as pool, Progress("trade [stars]") as bar:
        for done, point in enumerate(trade.points):
            bar.report(done, len(trade.points), what=point.name)
            row = trade.row(point, end - time.monotonic(), bar.print, pool)
            if row is None:
                return rows, False
            rows.append(row)
    return rows, True
