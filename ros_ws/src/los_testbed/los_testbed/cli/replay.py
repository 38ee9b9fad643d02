"""Command ``los-testbed replay``: the sensors of a bag through its own controllers, through others, or to ROS."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from lftkit.support.progress import Progress
from los_testbed.cli.options.options import option
from los_testbed.config.run_config import RunConfig
from pointing_analysis.command.options import MAX_CHUNK_MB, Json, MaxChunk, Transient
from pointing_analysis.command.output import chunk_limit, leave_if_contradicted, number, print_json, seconds
from pointing_analysis.command.recordings import check_bag
from pointing_analysis.command.screen import Screen, on_screen, say, warn
from pointing_analysis.formatting.number_text import ABSENT, digits, percent
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from pointing_analysis.requirements.exposure import probabilities_of, quantile_key

if TYPE_CHECKING:
    from pointing_analysis.read.run import Run
    from pointing_analysis.replay.replay import Comparison

DIFFERENT = 1
"""Exit code of a replay through the recorded controllers that does not reproduce the recording."""

REPLAY_EXAMPLES = """Drive controllers with the sensors of a bag.

With the recorded controllers, the replay reproduces the recorded estimates and commands bit for bit if the bag holds
every sample that the loop used (exit code 1 if not; also of a rig, whose frames are used when they come and have the
stamps of their exposure). The bag is complete where it is whole, too, as `bag verify` finds, and has all samples and
all ticks of its plan. With other controllers it gives their estimates, knowledge errors and commands. The recorded
telescope does not respond to those commands, so a replay has no verdict: `analyse BAG --requirements FILE` judges the
recorded line of sight, and `run --k-fsm FILE` that of another controller.

**Examples**

    los-testbed replay bags/run-20260101-120000

    los-testbed replay bags/night --k-fsm my_observer.json --output bags/night-my_observer

    los-testbed replay bags/isolator --loop fsm+pma         # what the controllers would have commanded

    los-testbed replay bags/night --to-ros --domain 7       # publishes to the nodes on this domain
"""

ROWS = (
    ("knowledge error, rms", "ake_rms_arcsec", "arcsec"),
    ("knowledge error, {part}", "ake_{key}_arcsec", "arcsec"),
    ("RKE rms, {window} windows", "rke_rms_mas", "mas"),
    ("largest mirror command", "fsm_peak_rad", "rad"),
    ("largest force", "pma_peak_n", "N"),
)


def replay(
    bag: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    k_fsm: Annotated[
        str | None, typer.Option(metavar="LAW", help="Observer, as `run` takes it; default: the recorded one.")
    ] = None,
    k_pma: Annotated[
        str | None, typer.Option(metavar="LAW", help="Proof-mass law, as `run` takes it; default: the recorded one.")
    ] = None,
    ports_in_order: Annotated[bool, option("ports_in_order")] = False,
    loop: Annotated[str | None, typer.Option(help="Stage instead of the recorded one: none to fsm+pma.")] = None,
    output: Annotated[Path | None, typer.Option(help="New bag with the sensors and the replayed outputs.")] = None,
    transient: Transient = None,
    to_ros: Annotated[bool, typer.Option("--to-ros", help="Publish the sensors at their own times.")] = False,
    domain: Annotated[int | None, option("domain")] = None,
    timeout: Annotated[float, typer.Option(help="With --to-ros: longest wait for subscribers [s].")] = 30.0,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See REPLAY_EXAMPLES."""
    from los_testbed.bags.writer import check_new_bag
    from pointing_analysis.read.run import Run

    if to_ros and (k_fsm or k_pma or loop):
        raise InputError(
            "--to-ros must be given without --k-fsm, --k-pma and --loop: the nodes have their own controllers"
        )
    seconds("--transient", transient)
    number("--timeout", timeout, 0.0, 86400.0, "s")
    domain = RunConfig(domain=domain).domain
    check_bag(bag)
    if output is not None:
        check_new_bag(output)
    run, console = Run.open(bag, max_chunk=chunk_limit(max_chunk)), Screen(stderr=json_)
    if to_ros:
        content = _to_ros(console, run, output, domain, timeout)
    else:
        content = _through(console, run, (k_fsm, k_pma, loop, ports_in_order), output, transient)
        if content["as_recorded"] and content["identical"]:
            content["complete"] = _is_complete(console, bag, run, content["ticks"], chunk_limit(max_chunk))
    if json_:
        print_json({**content, "contradictions": list(run.contradictions)})
    for text in run.contradictions:
        say(console, text, "note")
    leave_if_contradicted(run.contradictions)
    if content["as_recorded"] and not content["identical"]:
        raise typer.Exit(DIFFERENT)


