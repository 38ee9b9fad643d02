"""Content of a report in any format: verdict, figures, tables, notes.

The page, the PDF and the files of tables are made from the same :class:`ReportContent`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import Marked, TextTable, texts
from pointing_analysis.indices.errors import on_camera
from pointing_analysis.indices.motion import motion_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.series import LOS
from pointing_analysis.report.figures import Picture, RunView, windows_text
from pointing_analysis.report.model_results import ModelResults
from pointing_analysis.report.run_tables import (
    LINES_SHOWN,
    line_table,
    metric_table,
    prediction_table,
    provenance_table,
    sensor_table,
)
from pointing_analysis.report.source_share import source_table
from pointing_analysis.requirements.requirement import time_text
from pointing_analysis.requirements.rows import (
    ALL_RUNS,
    RequirementRow,
    css_class,
    definition_table,
    requirement_table,
    rows_of,
    verdict_table,
)
from pointing_analysis.requirements.summary import UNKNOWN, Summary
from pointing_analysis.spectra.line_search import SETTINGS as LINE_SEARCH
from pointing_analysis.spectra.spectra import CLEAR

LEADING = ("time", "psd", "rpe-over-exposure")
"""Pictures that stand first; behind them the star where a requirement is on the image, else the trajectory."""


@dataclass(frozen=True)
class ReportPart:
    """A table, or paragraphs, or both.

    Parameters
    ----------
    title : empty for a part that is never folded
    table : TextTable, optional
    lines : paragraphs behind the table
    run : number of the run that it is about, from 0; None for all
    open : whether it is shown before it is asked for; on paper everything is
    warning : whether it restricts what the verdict is worth
    """

    title: str = ""
    table: TextTable | None = None
    lines: tuple[str, ...] = ()
    run: int | None = None
    open: bool = False
    warning: bool = False


@dataclass(frozen=True)
class ReportSection:
    """Parts under a heading; `key` is its anchor, `note` precedes them."""

    key: str
    title: str
    parts: tuple[ReportPart, ...]
    note: str = ""


@dataclass(frozen=True)
class ReportContent:
    """All of a report.

    Parameters
    ----------
    title, subtitle : of the report
    bags : names of the recordings
    names : labels of the runs
    overall : (label, verdict) of each run
    verdict : a line for each group of requirements
    warnings : what restricts the verdict
    leading, further : pictures, those that stand first and the others
    missing : pictures that there are not, and why
    tables : sections of numbers
    notes : sections that stand at the end
    """

    title: str
    subtitle: str
    bags: tuple[str, ...]
    names: tuple[str, ...]
    overall: tuple[tuple[str, Marked], ...]
    verdict: TextTable
    warnings: tuple[ReportPart, ...]
    leading: tuple[Picture, ...]
    further: tuple[Picture, ...]
    missing: tuple[str, ...]
    tables: tuple[ReportSection, ...]
    notes: tuple[ReportSection, ...]

    @property
    def several(self) -> bool:
        """Whether there are several runs."""
        return len(self.names) > 1

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """All pictures in reading order."""
        return (*self.leading, *self.further)

    def all_tables(self) -> Iterator[TextTable]:
        """All tables in reading order."""
        yield self.verdict
        yield from (p.table for section in (*self.tables, *self.notes) for p in section.parts if p.table is not None)


def content_of(
    views: Sequence[RunView],
    summaries: Sequence[Summary],
    drawn: Sequence[Picture],
    missing: Sequence[str],
    model: ModelResults,
    remarks: Sequence[Sequence[str]] = (),
) -> ReportContent:
    """The content of a report.

    Parameters
    ----------
    views, summaries : of the runs
    drawn : pictures in reading order
    missing : sentences on pictures that cannot be made
    model : results of a model of the runs
    remarks : for each run sentences beside its verdict, or none at all
    """
    names, runs = tuple(v.label for v in views), [v.run for v in views]
    several = len(views) > 1
    # Requirements over several runs are judged on all of them and stand once, at the end
    joint = {str(v.requirement): v for s in summaries for v in s.verdicts if several and v.requirement.across_runs}
    of_runs = [row for name, s in zip(names, summaries) for row in rows_of(s.verdicts, s.beside, name)]
    rows = [row for row in of_runs if row.text not in joint] + rows_of(list(joint.values()), (), ALL_RUNS)
    images = any(v.requirement.of_image for s in summaries for v in s.verdicts)
    first = (*LEADING, "star" if images else "trajectory")
    leading = sorted((p for p in drawn if p.name in first), key=lambda p: first.index(p.name))
    bags = tuple(dict.fromkeys(run.path.name for run in runs))
    kind = "Bag" if all(run.kind == "bag" for run in runs) else "File"
    tables = (
        _requirements(rows, several, all(not s.requirements_known for s in summaries), names),
        ReportSection("metrics", "Metrics", (ReportPart(table=metric_table(names, summaries)),)),
        _lines(views, several),
        _sources(names, model, several),
        _predictions(names, model, several),
        ReportSection("sensors", "Sensors", tuple(_sensors(names, runs, several))),
    )
    notes = (
        ReportSection("notes", "Notes", tuple(_notes(names, summaries, remarks or [()] * len(names)))),
        ReportSection("provenance", "Provenance", tuple(_provenance(names, runs))),
        ReportSection("terms", "Terms", (ReportPart("Indices after ECSS-E-ST-60-10C", _terms(windows_text(views))),)),
    )
    return ReportContent(
        " / ".join(names),
        f"{_origin(runs)} RPE and RKE: exposures of {windows_text(views)}. {kind}{'s' * several}: {', '.join(bags)}.",
        bags,
        names,
        tuple((name, Marked(s.overall, css_class(s.overall))) for name, s in zip(names, summaries)),
        _of_runs(verdict_table(rows, several), names, several),
        tuple(_warnings(names, summaries)),
        tuple(leading),
        tuple(p for p in drawn if p not in leading),
        (
            *(f"No spectrum for {v.label}: {v.without_spectrum}." for v in views if v.without_spectrum),
            *missing,
            *(f"No Nyquist curves and sensitivity for {n}: {why}." for n, why in zip(names, model.without_loop) if why),
        ),
        tuple(section for section in tables if section.parts),
        notes,
    )


def _of_runs(table: TextTable, names: Sequence[str], several: bool) -> TextTable:
    """The table with the class of the run of each row, so that a page can hide it."""
    if not several:
        return table
    classes = tuple(f"run-{names.index(row[0]) if row[0] in names else 'all'}" for row in table.rows)
    return replace(table, classes=classes)


def _requirements(rows: Sequence[RequirementRow], several: bool, unknown: bool, names: Sequence[str]) -> ReportSection:
    if not rows:
        none = f"{UNKNOWN[0].upper()}{UNKNOWN[1:]}." if unknown else "No requirement applies to this run."
        return ReportSection("requirements", "Requirements", (ReportPart(lines=(none,)),))
    note = (
        "The value is the quantile at the required probability; its bound holds at the stated confidence without "
        "assuming a distribution. A proven bound is one of the loop, for every telescope of the family, with its tone "
        "and noise. Correlated samples are equivalent to the number of independent samples shown; for the RPE at most "
        "one per exposure."
    )
    table = _of_runs(requirement_table(rows, several), names, several)
    stated = ReportPart("Requirements as stated", definition_table(rows))
    return ReportSection("requirements", "Requirements", (ReportPart(table=table, lines=(note,)), stated))


def _file(name: str, k: int, several: bool) -> str:
    return f"{name}_{k + 1}" if several else name


def _lines(views: Sequence[RunView], several: bool) -> ReportSection:
    parts = []
    for k, view in enumerate(views):
        title = f"{view.label}: contribution of each line to the RPE"
        table = line_table(view, _file("lines", k, several)) if view.tones or view.within_noise else None
        parts.append(ReportPart(title, table, tuple(_about_lines(view)), k, not several))
    return ReportSection("lines", "Disturbance lines", tuple(parts))


def _about_lines(view: RunView) -> Iterator[str]:
    shown = len(view.tones) + len(view.within_noise)
    if not shown and motion_of(view.run) is not None:
        yield (
            "Wheels or arrays move during this run: see the waterfall, the Campbell diagram and the relative error "
            "over time."
        )
    elif not shown:
        who = "The bag" if view.run.kind == "bag" else "The data"
        yield f"{who} names no lines that this run can resolve, and none is above the noise."
    if shown > LINES_SHOWN:
        yield f"The {LINES_SHOWN} largest of {shown} lines."
    if view.within_noise:
        yield (
            f"In noise: a line that the recording names, less than {CLEAR:g} times the rms amplitude of the noise "
            "beside it."
        )
    if any(line.found for line in view.tones):
        yield (
            "Known from the spectrum: sinusoids that stand out of the noise beside them, although the recording does "
            f"not name them. In a record of noise alone {LINE_SEARCH.false_lines:g} lines are expected. Amplitudes "
            "have bounds at 95 % confidence; the level is that of the peak in the power density (resolution 0.375 Hz)."
        )


def _sources(names: Sequence[str], model: ModelResults, several: bool) -> ReportSection:
    note = (
        "Each source of disturbance alone in the loop as implemented. Their lines of sight add up to that of the run. "
        "Share: covariance of a source with the total in windows of the relative error over the variance of the "
        "total; the shares add up to 100 %."
    )
    parts = tuple(
        ReportPart(
            f"{name}: contribution of each source",
            source_table(shares, _file("sources", k, several)),
            (),
            k,
            not several,
        )
        for k, (name, shares) in enumerate(zip(names, model.sources))
        if shares
    )
    return ReportSection("sources", "Sources of disturbance", parts, note)


def _predictions(names: Sequence[str], model: ModelResults, several: bool) -> ReportSection:
    note = (
        "Amplitude of the line of sight at each tone of the disturbance, norm of both axes. The prediction is the loop "
        "as implemented (sampled plant, one tick of delay, camera held between frames, commands limited), run from the "
        "same start, without the limits of rate and stroke and the quantisation of a run with nonlinear. For a rig it "
        "is the mean over loops in steady state, with the delays measured in the run. Only the tones named in the "
        "recording are compared. Ratio: measured over predicted, ± two standard deviations due to noise; “in noise”: "
        "neither amplitude is above the noise."
    )
    parts = []
    for k, (name, prediction) in enumerate(zip(names, model.predictions)):
        if prediction is not None and prediction.tones:
            title = f"{name}: {digits(prediction.start, 6)} s to {digits(prediction.stop, 6)} s"
            table = prediction_table(prediction, _file("predicted", k, several))
            parts.append(ReportPart(title, table, (), k, not several))
        elif prediction is not None:
            parts.append(ReportPart(lines=(f"{name}: no prediction: {prediction.note}.",), run=k))
    return ReportSection("predicted", "Predicted and measured tones", tuple(parts), note)


def _sensors(names: Sequence[str], runs: Sequence[Recording], several: bool) -> Iterator[ReportPart]:
    for k, (name, run) in enumerate(zip(names, runs)):
        table = sensor_table(run, _file("sensors", k, several))
        if table.rows:
            yield ReportPart(f"{name}: rate and noise of its sensors", table, (), k, not several)


def _warnings(names: Sequence[str], summaries: Sequence[Summary]) -> Iterator[ReportPart]:
    for k, (name, s) in enumerate(zip(names, summaries)):
        if s.problems:
            what = "bag" if s.kind == "bag" else "data"
            title = f"{name}: {len(s.problems)} warning{'s' if len(s.problems) > 1 else ''} about the {what}"
            yield ReportPart(title, lines=s.problems, run=k, warning=True)


def _notes(
    names: Sequence[str], summaries: Sequence[Summary], remarks: Sequence[Sequence[str]]
) -> Iterator[ReportPart]:
    for k, (name, s, more) in enumerate(zip(names, summaries, remarks)):
        data = (
            f"{digits(s.duration, 6)} s, {digits(s.ticks, 6)} {'ticks' if s.mode else 'samples'}; "
            f"first {s.transient:g} s dropped; {digits(s.windows, 6)} windows of {time_text(s.window)}, "
            f"{s.windows_skipped} skipped; samples lost: {s.lost_text()}"
        )
        scenario = [f"Scenario {s.scenario}{f', {s.mode}' if s.mode else ''}"] if s.scenario else []
        conditions = [f"{label}: {text}" for label, text in s.conditions.lines]
        budget = [] if s.budget is None else [str(s.budget)]
        lines = tuple(f"{text[:1].upper()}{text[1:]}." for text in (*scenario, data, *conditions, *budget, *more))
        yield ReportPart(f"{name}: conditions, budget and remarks", lines=lines, run=k)


def _provenance(names: Sequence[str], runs: Sequence[Recording]) -> Iterator[ReportPart]:
    for k, (name, run) in enumerate(zip(names, runs)):
        table = provenance_table(run, _file("provenance", k, len(runs) > 1))
        yield ReportPart(f"{name}: {len(table.rows)} values", table, run=k)


def _terms(exposure: str) -> TextTable:
    rows = (
        ("APE", "absolute performance error: the error at each instant"),
        ("RPE", f"relative performance error: the error minus its mean over an exposure ({exposure}), over all "
         "instants of disjoint exposures"),
        ("AKE, RKE", "absolute and relative knowledge error: the same for the estimate minus the truth"),
        ("temporal", "interpretation of a requirement unless stated: over the time of each run"),
        ("both axes", "indices are formed on both axes before the norm is taken"),
    )  # fmt: skip
    return TextTable.of(texts("term", "meaning"), rows, "Terms", name="terms")


def _origin(runs: Sequence[Recording]) -> str:
    """Source of the line of sight."""
    if all(isinstance(run, Run) for run in runs):
        if not any(map(on_camera, runs)):
            return "Line of sight of the controlled telescope, from the true line of sight recorded in the bag."
        which = "" if all(map(on_camera, runs)) else ", where a device gives no true one"
        return f"Line of sight of the controlled telescope, from the camera, with its noise{which}."
    names = dict.fromkeys(str(run.parameters.get("line_of_sight", run.shown(LOS))) for run in runs)
    return f"Line of sight: {'; '.join(names)}."
