"""The report of one or several bags: a self-contained HTML page, which opens from disk and prints well, or a PDF.

It depends on the bags alone: the same bags give the same file byte for byte.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.indices.errors import on_camera, performance_error
from pointing_analysis.indices.motion import motion_of
from pointing_analysis.indices.telescope_values import telescope_value
from pointing_analysis.read.mapped_arrays import GrowingArray, by_parts, common_rows, parts
from pointing_analysis.read.recording import Recording
from pointing_analysis.report import figures, image_figures
from pointing_analysis.report.content import ReportContent, content_of
from pointing_analysis.report.cumulative_figure import cumulative
from pointing_analysis.report.distribution_figure import distributions
from pointing_analysis.report.exposure_figure import over_exposure
from pointing_analysis.report.figures import Picture, RunView
from pointing_analysis.report.html_page import page
from pointing_analysis.report.image_figures import ImageView, image_views
from pointing_analysis.report.loop_figures import nyquist, sensitivity
from pointing_analysis.report.model_results import NO_MODEL, ModelResults
from pointing_analysis.report.moving_tones import moving_pictures
from pointing_analysis.report.outputs import ReportOutputs
from pointing_analysis.report.paper import Paper
from pointing_analysis.report.spectrum_figure import density
from pointing_analysis.requirements.conditions import WHEEL_SPEEDS
from pointing_analysis.requirements.exposure import probabilities_of
from pointing_analysis.requirements.summary import Summary, exposure_of_run, requirements_of, scenario_of, summarise_all
from pointing_analysis.requirements.verdict import Requirement
from pointing_analysis.spectra import spectra
from pointing_analysis.spectra.sidebands import FoundLine

#: topic -> largest value that its actuator can do, a name of `telescope_value`
AUTHORITY = {"fsm/command": "fsm_authority", "pma/command": "pma_authority"}


def labels(runs: Sequence[Recording]) -> tuple[str, ...]:
    """Short names of the runs, unique: the loop stage; with scenario, seed or file name where that is not enough."""
    for make in (
        lambda r: r.title,
        lambda r: f"{r.title}, {scenario_of(r)}",
        lambda r: f"{r.title}, {scenario_of(r)}, seed {r.parameters.get('seed', '')}",
        lambda r: f"{r.title}, {r.path.name}",
    ):
        names = [make(r) for r in runs]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{name} ({i + 1})" for i, name in enumerate(names))


def tones_of(run: Recording) -> FloatArray:
    """Disturbance lines named in the bag [rad/s]: tones and speeds of the wheels; none where something moves."""
    frequencies: list[float] = []
    for key in () if motion_of(run) else ("tones_rad_s", WHEEL_SPEEDS):
        value = run.parameters.get(key, [])
        value = value if isinstance(value, list) else [value]
        frequencies += [abs(float(x)) for x in value if is_number(x)]  # a wheel's line has no sign
    return np.asarray(np.unique(np.array(frequencies, dtype=float)))


def view(
    run: Recording,
    label: str,
    transient: float | None = None,
    found: Sequence[FoundLine] = (),
    window: float | None = None,
    part: float | None = None,
) -> RunView:
    """Everything the pictures need from one run; `found` are lines of its spectrum.

    The window, and the part of its exposures, are by default those of its own requirements.
    """
    window = exposure_of_run(run) if window is None else window
    part = probabilities_of(requirements_of(run) or ()).image if part is None else part
    series = performance_error(run, transient)
    spectrum, without = None, ""
    try:
        spectrum = spectra.psd(series.values, series.dt)
    except InputError as error:
        without = str(error)
    named = spectra.lines(series.values, series.dt, tones_of(run), window)
    more = spectra.found_lines(found, named, series.duration, window, series.dt)
    named, within_noise = spectra.above_noise(named, series.values, series.dt)
    tones = sorted((*named, *more), key=lambda line: -line.rpe)
    return RunView(label, run, series, spectrum, tuple(tones), window, within_noise, without, part)


def intervals_us(run: Recording) -> FloatArray:
    """Intervals between publications of every tick [us]; empty where the bag only repeats the stamps."""
    name = "isolator/accel" if on_camera(run) else "truth/los"
    if name not in run:
        return np.empty(0)
    topic = run[name]
    stamp, sent = topic.stamp, topic.published
    if len(sent) < 3 or all((sent[p] - stamp[p] == sent[0] - stamp[0]).all() for p in parts(len(sent))):
        return np.empty(0)
    return by_parts(lambda later, earlier: (later - earlier) / 1e3, sent[1:], sent[:-1])


def latency_us(run: Recording) -> FloatArray:
    """Time from the publication of a tick's sensors to that of its mirror command [us]; empty where unknown."""
    if "fsm/command" not in run or "isolator/accel" not in run:
        return np.empty(0)
    sensor, command = run["isolator/accel"], run["fsm/command"]
    delays, differs = GrowingArray(None), False
    for i, j in common_rows(sensor.stamp, command.stamp):
        delay = (command.published[j] - sensor.published[i]) / 1e3
        differs |= bool(np.any(delay != 0))
        delays.append(delay)
    return delays.array() if differs else np.empty(0)


