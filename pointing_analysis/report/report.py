"""One self-contained HTML page from one or several bags: opens from disk, needs no network, prints well.

The page depends on the bags alone: the same bags give the same page byte for byte.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from lftkit.support.atomic_output import check_output, write_text
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.motion import motion_of
from pointing_analysis.indices.telescope_values import telescope_value
from pointing_analysis.read.mapped_arrays import GrowingArray, by_parts, common_rows, parts
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.series import LOS
from pointing_analysis.report import figures, image_figures
from pointing_analysis.report.cards import run_card
from pointing_analysis.report.cumulative_figure import cumulative
from pointing_analysis.report.distribution_figure import distributions
from pointing_analysis.report.exposure_figure import over_exposure
from pointing_analysis.report.figures import Picture, RunView, windows_text
from pointing_analysis.report.image_figures import ImageView, image_views
from pointing_analysis.report.inline_svg import inline
from pointing_analysis.report.loop_figures import nyquist, sensitivity
from pointing_analysis.report.model_results import NO_MODEL, ModelResults
from pointing_analysis.report.moving_tones import moving_pictures
from pointing_analysis.requirements.rows import ABSENT, ALL_RUNS, RequirementRow, digits, rows_of
from pointing_analysis.requirements.summary import UNKNOWN, Summary, exposure_of_run, scenario_of, summarise_all
from pointing_analysis.requirements.verdict import Requirement
from pointing_analysis.spectra import spectra
from pointing_analysis.spectra.line_search import FALSE_LINES
from pointing_analysis.spectra.prediction import Prediction, ToneComparison
from pointing_analysis.spectra.sidebands import FoundLine

TEMPLATE = Path(__file__).with_name("report.html.j2")
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
    """Disturbance lines named in the bag [rad/s], ``tones_rad_s`` and the wheel speeds; none where something moves."""
    found: list[float] = []
    for key in () if motion_of(run) else ("tones_rad_s", "wheel_speed"):
        value = run.parameters.get(key, [])
        value = value if isinstance(value, list) else [value]
        found += [float(x) for x in value if is_number(x)]
    return np.asarray(np.unique(np.array(found, dtype=float)))


def view(
    run: Recording,
    label: str,
    transient: float | None = None,
    found: Sequence[FoundLine] = (),
    window: float | None = None,
) -> RunView:
    """Everything the pictures need from one run; `found` are lines of its spectrum, the window by default its own."""
    window = exposure_of_run(run) if window is None else window
    series = performance_error(run, transient)
    try:
        spectrum = spectra.psd(series.values, series.dt)
    except ValueError:
        spectrum = None  # too short or too many gaps: the page says so in place of the curve
    named = spectra.lines(series.values, series.dt, tones_of(run), window)
    more = spectra.found_lines(found, named, series.duration, window, series.dt)
    tones = sorted((*named, *more), key=lambda line: -line.rpe)
    return RunView(label, run, series, spectrum, tuple(tones), window)


def _authority(runs: Sequence[Recording]) -> dict[str, float]:
    """Largest values of the command topics, of the last run."""
    return {topic: telescope_value(runs[-1], name) for topic, name in AUTHORITY.items()}


def intervals_us(run: Recording) -> FloatArray:
    """Intervals between the publications of the truth topic [us]; empty where the bag only repeats the stamps."""
    stamp, sent = run["truth/los"].stamp, run["truth/los"].published
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
    """What the pictures of a page are made of.

    Parameters
    ----------
    views : of all runs
    requirements : of all runs
    model : what a model says of them
    """

    views: Sequence[RunView]
    requirements: Sequence[Requirement] = ()
    model: ModelResults = NO_MODEL

    @property
    def names(self) -> list[str]:
        """Labels of the runs."""
        return [v.label for v in self.views]

    @cached_property
    def images(self) -> tuple[ImageView, ...]:
        """Exposures of the runs whose optics are known."""
        return image_views(self.views)

    @property
    def has_spectrum(self) -> bool:
        """Whether any run is long enough for one."""
        return any(v.spectrum for v in self.views)


def _intervals(d: Drawn) -> Picture | None:
    times = [(v.label, intervals_us(v.run)) for v in d.views]
    return figures.timing(times, "Tick intervals", "interval of ticks [µs]")


def _latency(d: Drawn) -> Picture | None:
    times = [(v.label, latency_us(v.run)) for v in d.views]
    return figures.timing(times, "Sensor to command", "latency sensor to command [µs]")


PICTURES: tuple[Callable[[Drawn], Picture | Sequence[Picture | None] | None], ...] = (
    lambda d: figures.time_history(d.views),
    lambda d: figures.trajectory(d.views, d.requirements),
    lambda d: image_figures.stars(d.images),
    lambda d: image_figures.targets(d.images),
    lambda d: image_figures.transfers(d.images),
    lambda d: image_figures.energies(d.images),
    lambda d: image_figures.ellipticities(d.images),
    lambda d: figures.density(d.views) if d.has_spectrum else None,
    lambda d: cumulative(d.views) if d.has_spectrum else None,
    lambda d: moving_pictures(d.views, d.requirements),
    lambda d: figures.by_line(d.views, d.model.lines),
    lambda d: distributions(d.views, d.requirements),
    lambda d: over_exposure(d.views, d.requirements),
    lambda d: figures.commands(d.views, _authority([v.run for v in d.views])),
    lambda d: nyquist(d.names, d.model.loops),
    lambda d: sensitivity(d.names, d.model.loops),
    _intervals,
    _latency,
)
"""Pictures of the page in reading order; None where the runs have nothing to show in one."""


def pictures(shown: Drawn) -> list[Picture]:
    """All pictures of the page, in reading order."""
    made: list[Picture] = []
    for draw in PICTURES:
        found = draw(shown)
        several = [found] if found is None or isinstance(found, Picture) else found
        made += [p for p in several if p is not None]
    return made


def _rows(names: Sequence[str], summaries: Sequence[Summary]) -> list[RequirementRow]:
    """Rows of all runs; requirements over several runs are judged on all of them and stand once, at the end."""
    several = len(names) > 1
    joint = {str(v.requirement): v for s in summaries for v in s.verdicts if several and v.requirement.across_runs}
    own = [row for name, s in zip(names, summaries) for row in rows_of(s.verdicts, s.beside, name)]
    return [row for row in own if row.text not in joint] + rows_of(list(joint.values()), (), ALL_RUNS)


def _ratio(tone: ToneComparison) -> str:
    if tone.in_noise or not tone.predicted:
        return "in noise" if tone.in_noise else "–"
    return f"{tone.ratio:.3f}" + ("" if tone.uncertainty < 5e-4 else f" ± {tone.uncertainty:.3f}")


def _prediction(label: str, found: Prediction) -> dict[str, Any]:
    """Table of predicted and measured tones, strongest first, ready to print."""
    rows = [
        {
            "omega": f"{tone.omega:.2f}" + (f" ({tone.merged} lines)" if tone.merged > 1 else ""),
            "hertz": f"{tone.omega / (2 * math.pi):.3f}",
            "predicted": digits(tone.predicted / RAD_PER_MAS),
            "measured": digits(tone.measured / RAD_PER_MAS),
            "ratio": _ratio(tone),
        }
        for tone in sorted(found.tones, key=lambda tone: -tone.predicted)
    ]
    part = f"{digits(found.start, 6)} s to {digits(found.stop, 6)} s"
    return {"label": label, "rows": rows, "part": part, "note": found.note}


def render(
    runs: Sequence[Recording],
    *,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
    model: ModelResults = NO_MODEL,
    remarks: Sequence[Sequence[str]] = (),
    summaries: Sequence[Summary] = (),
) -> str:
    """The report as HTML text.

    Parameters
    ----------
    runs : one or several opened bags, for instance the four loop stages
    transient : seconds to drop at the start of each
    requirements : by default of each run those that it holds
    model : what a model of the telescope says of the runs, beside what was measured; by default nothing
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
        raise ValueError("runs must hold at least one run, got none")
    model.check(len(runs))
    if remarks and len(remarks) != len(runs):
        raise ValueError(f"remarks must be one list for each of the {len(runs)} runs, got {len(remarks)}")
    names = labels(runs)
    summaries = summaries or summarise_all(runs, transient=transient, requirements=requirements)
    views = [view(run, name, transient, s.found, s.window) for run, name, s in zip(runs, names, summaries)]
    drawn = pictures(Drawn(views, [v.requirement for s in summaries for v in s.verdicts], model))
    rows = _rows(names, summaries)
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        title=" / ".join(names),
        bags=list(dict.fromkeys(run.path.name for run in runs)),
        names=names,
        several=len(runs) > 1,
        exposure=windows_text(views),
        rows=rows,
        beyond="Time beyond limit" if any(row.lower for row in rows) else "Time above limit",
        unknown=all(not s.requirements_known for s in summaries) and UNKNOWN,
        cards=[run_card(v, s, n, r) for v, s, n, r in zip(views, summaries, names, remarks or [()] * len(runs))],
        pictures=[
            {
                "id": p.name,
                "title": p.title,
                "svg": inline(p),
            }
            for p in drawn
        ],
        sensors=[(n, _sensors(run)) for n, run in zip(names, runs)],
        sources=[(n, [one.shown for one in found]) for n, found in zip(names, model.sources) if found],
        predictions=[_prediction(n, p) for n, p in zip(names, model.predictions) if p is not None],
        false_lines=f"{FALSE_LINES:g}",
        no_spectrum=[v.label for v in views if v.spectrum is None],
        untimed=[v.label for v in views if v.run.kind == "bag" and not intervals_us(v.run).size],
        **_sources(runs),
    )


