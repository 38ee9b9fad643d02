"""Command group ``los-testbed image``: pictures of what the telescope sees, and its jitter for other programs."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from los_testbed.cli.analysis.recordings import Bag, Bags, Los, OpticsFile, Rate, Unit, open_runs
from los_testbed.cli.options.options import (
    MAX_CHUNK_MB,
    Designs,
    ForceLawFile,
    Json,
    MaxChunk,
    NewFolder,
    ObserverFile,
    Telescope,
    Transient,
    option,
    with_files,
)
from los_testbed.cli.output import number, print_json, seconds
from los_testbed.run.summary.screen import Screen, say

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording

FIGURES_EXAMPLES = """Draw a star and a test target as the detector sees them, MTF, encircled energy and ellipticity.

One run or several side by side, as PNG and SVG. The exposures are of 20 ms; the one that is shown of a run is that of
1000 which three are worse than.

**Examples**

    los-testbed image figures bags/none bags/isolator bags/fsm bags/fsm+pma --output pictures

    los-testbed image figures measured.csv --los x,y --unit mas --optics my_telescope.toml --output pictures
"""

EXPORT_EXAMPLES = """Write the jitter of a line of sight for other programs.

`.fits` is a picture of the time that the line of sight spends at each place, sum 1, by default on a grid of 1 mas with
an odd number of places: the kernel with which poppy or Pyxel convolve an image. With `--path` it is the path itself as
a table. `.csv` is always the path. FITS needs `pip install 'los-testbed[image]'`.

**Examples**

    los-testbed image export bags/night --output kernel.fits --exposure 0.02        # all exposures, laid on each other

    los-testbed image export bags/night --output kernel.fits --exposure 0.02 --number 17 --step 0.5

    los-testbed image export bags/night --output path.csv

    los-testbed image export measured.csv --los x,y --unit mas --output path.fits --path
"""

TRADE_EXAMPLES = """Which guide stars suffice: magnitude and frame rate against APE, RPE and MTF.

The camera takes images (`camera = "image"`), with the exposure as long as the time between frames. One run in one
process for each star and rate, with the same seed. Writes trade.md, trade.json, trade.png and the bags.

**Examples**

    los-testbed image trade --duration 20

    los-testbed image trade --magnitudes 12,14,15.5 --rates 50,25 --scenario imbalance

    los-testbed image trade --parameters my_telescope.toml --designs designs/mine
"""

image_app = typer.Typer(
    help="What the telescope sees: pictures, and jitter for other programs.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


def _opener(los: str | None, unit: str | None, rate: float | None) -> Callable[[Path, int], Recording]:
    from pointing_analysis.read.los_source import open_los

    return lambda bag, limit: open_los(bag, los=los, unit=unit, rate=rate, max_chunk=limit)


@image_app.callback()
def image_group() -> None:
    """What the telescope sees: pictures, and jitter for other programs."""


@image_app.command(help=FIGURES_EXAMPLES)
def figures(
    bags: Bags,
    output: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    optics: OpticsFile = None,
    transient: Transient = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See FIGURES_EXAMPLES."""
    from pointing_analysis.files.atomic_output import check_output
    from pointing_analysis.image.optics import NONE_KNOWN, optics_of
    from pointing_analysis.report.image_pictures import draw_pictures
    from pointing_analysis.report.report import labels, view

    seconds("--transient", transient)
    check_output(output, "--output", folder=True)
    runs = open_runs(bags, _opener(los, unit, rate), max_chunk, optics)
    for run in runs:
        if optics_of(run) is None:
            raise ValueError(f"{run.path}: {NONE_KNOWN}")
    paths = draw_pictures([view(run, name, transient) for run, name in zip(runs, labels(runs))], output)
    console = Screen(stderr=json_)
    for path in paths:
        say(console, str(path))
    if json_:
        print_json({"pictures": [str(path) for path in paths]})


