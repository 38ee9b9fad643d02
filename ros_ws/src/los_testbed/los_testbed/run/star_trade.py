"""Trade of guide-star magnitude and frame rate against RPE and MTF, from runs in one process.

For each star and rate the controllers are designed, unless they are kept. A folder holds a folder for each of them,
with parameter file, designs, bag and finally ``row.json``; finished ones are not repeated.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.errors import InputError
from lftkit.support.atomic_output import check_output, write_text
from lftkit.support.job import Job
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import DESIGN_FILES, TELESCOPE_FILE
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import identity
from los_testbed.run.input_files import map_files
from los_testbed.run.loop.closed_loop import LoopDivergedError
from los_testbed.run.loop.simulate import run_in_process
from pointing_analysis.files.structured_text import load_json, load_toml, read_text
from pointing_analysis.formatting.number_text import digits, number
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.load import load_telescope

if TYPE_CHECKING:
    from lftkit.support.workers import Workers

SETTINGS, ROW = "settings.json", "row.json"
"""Files of a trade, and of a star in it: what was asked for; what came out."""
UNSTABLE = "the loop is unstable"
"""The ``failure`` of a point that is not run."""


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


@dataclass(frozen=True)
class Trade:
    """Guide stars and frame rates to be compared.

    Parameters
    ----------
    folder : Path
    points : tuple of TradePoint
    redesign : bool
        Whether controllers are designed for each of them.
    """

    folder: Path
    points: tuple[TradePoint, ...]
    redesign: bool

    @classmethod
    def begin(
        cls, base: RunConfig, folder: Path, magnitudes: Sequence[float], rates: Sequence[float], redesign: bool
    ) -> Trade:
        """Write the parameter file of each star and rate into `folder`; a mistake in them is found here.

        Parameters
        ----------
        base : RunConfig
            Of all runs; its parameter file is kept but for kind, magnitude and exposure of the camera.
        folder : Path
            New, or that of the same trade, which is resumed.
        magnitudes, rates : sequence of float
            Rates in frames per second.
        redesign : bool

        Raises
        ------
        ValueError
            A camera that cannot be used, a folder of something else; one line.
        """
        if not all(rate > 0.0 for rate in rates):
            raise InputError(f"rates must be positive, got {', '.join(f'{rate:g}' for rate in rates)} Hz")
        asked = _asked(base, magnitudes, rates, redesign)
        check_output(folder, "--output", folder=True)
        job = Job("trade", asked, folder / SETTINGS)
        continued = job.begin()
        try:
            return cls(folder, _points(base, folder, magnitudes, rates), redesign)
        except ValueError:
            if not continued:
                shutil.rmtree(folder, ignore_errors=True)
            raise

    def row(
        self, point: TradePoint, seconds: float, report: Callable[[str], None], workers: Workers | None = None
    ) -> dict[str, Any] | None:
        """Design, run and evaluate a point, or read what was found before: a row of the table.

        Parameters
        ----------
        point : TradePoint
        seconds : float
            Wall time that is left for the design [s].
        report : callable
            Receives a line for each step of a design.
        workers : Workers, optional
            Of the design.

        Returns
        -------
        dict or None
            As of :func:`measure`, with ``design`` ("kept", or how the descent ended) and ``not_met``, the requirements
            that the designs miss. None after the time limit: another call resumes.
        """
        folder, config = self.folder / point.name, point.config
        known, bag, design = folder / ROW, folder / "bag", {"design": "kept", "not_met": list[str]()}
        if known.exists():
            return dict(load_json(read_text(known), known))
        if seconds <= 0.0:
            return None
        if self.redesign:
            ended, not_met = _design(point, folder, seconds, report, workers)
            if ended == "out_of_time":
                return None
            design = {"design": ended, "not_met": not_met}
            k_fsm, k_pma = (str(folder / DESIGN_FILES[name]) for name in ("k_fsm", "k_pma"))
            config = replace(config, k_fsm=k_fsm, k_pma=k_pma)
        if bag.exists():  # of a run that was interrupted
            shutil.rmtree(bag)
        report(f"{point.name}: {config.duration:g} s of the loop")
        row = {**measure(replace(point, config=config), bag), **design}
        write_text(known, json.dumps(row, indent=1) + "\n")
        return row


def _asked(base: RunConfig, magnitudes: Sequence[float], rates: Sequence[float], redesign: bool) -> dict[str, Any]:
    """Dependencies of a trade."""
    return {
        "identity": identity(base, controllers=not redesign),
        "magnitudes": list(magnitudes),
        "rates": list(rates),
        "redesign": redesign,
        "run": base.to_plain(),
    }


def _points(
    base: RunConfig, folder: Path, magnitudes: Sequence[float], rates: Sequence[float]
) -> tuple[TradePoint, ...]:
    """The points with their parameter files; ValueError: a camera that cannot be used."""
    own: dict[str, Any] = {}
    if base.parameters:
        own = load_toml(read_text(Path(base.parameters)), base.parameters)
    beside = Path(base.parameters).parent if base.parameters else Path()
    found = []
    for rate in rates:
        for magnitude in magnitudes:
            point = TradePoint(magnitude, rate, base)
            file = folder / point.name / TELESCOPE_FILE
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(parameter_text(own, beside, magnitude, 1.0 / rate), "utf-8")
            config = replace(base, parameters=str(file), camera_rate=rate)
            load_telescope(file).check_exposure(config.frame_ticks)
            found.append(replace(point, config=config))
    return tuple(found)


def _design(
    point: TradePoint, folder: Path, seconds: float, report: Callable[[str], None], workers: Workers | None
) -> tuple[str, list[str]]:
    """Design both controllers into a folder, or resume: how that ended, and the requirements not met."""
    from lftkit import SampledSystem
    from los_design import redesign
    from los_design.synthesis.options import DesignOptions

    def report_step(text: str) -> None:
        report(f"{point.name}: {text}")

    telescope = load_telescope(str(point.config.parameters)).for_frames(point.config.frame_ticks)
    options = DesignOptions(short=True, wall_limit=seconds)
    found = redesign.design_all(telescope, folder, options, report=report_step, workers=workers)
    ended = SampledSystem.from_file(folder / DESIGN_FILES["k_fsm"]).provenance["status"]
    return str(ended), list(found.not_met)


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
    [sensors]
    washout = 0.2
    camera = "image"
    <BLANKLINE>
    [camera]
    magnitude = 12.0
    exposure = 0.02
    """
    import tomli_w

    star = {"magnitude": float(magnitude), "exposure": round(exposure, 9)}
    sensors, camera = {**own.get("sensors", {}), "camera": "image"}, {**own.get("camera", {}), **star}
    return tomli_w.dumps(map_files({**own, "sensors": sensors, "camera": camera}, _whole_path, folder))


