"""Command ``los-testbed run``: configure, run, record, evaluate."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from lftkit.errors import InputError
from lftkit.support.progress import Progress
from los_testbed.cli.command_group import HelpAll
from los_testbed.cli.environment import SUPERVISED
from los_testbed.cli.finished_run import check_trace, sign, write_ticks
from los_testbed.cli.options import live_options
from los_testbed.cli.options.live_options import LIVE_PORT, check_live, server_for_viewers
from los_testbed.cli.options.options import FILES, Case, Cases, Designs, with_settings
from los_testbed.config.run_config import AUTO, NAMESPACE, ROS, RunConfig, is_code, parse_value, read_yaml, settings_of
from los_testbed.config.run_settings import chosen_member, completed, layered, of_designs
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.bag_names import new_bag
from los_testbed.run.execution import Nodes, execute
from los_testbed.run.modes import first_choice
from los_testbed.run.processes.domains import free_domain
from los_testbed.run.results import RunError, check_missed
from los_testbed.run.supervision import supervise
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Gate, Json
from pointing_analysis.command.output import gate_of, leave_by_gate, print_json
from pointing_analysis.command.screen import Screen, say
from pointing_analysis.read.mcap.records import ShortRunError
from titop_plant.physical_settings import DISTURBANCES, TELESCOPE

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from pointing_analysis.requirements.summary import Summary

FREE = "free"
"""Value of ``--domain`` for an unused domain of this machine."""

RUN_EXAMPLES = """Run the loop, record it, evaluate the record.

**Examples**

    los-testbed run                                    # 10 s on ROS 2 in real time, all loops closed

    los-testbed run --duration 600 --live              # with live view in Foxglove or a browser

    los-testbed run --loop isolator --seed 3           # the same telescope without control

    los-testbed run --mode inprocess --duration 60     # one process, no ROS, as fast as possible

    los-testbed run --parameters my_telescope.toml     # your spacecraft; --designs FOLDER with its controllers

    los-testbed run --disturbance measured.csv@wheel_2 --disturbance cooler.toml    # your disturbances

    los-testbed run --k-fsm my_observer.json --set camera_dropout=0.1     # your controller, any setting
