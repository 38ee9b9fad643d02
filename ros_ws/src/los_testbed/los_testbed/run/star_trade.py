"""Which guide stars suffice: magnitude and frame rate of the camera against RPE and MTF, from runs in one process."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from los_testbed.config import RunConfig
from los_testbed.factories import RunParts
from los_testbed.loop.simulate import LoopDivergedError, run_in_process
from pointing_analysis.files.structured_text import load_toml, read_text
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.guide_camera import check_exposure
from titop_plant.telescope.parameters import load_parameters


@dataclass(frozen=True)
class TradePoint:
    """A guide star at a frame rate.

    Parameters
    ----------
    magnitude : float
    rate : float
        Frames per second; the exposure is the time between them.
    config : RunConfig
        Of its run.
    """

    magnitude: float
    rate: float
    config: RunConfig

    @property
    def name(self) -> str:
        """Of its parameter file and bag."""
        return f"magnitude-{self.magnitude:g}-rate-{self.rate:g}"


def points(
    base: RunConfig, folder: Path, magnitudes: Sequence[float], rates: Sequence[float]
) -> tuple[TradePoint, ...]:
    """Write the parameter file of each star and rate into `folder`; a mistake in them is found here.

    Parameters
    ----------
    base : RunConfig
        Of all runs; its parameter file is kept but for kind, magnitude and exposure of the camera.
    folder : Path
        New.
    magnitudes, rates : sequence of float
        Rates in frames per second.

    Raises
    ------
    ValueError
        A camera that cannot be used, one line.
    """
    own: dict[str, Any] = {}
    if base.parameters:
        own = load_toml(read_text(Path(base.parameters)), base.parameters)
    beside = Path(base.parameters).parent if base.parameters else Path()
    if not all(rate > 0.0 for rate in rates):
        raise ValueError(f"rates must be positive, got {', '.join(f'{rate:g}' for rate in rates)} Hz")
    folder.mkdir(parents=True)
    found = []
    try:
        for rate in rates:
            for magnitude in magnitudes:
                point = TradePoint(magnitude, rate, base)
                file = folder / f"{point.name}.toml"
                file.write_text(parameter_text(own, beside, magnitude, 1.0 / rate), "utf-8")
                config = replace(base, parameters=str(file), camera_rate=rate)
                check_exposure(load_parameters(file), config.frame_ticks)
                found.append(replace(point, config=config))
    except ValueError:
        shutil.rmtree(folder)
        raise
    return tuple(found)


def parameter_text(own: Mapping[str, Any], folder: Path, magnitude: float, exposure: float) -> str:
    """A parameter file with another guide star: `own`, whose files lie in `folder`, with these values.

    Parameters
    ----------
    own : mapping
        Content of a user's file.
    folder : Path
    magnitude : float
    exposure : float
        [s].

    Examples
    --------
    >>> print(parameter_text({"sensors": {"washout": 0.2}}, Path(), 12.0, 0.02), end="")
    sensors = {washout = 0.2, camera = "image"}
    camera = {magnitude = 12.0, exposure = 0.02}
    """
    star = {"magnitude": float(magnitude), "exposure": round(exposure, 9)}
    sensors, camera = {**own.get("sensors", {}), "camera": "image"}, {**own.get("camera", {}), **star}
    changed = {**own, "sensors": sensors, "camera": camera}
    return "".join(f"{key} = {_toml(value, folder)}\n" for key, value in changed.items())


def _toml(value: Any, folder: Path) -> str:
    """A value as TOML, in one line; the name of a file in the folder becomes its whole path."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_toml(entry, folder)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(entry, folder) for entry in value) + "]"
    if isinstance(value, str) and value and (folder / value).is_file():
        return json.dumps(str((folder / value).resolve()))
    return json.dumps(value)


