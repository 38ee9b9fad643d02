"""Metrics of recorded runs: the table on the screen, the JSON object, the HTML report."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table as ScreenTable

from lftkit.support.counted_nouns import counted
from los_testbed.config.topics import UNSENT_TICKS
from los_testbed.run.change_requests import requested
from los_testbed.run.results import MAX_MISSED
from los_testbed.run.summary.loop_proof import with_proof
from los_testbed.run.summary.ran_loop import RanLoop
from los_testbed.run.summary.source_shares import as_rows, source_shares
from pointing_analysis.command.screen import marked, met, on_screen, say
from pointing_analysis.formatting.number_text import ABSENT
from pointing_analysis.indices.errors import on_camera
from pointing_analysis.read import run_end
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import UNSENT
from pointing_analysis.report.outputs import NO_REPORT, ReportOutputs
from pointing_analysis.report.source_share import SourceShare, source_table
from pointing_analysis.requirements.conditions import ACTING, MEMBER, WHEEL_SPEEDS, differences
from pointing_analysis.requirements.requirement import time_text
from pointing_analysis.requirements.rows import BRIEF, requirement_table
from pointing_analysis.requirements.summary import UNKNOWN, Summary, summarise_all
from pointing_analysis.requirements.verdict import Requirement

if TYPE_CHECKING:
    from pointing_analysis.report.model_results import ExpectedLines

ON_CAMERA = (
    "the device gives no true line of sight: the verdicts are on the camera's, with its noise, and do not cover "
    "motion above half of its frame rate"
)


@dataclass(frozen=True)
class RunSummaries:
    """Metrics of some runs.

    Attributes
    ----------
    summaries : tuple of Summary
    runs : tuple of dict
        Each run as the JSON object of the command line.
    outputs : ReportOutputs
        Files of the report that were written.
    remarks : tuple of tuple of str
        Of each run sentences beside its verdict.
    shares : tuple of tuple of SourceShare
        Contributions of the disturbance sources of each run.
    """

    summaries: tuple[Summary, ...]
    runs: tuple[dict[str, Any], ...]
    outputs: ReportOutputs = NO_REPORT
    remarks: tuple[tuple[str, ...], ...] = ()
    shares: tuple[tuple[SourceShare, ...], ...] = ()


def summarise_runs(
    bags: Sequence[Path | Recording],
    report: Path | ReportOutputs | None,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
) -> RunSummaries:
    """Read bags, compute their metrics, write the report.

    Parameters
    ----------
    bags : sequence of Path or Recording
        Folders or .mcap files of the testbed, or what is open already.
    report : Path, ReportOutputs or None
        HTML or PDF file to write, or all files.
    transient : float, optional
        Seconds of start-up to leave out.
    requirements : sequence of Requirement, optional
        By default those of each bag.

    Raises
    ------
    ValueError
        A bag that cannot be read or holds no run.
    """
    outputs = report if isinstance(report, ReportOutputs) else ReportOutputs(report)
    outputs.check()
    runs = [Run.open(bag) if isinstance(bag, Path) else bag for bag in bags]
    judged_runs = judged(runs, transient, requirements)
    if outputs:
        judged_runs.write_page(outputs)
    metrics = tuple(_metrics(*one) for one in zip(judged_runs.runs, judged_runs.summaries, judged_runs.remarks))
    for values, rows in zip(metrics, judged_runs.shares):
        if rows:
            values["disturbances"] = as_rows(rows)
    return RunSummaries(judged_runs.summaries, metrics, outputs, judged_runs.remarks, judged_runs.shares)


@dataclass(frozen=True)
class JudgedRuns:
    """Open recordings with their verdicts.

    Attributes
    ----------
    runs : tuple of Recording
        Older bags of this testbed with the requirements of the reference telescope.
    summaries : tuple of Summary
    shares : tuple of tuple of SourceShare
        Contributions of the disturbance sources of each run.
    remarks : tuple of tuple of str
        Of each run sentences beside its verdict; what is assumed, and why there are no shares.
    loops : tuple of RanLoop or None
        Of each bag of this testbed the loop that it holds.
    transient : float or None
        Seconds of start-up that are left out.
    requirements : sequence of Requirement or None
        In place of those of the runs.
    """

    runs: tuple[Recording, ...]
    summaries: tuple[Summary, ...]
    shares: tuple[tuple[SourceShare, ...], ...]
    remarks: tuple[tuple[str, ...], ...]
    loops: tuple[RanLoop | None, ...]
    transient: float | None
    requirements: Sequence[Requirement] | None

    def write_page(self, outputs: ReportOutputs, lines: ExpectedLines | None = None) -> None:
        """Write the report, and its figures and tables.

        Parameters
        ----------
        outputs : ReportOutputs
        lines : mapping, optional
            Of the :class:`pointing_analysis.report.model_results.ModelResults` of the page.
        """
        from los_testbed.run.summary.loop_curves import loop_curves
        from los_testbed.run.summary.predictions import predictions
        from pointing_analysis.report.model_results import ModelResults
        from pointing_analysis.report.report import report_content  # with matplotlib, which nothing else of a run needs

        predicted, curves = predictions(self.loops, self.transient), [loop_curves(loop) for loop in self.loops]
        loops, without = zip(*curves)
        content = report_content(
            self.runs,
            transient=self.transient,
            requirements=self.requirements,
            model=ModelResults(lines or {}, predicted, self.shares, loops, without),
            remarks=self.remarks,
            summaries=self.summaries,
        )
        outputs.write(content)


def judged(
    recordings: Sequence[Recording], transient: float | None, requirements: Sequence[Requirement] | None
) -> JudgedRuns:
    """Verdicts on open recordings; the arguments are attributes of `JudgedRuns`."""
    loops = tuple(RanLoop.of(run) if isinstance(run, Run) else None for run in recordings)
    runs = tuple(_without_claims(run, loop) for run, loop in zip(recordings, loops))
    measured = summarise_all(runs, transient=transient, requirements=requirements)
    proofs = [(summary, ()) if loop is None else with_proof(loop, summary) for loop, summary in zip(loops, measured)]
    shares = [_shares_or_reason(loop) for loop in loops]
    remarks = tuple(
        (
            *(() if loop is None else remarks_of(loop, summary, lines)),
            *missing,
            *([other] if other else []),
        )
        for loop, (summary, lines), (_, missing), other in zip(loops, proofs, shares, differences(runs))
    )
    summaries = tuple(summary for summary, _ in proofs)
    return JudgedRuns(runs, summaries, tuple(share for share, _ in shares), remarks, loops, transient, requirements)


def _without_claims(run: Recording, loop: RanLoop | None) -> Recording:
    """The recording; a bag of a loop that is not known to have run without what it says of the member and what acts."""
    if loop is None or not loop.unknown:
        return run
    kept = {key: value for key, value in run.parameters.items() if key not in (ACTING, MEMBER, WHEEL_SPEEDS)}
    return loop.run.changed(kept, {})


def _shares_or_reason(loop: RanLoop | None) -> tuple[tuple[SourceShare, ...], tuple[str, ...]]:
    try:
        return source_shares(loop), ()
    except ValueError as error:
        return (), (f"no shares of sources: {error}",)


def remarks_of(loop: RanLoop, summary: Summary, proofs: Sequence[str] = ()) -> tuple[str, ...]:
    """Sentences beside the verdict of a run, those on proofs among them."""
    from los_testbed.run.summary.control_effect import control_effect

    run = loop.run
    effect = control_effect(loop, summary)
    notes = (str(run.parameters.get(name, "")) for name in ("start_note", "idle_devices"))
    camera, lost = ON_CAMERA if on_camera(run) else "", _lost_periods(run, summary)
    remarks = (effect.remark if effect else "", camera, lost, *notes, *proofs, *requested(run))
    return tuple(text for text in remarks if text)


def _lost_periods(run: Recording, summary: Summary) -> str:
    """Sentences about samples that a real-time plant did not send; empty if it lost no period."""
    plant = _statistics(run, "plant")
    lost = int(plant.get("lost_periods", 0))
    unsent = int(sum(plant.get(f"{UNSENT}{name}", 0) for name in (UNSENT_TICKS, "outside"))) - lost
    sentences = [f"{counted(lost, 'period')} lost: the plant held its command, and no sample was sent"] * (lost > 0)
    sentences += [f"in {counted(unsent, 'tick')} samples of the device were incomplete, and none was sent"] * (
        unsent > 0
    )
    if sentences and summary.windows_skipped:
        sentences.append(
            f"{counted(summary.windows_skipped, 'window')} of {time_text(summary.window)} with one excluded"
        )
    if lost and not run.parameters.get("device"):  # a rig has no other mode
        sentences.append("--mode lockstep loses none")
    return "; ".join(sentences)


def _metrics(run: Recording, summary: Summary, remarks: Sequence[str]) -> dict[str, Any]:
    """One run as the JSON object of the command line."""
    plant, recorder = (_statistics(run, node) for node in ("plant", "recorder"))
    return {
        **summary.as_dict(),
        "bag": str(summary.path),
        "mode": summary.mode,
        "loop": summary.loop,
        "ticks": int(plant.get("ticks", summary.ticks)),
        "periods": int(plant.get("ticks", summary.ticks)) + int(plant.get("skipped_periods", 0)),
        "missed_ticks": int(plant["missed_ticks"]) if "missed_ticks" in plant else None,
        "lost_periods": int(plant.get("lost_periods", 0)),
        "max_missed": float(run.parameters.get("max_missed", MAX_MISSED)),
        "latency_us": _latency(run, plant),
        "remarks": list(remarks),
        "samples_lost": max(summary.samples_lost, int(recorder.get("samples_lost", 0))),
    }


def _statistics(run: Recording, node: str) -> dict[str, float]:
    """Statistics of a node as the bag has them; what is no number is left out."""
    numbers: dict[str, float] = {}
    for name, text in run_end.statistics_of(run.parameters, node).items():
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            numbers[name] = float(text)
    whole = ("ticks", "missed_ticks", "lost_periods", "samples_lost")
    return {name: x for name, x in numbers.items() if name not in whole or 0 <= x < 1e15}


def _latency(run: Recording, plant: Mapping[str, float]) -> dict[str, float | None]:
    """Wake-up of the plant to arrival of the mirror command; None where the plant did not report it."""
    names = {"median": "latency_median_us", "p99": "latency_p99_us", "p999": "latency_p999_us"}
    if all(name in plant for name in names.values()):
        return {key: _number(plant[name]) for key, name in names.items()}
    return dict.fromkeys(names)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def missed_share(metrics: Mapping[str, Any]) -> float:
    """Missed ticks of a run in real time [%]; zero where time was not real or the plant did not report them.

    Examples
    --------
    >>> missed_share({"mode": "realtime", "missed_ticks": 129, "periods": 10_000})
    1.29
    """
    if metrics["mode"] != "realtime" or metrics["missed_ticks"] is None:
        return 0.0
    return run_end.missed_share({"missed_ticks": metrics["missed_ticks"], "ticks": metrics["periods"]})


def print_summary(console: Console, results: RunSummaries, told: Collection[str] = ()) -> None:
    """Print a table for each run, remarks that were not `told` before, and the paths."""
    rows = results.shares or ((),) * len(results.runs)
    for summary, metrics, shares in zip(results.summaries, results.runs, rows):
        console.print(_table(summary, metrics))
        if not summary.requirements_known:
            say(console, UNKNOWN, "note")
        if shares:
            console.print(on_screen(source_table(shares)))
        if summary.budget is not None:
            console.print(str(summary.budget), soft_wrap=True, highlight=False, markup=False)
        for remark in metrics["remarks"]:
            if remark not in told:
                say(console, remark, "note")
        for problem in summary.problems:
            say(console, problem, "note")
        for label, text in summary.conditions.lines:
            say(console, f"{label:<7} {text}")
        if summary.sampling:
            say(console, f"rate    {summary.sampling}")
        say(console, f"{summary.kind:<7} {summary.path}")
    say_outputs(console, results.outputs)


def say_outputs(console: Console, outputs: ReportOutputs) -> None:
    """Print where the report is, and its figures and tables."""
    if outputs.path is not None:
        say(console, f"report  {outputs.path}")
    if outputs.export is not None:
        say(console, f"export  {outputs.export}")


def _table(summary: Summary, metrics: Mapping[str, Any]) -> ScreenTable:
    what = (summary.loop or summary.path.name, summary.scenario, summary.mode, f"{summary.duration:g} s")
    title = ", ".join(part for part in what if part)
    title += f", first {summary.transient:g} s (start-up) excluded" if summary.transient else ", nothing excluded"
    table = on_screen(replace(requirement_table(summary.rows).only(*BRIEF), title=title))
    table.add_section()
    judged = {row.quantity for row in summary.rows}
    for figure in summary.figures:
        if figure.quantity not in judged:
            table.add_row(figure.name, figure.text)
    lost = metrics["samples_lost"]
    verdict = "not known: truncated" if summary.open_end and not lost else met(not lost)
    table.add_row("samples lost", summary.lost_text(lost), "0", "", marked(verdict))
    missed, periods = metrics["missed_ticks"], metrics["periods"]
    if summary.mode == "realtime" and missed is not None:
        share, max_missed = missed_share(metrics), metrics["max_missed"]
        ok = met(share <= max_missed)
        table.add_row("missed ticks", f"{missed} of {periods} ({share:.2f} %)", f"{max_missed:g} %", "", marked(ok))
        if lost := metrics["lost_periods"]:
            table.add_row("of these periods lost by the machine", f"{lost} ({100.0 * lost / periods:.2f} %)")
        latency = metrics["latency_us"]
        texts = [f"{latency[key]:.0f}" if latency[key] is not None else ABSENT for key in ("median", "p99", "p999")]
        table.add_row("sensor to command: median, 99 %, 99.9 %", " / ".join(texts) + " µs")
    return table
