"""Jitter for other programs: a kernel that images are convolved with, or the path itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from pointing_analysis.arrays import FloatArray
from pointing_analysis.image.fits_files import write_picture, write_table
from pointing_analysis.image.motion_blur import centred, exposures, missing, sizes
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS

LARGEST = 4001
"""Places of a kernel along an axis, at most."""
FINE = 8
"""Parts of a step that the line of sight passes between two points that are counted."""
MOST_POINTS = 200_000_000


@dataclass(frozen=True)
class Exported:
    """Summary of an exported file.

    Parameters
    ----------
    text : one line
    values : for JSON
    """

    text: str
    values: dict[str, Any]


def chosen_paths(series: ErrorSeries, exposure: float | None, number: int | None) -> FloatArray:
    """Complete exposures of a series, one of them, or the whole of it as one: (m, N + 1, 2) [rad].

    Raises
    ------
    ValueError
        The exposure is longer than the run or no whole number of samples; its number is not there; samples are missing.
    """
    if exposure is None:
        paths = series.values[None]
    else:
        paths = exposures(series.values, series.dt, exposure)
        if number is not None:
            if not 0 <= number < len(paths):
                raise InputError(f"number of the exposure must be from 0 to {len(paths) - 1}, got {number}")
            paths = paths[number : number + 1]
    whole = paths[~missing(paths)]
    if not len(whole) or paths.shape[1] < 2:
        raise InputError("exposures must be complete, got missing samples in each")
    return np.asarray(whole)


def kernel(paths: FloatArray, step: float) -> FloatArray:
    """Share of the time at each place, exposures stacked at their means: (k, k), k odd, sum 1.

    The path is cut into pieces shorter than a part of the step; each is divided among the four places about it so that
    its centre of gravity stays where it is. The mean of the path is in the middle. Rows are along y.

    Parameters
    ----------
    paths : (m, N + 1, 2) [rad]
    step : distance of the places [rad]

    Raises
    ------
    ValueError
        The motion is too large for the step.
    """
    half = math.ceil(float(sizes(paths).max()) / step) + 1
    if 2 * half + 1 > LARGEST:
        raise InputError(f"step must give at most {LARGEST} cells across the motion, got {2 * half + 1}")
    size = 2 * half + 1
    total = np.zeros(size * size)
    for x in centred(paths) / step:
        way = np.diff(x, axis=0)
        pieces = max(math.ceil(float(np.hypot(way[:, 0], way[:, 1]).max()) * FINE), 1)
        if pieces * len(way) > MOST_POINTS:
            raise InputError(f"step must give at most {MOST_POINTS} points on a path, got {pieces * len(way)}")
        for k in range(pieces):
            place = x[:-1] + way * ((k + 0.5) / pieces) + half
            low = np.floor(place).astype(int)
            part = place - low
            for i in (0, 1):
                for j in (0, 1):
                    share = (part[:, 0] if i else 1 - part[:, 0]) * (part[:, 1] if j else 1 - part[:, 1])
                    index = (low[:, 1] + j) * size + low[:, 0] + i
                    total += np.bincount(index, share, minlength=size * size)
    return np.asarray((total / total.sum()).reshape(size, size))


def write_kernel(
    path: Path, series: ErrorSeries, name: str, exposure: float | None, number: int | None, step_mas: float
) -> Exported:
    """Write the kernel as a FITS picture; raises as `chosen_paths` and `kernel`."""
    paths = chosen_paths(series, exposure, number)
    found = kernel(paths, step_mas * RAD_PER_MAS)
    length = (paths.shape[1] - 1) * series.dt
    header = {
        "PIXELSCL": (step_mas * RAD_PER_MAS / RAD_PER_ARCSEC, "[arcsec] grid spacing"),
        "EXPTIME": (length, "[s] exposure"),
        "NEXPOS": (len(paths), "exposures stacked at their means"),
        "DELTAT": (series.dt, "[s] between samples, the path is linear between them"),
        "ORIGFILE": (name[-60:], "recording"),
    }
    write_picture(path, found, header)
    text = f"{len(paths)} exposures of {length:g} s on {len(found)}^2 cells of {step_mas:g} mas"
    return Exported(text, {"exposures": len(paths), "places": len(found), "step_mas": step_mas})


def write_path(path: Path, series: ErrorSeries, name: str, exposure: float | None, number: int | None) -> Exported:
    """Write the path as CSV or as a FITS table: time [s], x and y [arcsec]; of the whole run or of one exposure.

    Raises
    ------
    ValueError
        As `chosen_paths`; an exposure without its number.
    """
    start = series.start
    values = np.asarray(series.values)
    if exposure is not None:
        if number is None:
            raise InputError("--number must be given with --exposure for a path, got none")
        values = chosen_paths(series, exposure, number)[0]
        start += number * exposure
    time = np.asarray(start + series.dt * np.arange(len(values)), dtype=float)
    arcsec = values / RAD_PER_ARCSEC
    if path.suffix.lower() == ".csv":
        about = f"# line of sight of {name}, actual minus target, linear between samples; NaN: missing\n"
        rows = "".join(f"{t:.9g},{x:.9g},{y:.9g}\n" for t, (x, y) in zip(time.tolist(), arcsec.tolist()))
        write_text(path, f"{about}time_s,x_arcsec,y_arcsec\n{rows}")
    else:
        columns = {"time": (time, "s"), "x": (arcsec[:, 0], "arcsec"), "y": (arcsec[:, 1], "arcsec")}
        write_table(path, columns, {"ORIGFILE": (name[-60:], "recording"), "DELTAT": (series.dt, "[s]")})
    return Exported(f"{len(values)} samples of {series.dt:g} s", {"samples": len(values), "dt_s": series.dt})