def measure(point: TradePoint, folder: Path, progress: Callable[[int], None] = lambda ticks: None) -> dict[str, Any]:
    """Run a point and evaluate it: a row of the table.

    Parameters
    ----------
    point : TradePoint
    folder : Path
        Of the bag.
    progress : callable
        Called with the ticks done.

    Returns
    -------
    dict
        ``magnitude``, ``rate_hz``, ``noise_mas`` (bound of a frame's noise), ``frames`` and ``without_angles``, the
        latter by reason, ``ape_arcsec``, ``rpe_mas`` and ``mtf_nyquist``, of which 99.7 % of the instants or exposures
        are better, ``strehl``; None for the values of a run that diverged, which ``failure`` says.
    """
    from pointing_analysis.read.run import Run
    from pointing_analysis.requirements.summary import summarise

    noise = float(RunParts(point.config).parameters["sensors"]["camera_noise"]) / RAD_PER_MAS
    row: dict[str, Any] = {"magnitude": point.magnitude, "rate_hz": point.rate, "noise_mas": round(noise, 4)}
    bag = folder / point.name
    try:
        counts, failure = run_in_process(point.config, bag, progress=progress)["plant"], ""
    except LoopDivergedError as error:
        counts, failure = {}, str(error)
    missing = {key.removeprefix("frames_"): int(n) for key, n in counts.items() if key.startswith("frames_")}
    row |= {"frames": int(counts.get("frames", 0)), "without_angles": missing, "failure": failure}
    if failure:
        return {**row, "ape_arcsec": None, "rpe_mas": None, "mtf_nyquist": None, "strehl": None}
    found = summarise(Run.open(bag)).as_dict()
    image = found.get("image", {})
    return {
        **row,
        "ape_arcsec": found["ape_arcsec"]["p997"],
        "rpe_mas": found["rpe_mas"]["windows_p997"],
        "mtf_nyquist": image.get("mtf_nyquist_p997"),
        "strehl": image.get("strehl_p997"),
    }


HEAD = (
    "| magnitude | frames/s | noise of a frame [mas] | frames without angles | APE [arcsec] | RPE(20 ms) [mas] "
    "| MTF | Strehl |"
)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Table of the rows; values that 99.7 % of instants or exposures of a run keep."""

    def shown(value: Any, digits: int = 3) -> str:
        return "-" if value is None else f"{value:.{digits}g}"

    lines = [HEAD, "|" + "---|" * 8]
    for row in rows:
        lost = sum(count for reason, count in row["without_angles"].items() if reason != "before_start")
        share = "diverged" if row["failure"] else f"{lost} of {row['frames']}"
        values = (shown(row[key]) for key in ("ape_arcsec", "rpe_mas", "mtf_nyquist", "strehl"))
        first = f"| {row['magnitude']:g} | {row['rate_hz']:g} | {row['noise_mas']:.3g} | {share} | "
        lines.append(first + " | ".join(values) + " |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """RPE, MTF and frames without angles over the magnitude, a line for each frame rate, as PNG or SVG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    names = ("RPE(20 ms), 99.7 % [mas]", "MTF of the motion at Nyquist, 99.7 %", "frames without angles [%]")
    for rate in sorted({row["rate_hz"] for row in rows}):
        mine = sorted((row for row in rows if row["rate_hz"] == rate), key=lambda row: float(row["magnitude"]))
        stars = [row["magnitude"] for row in mine]
        lost = [
            100.0 * sum(n for why, n in row["without_angles"].items() if why != "before_start") / max(row["frames"], 1)
            for row in mine
        ]
        series = ([row["rpe_mas"] for row in mine], [row["mtf_nyquist"] for row in mine], lost)
        for axis, values in zip(axes, series):
            kept = [(x, y) for x, y in zip(stars, values) if y is not None]
            axis.plot([x for x, _ in kept], [y for _, y in kept], marker="o", label=f"{rate:g} frames/s")
    for axis, name in zip(axes, names):
        axis.set_xlabel("magnitude of the guide star")
        axis.set_title(name, fontsize="medium")
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path)
