"""Metrics of recorded runs: the table on the screen, the JSON object, the HTML report."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from los_testbed.run.screen import say
from pointing_analysis.atomic_output import check_output
from pointing_analysis.mcap_records import MAX_CHUNK
from pointing_analysis.read import Run
from pointing_analysis.report import digits, write_report
from pointing_analysis.requirements import Verdict
from pointing_analysis.summary import Summary, summarise


@dataclass(frozen=True)
class RunSummaries:
    """Metrics of some runs.

    Attributes
    ----------
    summaries : tuple of Summary
    runs : tuple of dict
        Each run as the JSON object of the command line.
    report : Path or None
        HTML report, if one was written.
    """

    summaries: tuple[Summary, ...]
    runs: tuple[dict[str, Any], ...]
    report: Path | None


def summarise_runs(
    bags: Sequence[Path], report: Path | None, transient: float | None = None, max_chunk: int = MAX_CHUNK
) -> RunSummaries:
    """Read bags, compute their metrics, write the report.

    Parameters
    ----------
    bags : sequence of Path
        Folders or .mcap files.
    report : Path or None
        HTML file to write.
    transient : float, optional
        Seconds of start-up to leave out.
    max_chunk : int
        Largest chunk that is unpacked [byte].

    Raises
    ------
    ValueError
        A bag that cannot be read or holds no run.
    """
    if report is not None:
        check_output(report, "the report")
    opened = [Run.open(bag, max_chunk=max_chunk) for bag in bags]
    summaries = tuple(summarise(run, transient=transient) for run in opened)
    if report is not None:
        from los_testbed.run.predictions import predictions

        write_report(opened, report, transient=transient, predictions=predictions(opened, transient))
    return RunSummaries(summaries, tuple(_metrics(r, s) for r, s in zip(opened, summaries)), report)


def _metrics(run: Run, summary: Summary) -> dict[str, Any]:
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
        "latency_us": _latency(run, plant),
        "samples_lost": max(summary.samples_lost, int(recorder.get("samples_lost", 0))),
    }


def _statistics(run: Run, node: str) -> dict[str, float]:
    """Statistics of a node as the bag has them; what is no number is left out."""
    statistics = run.parameters.get("statistics", {})
    found = statistics.get(node, {}) if isinstance(statistics, dict) else {}
    numbers: dict[str, float] = {}
    for name, text in found.items() if isinstance(found, dict) else ():
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            numbers[name] = float(text)
    whole = ("ticks", "missed_ticks", "samples_lost")
    return {name: x for name, x in numbers.items() if name not in whole or 0 <= x < 1e15}


def _latency(run: Run, plant: Mapping[str, float]) -> dict[str, float | None]:
    """Wake-up of the plant to arrival of the mirror command; None where the plant did not report it."""
    names = {"median": "latency_median_us", "p99": "latency_p99_us", "p999": "latency_p999_us"}
    if all(name in plant for name in names.values()):
        return {key: _number(plant[name]) for key, name in names.items()}
    return dict.fromkeys(names)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def print_summary(console: Console, results: RunSummaries) -> None:
    """Print a table for each run, and the paths."""
    for summary, metrics in zip(results.summaries, results.runs):
        console.print(_table(summary, metrics))
        for problem in summary.problems:
            say(console, problem, "note")
        say(console, f"bag     {summary.path}")
    if results.report is not None:
        say(console, f"report  {results.report}")


def _table(summary: Summary, metrics: Mapping[str, Any]) -> Table:
    title = f"{summary.loop or summary.path.name}, {summary.scenario}, {summary.mode}, {summary.duration:g} s, "
    title += f"first {summary.transient:g} s (start-up) left out"
    table = Table(title=Text(title, style="table.title"))
    table.add_column("metric")
    table.add_column("value", justify="right")
    table.add_column("limit", justify="right")
    table.add_column("verdict")
    strictest = {v.requirement.index: v for v in sorted(summary.verdicts, key=lambda v: -v.requirement.limit)}
    ape, rpe = strictest.get("APE"), strictest.get("RPE")
    _row(table, "APE max", summary.ape_max, "arcsec", ape, judged=False)
    _row(table, "APE 99.7 %", summary.ape_p997, "arcsec", ape)
    _row(table, "RPE rms, 20 ms windows", summary.rpe_rms, "mas", rpe, judged=False)
    _row(table, "RPE 99.7 %, 20 ms windows", summary.rpe_p997, "mas", rpe)
    lost = metrics["samples_lost"]
    table.add_row("samples lost", str(lost), "0", "met" if not lost else "[red]not met[/red]")
    missed, periods = metrics["missed_ticks"], metrics["periods"]
    if summary.mode == "realtime" and missed is not None:
        share = 100.0 * missed / max(periods, 1)  # a missed tick is a held command or a lost period: at most all
        ok = "met" if share <= 0.5 else "[red]not met[/red]"
        table.add_row("missed ticks", f"{missed} of {periods} ({share:.2f} %)", "0.5 %", ok)
        latency = metrics["latency_us"]
        texts = [f"{latency[key]:.0f}" if latency[key] is not None else "-" for key in ("median", "p99", "p999")]
        table.add_row("sensor to command: median, 99 %, 99.9 %", " / ".join(texts) + " µs", "", "")
    return table


def _row(table: Table, name: str, value: float, unit: str, verdict: Verdict | None, judged: bool = True) -> None:
    """One metric against its limit; only the quantile the requirement names carries its verdict."""
    limit, status = "", ""
    if verdict is not None:
        bound = verdict.requirement.limit / verdict.requirement.scale
        limit = f"{bound:g} {unit}"
        status = str(verdict.status) if judged else "below" if value < bound else "above"
        if status in ("not compliant", "above"):
            status = f"[red]{status}[/red]"
    table.add_row(name, f"{digits(value)} {unit}", limit, status)
