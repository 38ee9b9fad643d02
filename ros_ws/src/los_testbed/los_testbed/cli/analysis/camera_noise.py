"""Command ``los-testbed image noise``: the noise of a guide camera over the magnitude, from many frames."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.errors import InputError
from los_testbed.cli.options.options import Json, TelescopeFile
from los_testbed.cli.output import number, numbers, print_json
from los_testbed.run.summary.screen import Screen, on_screen, say
from pointing_analysis.formatting.number_text import digits, percent
from pointing_analysis.formatting.tables import Heading, TextTable

if TYPE_CHECKING:
    from pointing_analysis.image.noise_curve import NoisePoint
    from pointing_analysis.image.star_camera import StarCamera

NOISE_EXAMPLES = """Measure the noise of the guide camera over the magnitude of its star.

Simulates many frames of a star at rest at random positions within a pixel, and locates the star in each. The file holds
the curve and its detector; a parameter file refers to it by `camera.noise_curve`, and the camera of the loop then has
the noise of its star's magnitude. Stars that are not detected in half of the frames are omitted.

**Examples**

    los-testbed image noise --output noise.json

    los-testbed image noise --parameters my_telescope.toml --magnitudes 10,12,14 --frames 2000 --output noise.json

    los-testbed image noise --exposures 0.02,0.04 --seed 2 --output noise.json      # a curve for each exposure
"""

MAGNITUDES = ",".join(f"{0.5 * k:g}" for k in range(14, 33))
HEADS = tuple(
    Heading(head, number=True)
    for head in ("exposure [ms]", "magnitude", "noise [mas]", "Cramer-Rao bound [mas]", "frames without angles")
)


def noise(
    output: Annotated[Path, typer.Option(help="File to write, JSON.")],
    magnitudes: Annotated[str, typer.Option(help="Magnitudes of the guide stars, separated by commas.")] = MAGNITUDES,
    exposures: Annotated[
        str | None, typer.Option(help="Exposures [s], separated by commas; default: the telescope's.")
    ] = None,
    frames: Annotated[int, typer.Option(help="Frames per star.")] = 10_000,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    time_limit: Annotated[float, typer.Option(help="Wall-clock limit [s]; no curve is written after it.")] = 3600.0,
    parameters: TelescopeFile = None,
    json_: Json = False,
) -> None:
    """See NOISE_EXAMPLES."""
    from lftkit.support.atomic_output import check_output, write_text
    from los_design.synthesis.provenance import commit
    from pointing_analysis.image.noise_curve import NoiseCurve, to_text

    number("--frames", frames, 10, 10_000_000)
    number("--seed", seed, 0, 2**31 - 1)
    number("--time-limit", time_limit, 1e-3, 1e7, "s")
    check_output(output, "--output")
    chosen = None if exposures is None else numbers("--exposures", exposures)
    cameras = _cameras(parameters, sorted(set(numbers("--magnitudes", magnitudes))), chosen)
    measured = _measured(cameras, frames, seed, time_limit)
    curves = [NoiseCurve.of(row[0], points) for row, points in zip(cameras, measured)]
    options = ("" if parameters is None else f" --parameters {parameters.name}") + (
        "" if exposures is None else f" --exposures {exposures}"
    )
    provenance = {
        "command": f"los-testbed image noise --magnitudes {magnitudes}{options} --frames {frames} --seed {seed}",
        "commit": commit(),
        "seed": seed,
        "frames": frames,
    }
    write_text(output, to_text(curves, provenance))
    console = Screen(stderr=json_)
    console.print(on_screen(_table(cameras, measured)))
    say(console, str(output))
    if json_:
        print_json({"output": str(output), **provenance, "curves": [curve.to_mapping() for curve in curves]})


def _cameras(
    parameters: Path | None, magnitudes: list[float], exposures: tuple[float, ...] | None
) -> list[list[StarCamera]]:
    """A row for each exposure, with a camera for each magnitude.

    Raises
    ------
    ValueError
        A file, a magnitude or an exposure that cannot be used; one magnitude alone.
    """
    from titop_plant.telescope.guide_camera import star_camera
    from titop_plant.telescope.load import REFERENCE, load_telescope

    if len(magnitudes) < 2:
        raise InputError(f"--magnitudes must be two or more, got {len(magnitudes)}")
    file = parameters or REFERENCE
    known = load_telescope(file)
    optics, camera = known.image_optics, known.camera
    return [
        [star_camera(optics, replace(camera, magnitude=m, exposure=t), str(file)) for m in magnitudes]
        for t in exposures or (camera.exposure,)
    ]


def _measured(cameras: list[list[StarCamera]], frames: int, seed: int, time_limit: float) -> list[list[NoisePoint]]:
    from lftkit.support.progress import Progress
    from lftkit.support.threads import one_thread
    from pointing_analysis.image.noise_curve import measure

    end, done, total = time.monotonic() + time_limit, 0, sum(map(len, cameras))
    found: list[list[NoisePoint]] = []
    with one_thread(), Progress("noise [stars]", equal=True) as bar:
        for row in cameras:
            found.append([])
            for camera in row:
                if time.monotonic() > end:
                    raise InputError(f"--time-limit must be enough for {total} stars, got {time_limit:g} s for {done}")
                found[-1].append(measure(camera, frames, seed))
                done += 1
                bar.report(done, total)
    return found


def _table(cameras: list[list[StarCamera]], measured: list[list[NoisePoint]]) -> TextTable:
    from pointing_analysis.units import RAD_PER_MAS

    cells = [
        (
            f"{1e3 * camera.camera.exposure:g}",
            f"{p.magnitude:g}",
            digits(p.noise / RAD_PER_MAS),
            digits(p.bound / RAD_PER_MAS),
            percent(p.without),
        )
        for row, points in zip(cameras, measured)
        for camera, p in zip(row, points)
    ]
    return TextTable.of(HEADS, cells)