@image_app.command(help=EXPORT_EXAMPLES)
def export(
    bag: Bag,
    output: Annotated[Path, typer.Option(help="File to write: .fits or .csv.")],
    exposure: Annotated[float | None, typer.Option(help="Exposure [s]; default: the whole run is one.")] = None,
    number_: Annotated[
        int | None, typer.Option("--number", help="Which exposure, from 0; default: all, laid on each other.")
    ] = None,
    step: Annotated[float, typer.Option(help="Distance of the places of the kernel [mas].")] = 1.0,
    path: Annotated[bool, typer.Option("--path", help="Also in FITS the path, not the kernel.")] = False,
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    transient: Transient = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See EXPORT_EXAMPLES."""
    from pointing_analysis.files.atomic_output import check_output
    from pointing_analysis.image.export import write_kernel, write_path
    from pointing_analysis.indices.errors import performance_error

    seconds("--transient", transient)
    number("--step", step, 1e-6, 1e6, "mas")
    if output.suffix.lower() not in (".fits", ".csv"):
        raise ValueError(f"--output must end in .fits or .csv, got {output}")
    if number_ is not None and exposure is None:
        raise ValueError(f"--exposure must be given with --number, got none with {number_}")
    check_output(output, "--output")
    (run,) = open_runs([bag], _opener(los, unit, rate), max_chunk)
    series = performance_error(run, transient)
    if output.suffix.lower() == ".csv" or path:
        found = write_path(output, series, run.path.name, exposure, number_)
    else:
        found = write_kernel(output, series, run.path.name, exposure, number_, step)
    console = Screen(stderr=json_)
    say(console, f"{found.text}")
    say(console, str(output))
    if json_:
        print_json({"output": str(output), **found.values})


@image_app.command(help=TRADE_EXAMPLES)
def trade(
    magnitudes: Annotated[str, typer.Option(help="Of the guide stars, with commas.")] = "10,12,14,15,15.5",
    rates: Annotated[str, typer.Option(help="Frames per second, with commas.")] = "50,25",
    duration: Annotated[float | None, option("duration")] = None,
    scenario: Annotated[str | None, option("scenario")] = None,
    loop: Annotated[str | None, option("loop")] = None,
    seed: Annotated[int | None, option("seed")] = None,
    k_fsm: ObserverFile = None,
    k_pma: ForceLawFile = None,
    designs: Designs = None,
    parameters: Telescope = None,
    output: NewFolder = None,
    json_: Json = False,
) -> None:
    """See TRADE_EXAMPLES."""
    import json

    from lftkit.support.progress import Progress
    from los_testbed.bags.writer import check_new_bag
    from los_testbed.config import RunConfig
    from los_testbed.factories import check_controllers
    from los_testbed.run import star_trade
    from pointing_analysis.files.atomic_output import write_text

    given = {"duration": duration, "scenario": scenario, "loop": loop, "seed": seed}
    stated = {name: value for name, value in given.items() if value is not None}
    files = with_files(designs, k_fsm=k_fsm, k_pma=k_pma, parameters=parameters)
    base = RunConfig.from_mapping({"mode": "inprocess", **files, **stated})
    stars, each = _numbers("--magnitudes", magnitudes), _numbers("--rates", rates)
    folder = output or Path("bags") / f"{datetime.now():%Y%m%d-%H%M%S}-trade"
    check_new_bag(folder)
    check_controllers(base)
    points = star_trade.points(base, folder, stars, each)
    with Progress("trade") as bar:

        def told(done: int, what: str, ticks: int) -> None:
            bar.report(done * base.ticks + ticks, len(points) * base.ticks, what=f"{what} [ticks]")

        rows = [star_trade.measure(point, folder, partial(told, i, point.name)) for i, point in enumerate(points)]
    table, console = star_trade.markdown(rows), Screen(stderr=json_)
    say(console, table)
    write_text(folder / "trade.md", table)
    write_text(folder / "trade.json", json.dumps(rows, indent=1) + "\n")
    star_trade.draw(rows, folder / "trade.png")
    for name in ("trade.md", "trade.json", "trade.png"):
        say(console, str(folder / name))
    if json_:
        print_json({"trade": rows})


def _numbers(name: str, text: str) -> tuple[float, ...]:
    """Numbers with commas between them."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be numbers with commas between them, got {text!r}") from None