@dataclass(frozen=True)
class Drawn:
    """Data of the pictures of a page.

    Parameters
    ----------
    views : of all runs
    requirements : of all runs
    model : results of a model of them
    """

    views: Sequence[RunView]
    requirements: Sequence[Requirement] = ()
    model: ModelResults = NO_MODEL

    @property
    def names(self) -> list[str]:
        """Labels of the runs."""
        return [v.label for v in self.views]

    def times(self, of_run: Callable[[Recording], FloatArray]) -> list[tuple[str, FloatArray]]:
        """Times of each run [us] with its label."""
        return [(v.label, of_run(v.run)) for v in self.views]

    @cached_property
    def images(self) -> tuple[ImageView, ...]:
        """Exposures of the runs whose optics are known."""
        return self._images[0]

    @property
    def without_images(self) -> tuple[str, ...]:
        """Sentences on runs whose optics are known and that have no exposures."""
        return self._images[1]

    @cached_property
    def _images(self) -> tuple[tuple[ImageView, ...], tuple[str, ...]]:
        return image_views(self.views)

    @property
    def has_spectrum(self) -> bool:
        """Whether any run is long enough for one."""
        return any(v.spectrum for v in self.views)


PICTURES: tuple[Callable[[Drawn], Picture | str | Sequence[Picture | str] | None], ...] = (
    lambda d: figures.time_history(d.views),
    lambda d: figures.trajectory(d.views, d.requirements),
    lambda d: d.without_images,
    lambda d: image_figures.stars(d.images),
    lambda d: image_figures.targets(d.images),
    lambda d: image_figures.transfers(d.images),
    lambda d: image_figures.energies(d.images),
    lambda d: image_figures.ellipticities(d.images),
    lambda d: density(d.views) if d.has_spectrum else None,
    lambda d: cumulative(d.views) if d.has_spectrum else None,
    lambda d: moving_pictures(d.views, d.requirements),
    lambda d: figures.by_line(d.views, d.model.lines),
    lambda d: distributions(d.views, d.requirements),
    lambda d: over_exposure(d.views, d.requirements),
    lambda d: figures.commands(d.views, {topic: telescope_value(d.views[-1].run, a) for topic, a in AUTHORITY.items()}),
    lambda d: nyquist(d.names, d.model.loops),
    lambda d: sensitivity(d.names, d.model.loops),
    lambda d: figures.timing(d.times(intervals_us), "Tick intervals", "interval of ticks [µs]"),
    lambda d: figures.timing(d.times(latency_us), "Sensor to command", "latency sensor to command [µs]"),
)
"""Pictures of the page in reading order, sentences in the place of those that cannot be made; None: none is due."""


def pictures(shown: Drawn) -> tuple[list[Picture], list[str]]:
    """All pictures of the page, in reading order, and sentences on those that cannot be made."""
    made = [draw(shown) for draw in PICTURES]
    several = [one for part in made for one in ([part] if isinstance(part, (Picture, str)) else part or ())]
    return [one for one in several if isinstance(one, Picture)], [one for one in several if isinstance(one, str)]


def report_content(
    runs: Sequence[Recording],
    *,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
    model: ModelResults = NO_MODEL,
    remarks: Sequence[Sequence[str]] = (),
    summaries: Sequence[Summary] = (),
) -> ReportContent:
    """The content of a report, for a page, a PDF and files of figures and tables.

    Parameters
    ----------
    runs : one or several opened bags, for instance the four loop stages
    transient : seconds to drop at the start of each
    requirements : by default of each run those that it holds
    model : results of a model of the telescope, to compare with the measured ones; default: none
    remarks : for each run sentences to print beside its verdict; by default none at all
    summaries : for each run what `summarise` made of it with the same arguments; by default made here

    Raises
    ------
    BagError
        A run has no truth topic or only transient.
    ValueError
        No run was given, or results of a model for another number of runs.
    """
    if not runs:
        raise InputError("runs must hold at least one run, got none")
    model.check(len(runs))
    if remarks and len(remarks) != len(runs):
        raise InputError(f"remarks must be one list for each of the {len(runs)} runs, got {len(remarks)}")
    names = labels(runs)
    summaries = summaries or summarise_all(runs, transient=transient, requirements=requirements)
    views = [
        view(run, name, transient, s.found, s.window, s.probabilities.image)
        for run, name, s in zip(runs, names, summaries)
    ]
    drawn, missing = pictures(Drawn(views, [v.requirement for s in summaries for v in s.verdicts], model))
    untimed = [v.label for v in views if v.run.kind == "bag" and not intervals_us(v.run).size]
    missing += [f"No timing histogram for {name}: the messages carry simulated times only." for name in untimed]
    return content_of(views, summaries, drawn, missing, model, remarks)


def render(runs: Sequence[Recording], **options: Any) -> str:
    """The report as HTML text; `options` are those of `report_content`, which raises the same."""
    return page(report_content(runs, **options))


def write_report(
    runs: Sequence[Recording], path: str | os.PathLike[str], *, paper: Paper = "a4", **options: Any
) -> Path:
    """Write the report of one or several runs; nothing is left half-written.

    Parameters
    ----------
    runs : see `report_content`
    path : HTML file to write, or a PDF if it ends in ``.pdf``; an existing one is replaced
    paper : of a PDF, ``a4`` or ``letter``
    **options : of `report_content`

    Returns
    -------
    The path of the file.

    Raises
    ------
    ValueError
        As `report_content`; a path that cannot be written; a PDF without its extra.
    """
    outputs = ReportOutputs(Path(path), paper)
    outputs.check()
    outputs.write(report_content(runs, **options))
    return Path(path)