"""


@with_settings(
    [
        name
        for name in RunConfig.SETTINGS
        if not name.startswith("disturbance") and name not in ("mode_choice", "parameter_values")
    ],
    metavars={
        "domain": "INTEGER|free",
        "mode": "MODE",
        "k_fsm": "LAW",
        "k_pma": "LAW",
        "output": "FOLDER",
        "max_missed": "PERCENT",
    },
    helps={
        "mode": "How plant, estimator and controller run: realtime, lockstep, inprocess, or auto (real time if "
        "the machine is fast enough, else lockstep); default: auto.",
    },
)
def run(
    *,
    given: dict[str, Any],
    disturbance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SOURCE]",
            help="Wheel and drive disturbances; or your own: FILE, FILE@PLACE or MODULE:NAME; repeatable.",
        ),
    ] = None,
    no_disturbance: Annotated[
        bool, typer.Option("--no-disturbance", help="No disturbance.", rich_help_panel=DISTURBANCES)
    ] = False,
    designs: Designs = None,
    sample: Annotated[
        str | None,
        typer.Option(metavar="SEED", help="Random member of the telescope's family.", rich_help_panel=TELESCOPE),
    ] = None,
    case: Case = None,
    cases: Cases = None,
    config: Annotated[Path | None, typer.Option(help="YAML file of settings.", rich_help_panel=FILES)] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Setting, or parameter of the telescope; repeatable.",
            rich_help_panel=FILES,
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            help="Run this node alone, for a loop over several hosts: plant, estimator, controller, recorder.",
            rich_help_panel=ROS,
        ),
    ] = None,
    live: live_options.Port = None,
    live_host: live_options.Host = "127.0.0.1",
    live_origin: live_options.Origins = None,
    live_topic: live_options.Topics = None,
    live_tls_cert: live_options.TlsCert = None,
    live_tls_key: live_options.TlsKey = None,
    sign_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Sign the bag with this Ed25519 private key (PEM).", rich_help_panel=FILES),
    ] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the ticks of a real-time run as a trace, as bag trace does.",
            rich_help_panel=FILES,
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write the HTML report.")] = True,
    gate: Gate = False,
    json_: Json = False,
    help_all: HelpAll = False,
) -> None:
    """See RUN_EXAMPLES."""
    with contextlib.ExitStack() as held:
        free = given["domain"] == FREE
        if free:
            given["domain"] = held.enter_context(free_domain(given["namespace"] or NAMESPACE))
            sys.stderr.write(f"ROS domain {given['domain']}\n")
        given |= _disturbance(disturbance, no_disturbance)
        free_mode = only is None and trace is None
        chosen = configure(config, settings or [], given, case, cases, sample, designs, free_mode=free_mode)
        if only is not None:
            _watch_code_of_user(chosen.code_of_user, chosen.bag)
            _run_alone(only, chosen, sign_key is not None, trace)
        if trace is not None:
            check_trace(trace, chosen)
        viewers = server_for_viewers(live, live_host, live_origin or (), live_topic or (), live_tls_cert, live_tls_key)
        key = None
        if sign_key is not None:
            from los_testbed.bags.signature import private_key

            key = private_key("--sign-key", sign_key)
        _watch_code_of_user(chosen.code_of_user, chosen.bag)
        parts = RunParts(chosen)
        summary = _run_and_tell(parts, Nodes(viewers, not free), report, json_, key, trace)
        if gate:
            leave_by_gate([] if summary is None else gate_of([summary]))


def _watch_code_of_user(code: Mapping[str, str], bag: Path) -> None:
    """In a program that calls user code: continue in a supervised child process."""
    if SUPERVISED in os.environ and code:
        del os.environ[SUPERVISED]
        supervise([f"{setting} {name}" for setting, name in code.items()], bag)


def _run_alone(name: str, config: RunConfig, signed: bool, trace: Path | None) -> NoReturn:
    """Run one node in this process."""
    if signed:
        raise InputError("--sign-key must be given without --only: los-testbed bag sign signs the bag")
    if trace is not None:
        raise InputError("--trace must be given without --only: los-testbed bag trace reads the recorder's bag")
    from los_testbed.run.processes.node_launch import run_alone

    raise typer.Exit(run_alone(name, config))


def _run_and_tell(
    parts: RunParts,
    nodes: Nodes,
    report: bool,
    json_: bool,
    key: Ed25519PrivateKey | None = None,
    trace: Path | None = None,
) -> Summary | None:
    """Run; print warnings and results; exit codes of a run that finished with faults.

    Its summary; None if it is too short to be evaluated.
    """
    from los_testbed.run.summary.summary import missed_share, print_summary, summarise_runs

    if nodes.live is not None:
        check_live(parts.config.mode, nodes.live)
    console = Screen(stderr=json_)
    results = execute(parts, nodes)
    bag = results.bag
    if bag is None:  # the runner has raised unless it was interrupted
        raise KeyboardInterrupt
    for warning in [*results.warnings, *results.failures]:
        say(console, warning, "warning")
    whole = key is None or sign(console, bag, key)
    whole = (trace is None or write_ticks(console, bag, trace)) and whole
    ended = ExitCode.INTERRUPTED if results.interrupted else ExitCode.RESTARTED if results.failures else None
    try:
        with Progress("report" if report else "analysis"):
            summaries = summarise_runs([bag], bag / "report.html" if report else None)
    except ShortRunError as error:  # as requested, or shortened by a request, a fault or a signal
        if ended is not None:
            raise RunError(f"not evaluated: {error}", ended) from None
        say(console, f"not evaluated: {error}; the bag is whole", "warning")
        if json_:
            print_json({"bag": str(bag), "not_evaluated": str(error)})
        if not whole:
            raise typer.Exit(ExitCode.FAILED) from None
        return None
    except ValueError as error:  # not a user error that is detected before the run
        code = getattr(error, "code", ExitCode.FAILED) if ended is None else ended
        raise RunError(f"not evaluated: {error}", code) from None
    print_summary(console, summaries, told=[parts.idle_devices])
    if json_:
        print_json(summaries.runs[0])
    if ended is not None:
        raise typer.Exit(ended)
    if not whole:
        raise typer.Exit(ExitCode.FAILED)
    try:
        check_missed(missed_share(summaries.runs[0]), parts.config, f"; the bag is whole: {bag}")
    except RunError as error:
        if parts.config.mode_choice is None:
            raise
        say(console, str(error), "warning")
    return summaries.summaries[0]


def configure(
    file: Path | None,
    settings: list[str],
    given: dict[str, Any],
    case: str | None = None,
    cases: Path | None = None,
    sample: str | None = None,
    designs: str | None = None,
    free_mode: bool = False,
) -> RunConfig:
    """Configuration from folder of designs, file, named case, random member, ``--set`` and options; later ones win.

    Where none of them names a member of the telescope's family, the scenario chooses it. The mode ``auto``, which is
    the default where the mode is free, is the first choice of :mod:`los_testbed.run.modes`.

    Raises
    ------
    ValueError
        Unknown names, values that do not fit.
    """
    first: dict[str, Any] = {**of_designs(designs or ""), **(read_yaml(file) if file is not None else {})}
    stated = settings_of(settings)
    options = {name: parse_value(name, v) if isinstance(v, str) else v for name, v in given.items() if v is not None}
    by_name = {name: stated.pop(name) for name in ("parameter_values",) if name in stated}
    explicit = layered(stated, options) | by_name  # one layer: a parameter by its name and by an option is given twice
    named, drawn = chosen_member(case, cases, sample, first, explicit)
    settings_given = layered(first, named, drawn, explicit)
    if settings_given.get("mode", AUTO if free_mode and "max_missed" not in settings_given else "") == AUTO:
        free_mode = not settings_given.get("device")
        settings_given.pop("mode", None)
    else:
        free_mode = False
    with _naming(file, {name for name, value in first.items() if settings_given.get(name) is value}):
        chosen = completed(settings_given, designs or "")
    if free_mode:
        chosen = first_choice(chosen)
    if chosen.output is None:
        chosen = replace(chosen, output=str(new_bag(chosen)))
    return chosen


@contextlib.contextmanager
def _naming(file: Path | None, names: set[str]) -> Iterator[None]:
    """Refusals of the settings with these names begin with the file that gives them."""
    try:
        yield
    except InputError as error:
        starts = tuple(start for name in names for start in (f"{name} must", f"unknown parameter {name!r}"))
        if file is None or not str(error).startswith(starts):
            raise
        raise InputError.of_file(file, error) from None


DISTURBANCE_ON = "on"
"""Value of ``--disturbance`` where it stands alone."""


def _disturbance(values: list[str] | None, none: bool) -> dict[str, Any]:
    """Settings of ``--disturbance`` and ``--no-disturbance``."""
    if values and none:
        raise InputError(f"one of --disturbance and --no-disturbance must be given, got both ({', '.join(values)})")
    if not values:
        return {"disturbance": False} if none else {}
    classes = [name for name in values if name != DISTURBANCE_ON and is_code(name)]
    files = [name for name in values if name not in classes and name != DISTURBANCE_ON]
    if len(classes) > 1:
        raise InputError(f"--disturbance must name one class at most, got {', '.join(classes)}")
    if odd := [name for name in files if ";" in name]:
        raise InputError(f"--disturbance must name files without a semicolon, got {odd[0]}")
    settings: dict[str, Any] = {"disturbance": True}
    if classes:
        settings["disturbance_source"] = classes[0]
    if files:
        settings["disturbance_files"] = ";".join(files)
    return settings


LISTS = tuple("--" + name.replace("_", "-") for name, own in RunConfig.SETTINGS.items() if own.kind is tuple)
"""Options with as many numbers as the telescope has wheels, or frequencies."""


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def with_lone_options(arguments: Sequence[str]) -> list[str]:
    """The command line with the values of ``--live`` and ``--disturbance`` where they stand alone, and lists in one.

    Examples
    --------
    >>> with_lone_options(["run", "--live", "--seed", "3"]), with_lone_options(["run", "--live", "9000"])
    (['run', '--live=8765', '--seed', '3'], ['run', '--live', '9000'])
    >>> with_lone_options(["run", "--disturbance", "--noise"]), with_lone_options(["run", "--disturbance", "my:Wind"])
    (['run', '--disturbance=on', '--noise'], ['run', '--disturbance', 'my:Wind'])
    >>> with_lone_options(["run", "--wheel-speed", "200", "-210.5", "--seed", "3"])
    ['run', '--wheel-speed=200 -210.5', '--seed', '3']
    """
    words: list[str] = []
    for a, b in zip(arguments, [*arguments[1:], ""]):
        if words and words[-1].partition("=")[0] in LISTS and _is_number(a):
            words[-1] += f" {a}" if "=" in words[-1] else f"={a}"
        elif a == "--live" and not b.lstrip("+-").isdigit():
            words.append(f"--live={LIVE_PORT}")
        elif a == "--disturbance" and (not b or b.startswith("-")):
            words.append(f"--disturbance={DISTURBANCE_ON}")
        else:
            words.append(a)
    return words