def _whole_path(file: Path) -> str:
    """Name of a file that is the same from another folder."""
    return str(file.resolve())


def measure(point: TradePoint, bag: Path) -> dict[str, Any]:
    """Run a point and evaluate it.

    Parameters
    ----------
    point : TradePoint
    bag : Path
        New.

    Returns
    -------
    dict
        ``magnitude``, ``rate_hz``, ``noise_mas`` (of a frame, in the model), ``frames`` and ``without_angles``, the
        latter by reason, ``ape_arcsec``, ``rpe_mas``, ``mtf_nyquist`` and ``strehl``, which the required part of the
        instants or exposures keeps; None for the values of a run that diverged, or is left out because its loop is
        known to be unstable, which ``failure`` says.
    """
    from pointing_analysis.read.run import Run
    from pointing_analysis.requirements.summary import summarise

    parts = RunParts(point.config)
    noise = float(parts.telescope.camera_noise) / RAD_PER_MAS
    row: dict[str, Any] = {"magnitude": point.magnitude, "rate_hz": point.rate, "noise_mas": round(noise, 4)}
    counts: dict[str, str] = {}
    failure = UNSTABLE if parts.start.unstable else ""
    if not failure:
        try:
            counts = run_in_process(point.config, bag)["plant"]
        except LoopDivergedError as error:
            failure = str(error)
    missing = {key.removeprefix("frames_"): int(n) for key, n in counts.items() if key.startswith("frames_")}
    row |= {"frames": int(counts.get("frames", 0)), "without_angles": missing, "failure": failure}
    if failure:
        return {**row, "ape_arcsec": None, "rpe_mas": None, "mtf_nyquist": None, "strehl": None}
    found = summarise(Run.open(bag))
    return {
        **row,
        "ape_arcsec": number(found.ape_quantile),
        "rpe_mas": number(found.rpe_windows_quantile),
        "mtf_nyquist": None if found.image is None else number(found.image.mtf),
        "strehl": None if found.image is None else number(found.image.strehl),
    }


HEADS = (
    *texts("magnitude"),
    *numbers("frames/s", "noise of a frame [mas]", "frames without angles"),
    *numbers("APE [arcsec]", "RPE [mas]", "MTF", "Strehl"),
    *texts("design"),
)


def table(rows: Sequence[Mapping[str, Any]]) -> TextTable:
    """Table of the rows; quantiles at the required parts of the instants or exposures of a run."""
    cells = []
    for row in rows:
        lost = sum(count for reason, count in row["without_angles"].items() if reason != "before_start")
        failed = "unstable" if row["failure"] == UNSTABLE else "diverged"
        share = failed if row["failure"] else f"{lost} of {row['frames']}"
        values = (digits(row[key]) for key in ("ape_arcsec", "rpe_mas", "mtf_nyquist", "strehl"))
        missed = f"{len(row['not_met'])} not met" if row["not_met"] else "all met"
        design = row["design"] if row["design"] == "kept" else f"{row['design']}, {missed}"
        first = (f"{row['magnitude']:g}", f"{row['rate_hz']:g}", digits(row["noise_mas"]), share)
        cells.append((*first, *values, design))
    return TextTable.of(HEADS, cells)


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """RPE, MTF and frames without angles over the magnitude, a line for each frame rate, as PNG or SVG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    names = (
        "RPE of the required part of the windows [mas]",
        "MTF of the motion at Nyquist",
        "frames without angles [%]",
    )
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
