"""Command group ``los-testbed image``: image quality, and jitter for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.errors import InputError
from pointing_analysis.command.options import MAX_CHUNK_MB, Json, MaxChunk, Transient
from pointing_analysis.command.output import number, print_json, seconds
from pointing_analysis.command.recordings import Bag, Bags, Los, OpticsFile, Rate, Unit, open_runs
from pointing_analysis.command.screen import Screen, say

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording

FIGURES_EXAMPLES = """Draw a star and a test target as the detector sees them, MTF, encircled energy and ellipticity.

One run or several side by side, as PNG, SVG and PDF. The exposures are the windows of the strictest requirement on the
relative error, or 20 ms; the exposure shown is the worst of the required part of them, or of 99.7 %.

**Examples**

    los-testbed image figures bags/none bags/isolator bags/fsm bags/fsm+pma --output pictures

    los-testbed image figures measured.csv --los x,y --unit mas --optics my_telescope.toml --output pictures
"""

EXPORT_EXAMPLES = """Write the jitter of a line of sight for other programs.

`.fits` is a histogram of the line of sight with sum 1, by default on a grid of 1 mas with an odd number of cells: the
kernel with which poppy or Pyxel convolve an image. With `--path` it is the time series as a table. `.csv` is always
the time series. FITS needs `pip install 'los-testbed[image]'`.

**Examples**

    los-testbed image export bags/night --output kernel.fits --exposure 0.02        # all exposures, stacked

    los-testbed image export bags/night --output kernel.fits --exposure 0.02 --number 17 --step 0.5

    los-testbed image export bags/night --output path.csv

    los-testbed image export measured.csv --los x,y --unit mas --output path.fits --path
"""

image_app = typer.Typer(
    help="Image quality: pictures, and jitter for other programs.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


def _opener(los: str | None, unit: str | None, rate: float | None) -> Callable[[Path, int], Recording]:
    from pointing_analysis.read.los_source import open_los

    return lambda bag, limit: open_los(bag, los=los, unit=unit, rate=rate, max_chunk=limit)


@image_app.callback()
def image_group() -> None:
    """Image quality: pictures, and jitter for other programs."""


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
    from lftkit.support.atomic_output import check_output
    from pointing_analysis.image.optics import NONE_KNOWN, optics_of
    from pointing_analysis.report.image_figures import draw_pictures
    from pointing_analysis.report.report import labels, view

    seconds("--transient", transient)
    check_output(output, "--output", folder=True)
    runs = open_runs(bags, _opener(los, unit, rate), max_chunk, optics)
    for run in runs:
        if optics_of(run) is None:
            raise InputError(f"{run.path}: {NONE_KNOWN}")
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
        int | None, typer.Option("--number", help="Index of the exposure, from 0; default: all, stacked.")
    ] = None,
    step: Annotated[float, typer.Option(help="Grid spacing of the kernel [mas].")] = 1.0,
    path: Annotated[bool, typer.Option("--path", help="Write the time series to FITS, not the kernel.")] = False,
    los: Los = None,
    unit: Unit = None,
    rate: Rate = None,
    transient: Transient = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See EXPORT_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from pointing_analysis.image.export import write_kernel, write_path
    from pointing_analysis.indices.errors import performance_error

    seconds("--transient", transient)
    number("--step", step, 1e-6, 1e6, "mas")
    if number_ is not None and exposure is None:
        raise InputError(f"--exposure must be given with --number, got none with {number_}")
    check_output(output, "--output", suffixes=(".fits", ".csv"))
    (run,) = open_runs([bag], _opener(los, unit, rate), max_chunk)
    series = performance_error(run, transient)
    if output.suffix.lower() == ".csv" or path:
        written = write_path(output, series, run.path.name, exposure, number_)
    else:
        written = write_kernel(output, series, run.path.name, exposure, number_, step)
    console = Screen(stderr=json_)
    say(console, f"{written.text}")
    say(console, str(output))
    if json_:
        print_json({"output": str(output), **written.values})