def _sources(runs: Sequence[Recording]) -> dict[str, str]:
    """Words for where the runs come from."""
    ours = all(isinstance(run, Run) for run in runs)
    bags = all(run.kind == "bag" for run in runs)
    what = "bag" if bags else "file"
    name = what if len(runs) == 1 else f"{what}s"
    said = [str(run.parameters.get("line_of_sight", run.shown(LOS))) for run in runs]
    other = f"Line of sight: {'; '.join(dict.fromkeys(said))}."
    return {
        "source": "Line of sight of the controlled telescope, from the true line of sight recorded in the bag."
        if ours
        else other,
        "from": name.capitalize(),
        "alone": what,
    }


def _sensors(run: Recording) -> list[dict[str, str]]:
    """Table of the sensors of a run, ready to print."""
    rows = []
    for sensor in sensors_of(run):
        found = run[sensor.topic].integrity
        rows.append(
            {
                "topic": sensor.topic,
                "unit": ", ".join(sensor.unit.split(",")),
                "rate": digits(sensor.rate),
                "noise": ", ".join(digits(value) for value in dict.fromkeys(sensor.noise)),
                "samples": str(len(run[sensor.topic]) - found.nan),
                "dropped": str(found.nan) if sensor.held else ABSENT,
            }
        )
    return rows


def write_report(
    runs: Sequence[Recording],
    path: str | os.PathLike[str],
    *,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
    model: ModelResults = NO_MODEL,
    remarks: Sequence[Sequence[str]] = (),
    summaries: Sequence[Summary] = (),
) -> Path:
    """Write the report of one or several runs; nothing is left half-written.

    Parameters
    ----------
    runs, transient, requirements, model, remarks, summaries : see `render`
    path : HTML file to write; an existing one is replaced

    Returns
    -------
    The path of the file.
    """
    target = Path(path)
    check_output(target, "the report")
    page = render(
        runs, transient=transient, requirements=requirements, model=model, remarks=remarks, summaries=summaries
    )
    write_text(target, page)
    return target