def _through(
    console: Console,
    run: Run,
    others: tuple[str | None, str | None, str | None, bool],
    output: Path | None,
    transient: float | None,
) -> dict[str, Any]:
    from los_testbed.run import replay as replay_run
    from pointing_analysis.replay.replay import compare

    chosen = replay_run.controllers(run, *others)
    warn(chosen.warnings)
    with Progress("replay [ticks]", equal=True) as bar:
        replayed = replay_run.drive(run, chosen, bar.report)
    comparison = compare(run, replayed)
    metrics = replay_run.metrics(run, replayed, transient)
    _show(console, comparison, metrics, chosen.difference, run)
    content = replay_run.as_dict(run, chosen, comparison, metrics)
    if output is not None:
        replay_run.write_bag(output, run, replayed, chosen)
        say(console, f"bag     {output}")
    return {**content, "output": None if output is None else str(output)}


def _is_complete(console: Console, bag: Path, run: Run, replayed: int, max_chunk: int) -> bool:
    """Whether a bag is whole, without a lost sample, its run of as many ticks as were replayed; a line says it."""
    from los_testbed.bags.check import check_bag as verify
    from pointing_analysis.requirements.recording_state import recording_state

    verification = verify(bag, max_chunk)
    reasons, title = list[str](), verification.title
    if verification.code or verification.ticks is None:
        reasons.append("whole, and does not say what was planned" if title == "whole" else title)
    elif verification.ticks != replayed:
        reasons.append(f"{replayed} of the {verification.ticks} ticks of its plan were replayed")
    if lost := recording_state(run)[0]:
        reasons.append(f"{counted(sum(lost.values()), 'sample')} of {', '.join(lost)} missing")
    say(console, f"the bag is not shown to be complete: {'; '.join(reasons)}" if reasons else "the bag is complete")
    return not reasons


def _to_ros(console: Console, run: Run, output: Path | None, domain: int | None, timeout: float) -> dict[str, Any]:
    from los_testbed.run import replay as replay_run
    from los_testbed.run.processes.node_launch import check_ros
    from pointing_analysis.replay.replay import compare

    check_ros(domain)
    from los_testbed.nodes.sensor_player import play
    from los_testbed.run.replay_ports import layout_of, recorded_ports
    from pointing_analysis.requirements.summary import METADATA as REQUIREMENTS

    with Progress("sensors to ROS [ticks]", equal=True) as bar:
        played = play(run, domain, timeout, bar.report)
    for warning in played.warnings:
        say(console, warning, "warning")
    console.print(f"{played.ticks} ticks sent, {played.late} of them a millisecond or more late", highlight=False)
    content: dict[str, Any] = {"bag": str(run.path), "as_recorded": False, "ticks": played.ticks, "late": played.late}
    content["answers"] = {name: len(stamps) for name, (stamps, _) in played.answers.items()}
    content["identical"] = None
    if played.answers:
        laws = recorded_ports(run).used_by()
        layout = layout_of(laws.of_law("k_fsm"), laws.of_law("k_pma"))
        comparison = compare(run, played.replayed(layout))
        content["identical"] = comparison.identical
        console.print(f"commands of the nodes against the recording: {comparison}", soft_wrap=True, highlight=False)
    if output is not None:
        signals = {name: (run[name].stamp, run[name].values) for name in played.sent}
        metadata = {"mode": "replay to ROS", "replay_of": run.path.name}
        if REQUIREMENTS in run.parameters:
            metadata[REQUIREMENTS] = json.dumps(run.parameters[REQUIREMENTS])
        replay_run.write_signal_bag(output, metadata, {**signals, **played.answers})
        say(console, f"bag     {output}")
    return {**content, "output": None if output is None else str(output)}


def _show(
    console: Console, comparison: Comparison, metrics: Mapping[str, Mapping[str, float]], difference: str, run: Run
) -> None:
    from pointing_analysis.requirements.requirement import time_text
    from pointing_analysis.requirements.summary import exposure_of_run, requirements_of

    say(console, f"{difference or 'controllers as recorded'}: {comparison}")
    if comparison.incomplete:
        console.print(f"{comparison.incomplete} ticks lack a sensor in the bag and were excluded", soft_wrap=True)
    window, part = time_text(exposure_of_run(run)), probabilities_of(requirements_of(run) or ()).knowledge
    rows = []
    for text, key, unit in ROWS:
        values = [metrics[side].get(key.format(key=quantile_key(part))) for side in ("recorded", "replayed")]
        if any(value is not None for value in values):
            shown = (ABSENT if value is None else f"{digits(value, 4)} {unit}" for value in values)
            rows.append((text.format(window=window, part=percent(part, 10)), *shown))
    table = TextTable.of((*texts("metric"), *numbers("recorded", "replayed")), rows, "Recorded and replayed")
    console.print(on_screen(table))
