"""Command line ``los-testbed``: run, analyse, report, replay, stages, bag, plant, design."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from los_testbed.bags.writer import check_new_bag
from los_testbed.cli.design import design_app
from los_testbed.cli.plant import plant_app
from los_testbed.cli.replay import REPLAY_EXAMPLES, replay
from los_testbed.cli.report import REPORT_EXAMPLES, report
from los_testbed.cli.stages import STAGES_EXAMPLES, stages
from los_testbed.config import RunConfig, parse_value, read_yaml
from los_testbed.factories import check_controllers
from los_testbed.loop.simulate import LoopDivergedError
from los_testbed.run.runner import Results
from los_testbed.variants import check_ranges, chosen_member, layered

RESTARTED = 3
"""Exit code of a run that was finished although a node died and had to be started again."""

app = typer.Typer(
    name="los-testbed",
    help="Testbed for fine line-of-sight control of a flexible space telescope.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
)

RUN_EXAMPLES = """Run the loop, record it, judge it.

**Examples**

    los-testbed run                                    # 10 s on ROS 2 in real time, all loops closed

    los-testbed run --loop isolator --seed 3           # the same telescope without control

    los-testbed run --mode inprocess --duration 60     # one process, no ROS, as fast as it goes

    los-testbed run --only plant                       # this host runs the plant, others the rest

    los-testbed run --theta 1.57 --wheel-speed 200 -210 220 -230    # arrays a quarter turn round

    los-testbed run --case worst                       # a named telescope of the family; or --sample 7, a random one

    los-testbed run --k-fsm my_observer.json --set camera_dropout=0.1
"""

REPAIR_EXAMPLES = """Make a readable bag from one whose recorder was killed or whose file is damaged.

**Example**

    los-testbed bag repair bags/run-20260101-120000
"""

ANALYSE_EXAMPLES = """Judge recorded runs and write an HTML report.

**Examples**

    los-testbed analyse bags/run-20260101-120000

    los-testbed analyse bags/isolator bags/fsm+pma --report comparison.html --json
"""


@app.command(help=RUN_EXAMPLES)
def run(
    duration: Annotated[str | None, typer.Option(metavar="SECONDS", help="Length of the run [s].")] = None,
    mode: Annotated[str | None, typer.Option(help="realtime, lockstep or inprocess.")] = None,
    loop: Annotated[str | None, typer.Option(help="none, isolator, fsm or fsm+pma.")] = None,
    scenario: Annotated[str | None, typer.Option(help="design or imbalance.")] = None,
    seed: Annotated[str | None, typer.Option(metavar="INTEGER", help="Seed of noise and disturbance phases.")] = None,
    noise: Annotated[bool | None, typer.Option("--noise/--no-noise", help="Sensor noise.")] = None,
    disturbance: Annotated[
        bool | None, typer.Option("--disturbance/--no-disturbance", help="Wheels and array drive.")
    ] = None,
    camera_rate: Annotated[
        str | None, typer.Option(metavar="HERTZ", help="Frames per second; divides 1000 [Hz].")
    ] = None,
    k_fsm: Annotated[str | None, typer.Option(help="Observer file instead of the one that ships.")] = None,
    k_pma: Annotated[str | None, typer.Option(help="Proof-mass controller file.")] = None,
    output: Annotated[str | None, typer.Option(help="Folder of the bag; must be new.")] = None,
    domain: Annotated[str | None, typer.Option(metavar="INTEGER", help="ROS domain.")] = None,
    theta: Annotated[str | None, typer.Option(metavar="RADIANS", help="Angle of both solar arrays [rad].")] = None,
    tau: Annotated[str | None, typer.Option(metavar="NUMBER", help="tan(theta/4), in the place of theta.")] = None,
    wheel_speed: Annotated[
        tuple[float, float, float, float] | None, typer.Option(help="Speeds of the four wheels [rad/s].")
    ] = None,
    omega_1: Annotated[str | None, typer.Option(metavar="RAD/S", help="First frequency of the arrays.")] = None,
    omega_2: Annotated[str | None, typer.Option(metavar="RAD/S", help="Second frequency of the arrays.")] = None,
    theta_rate: Annotated[str | None, typer.Option(metavar="RAD/S", help="Rate of the arrays during the ramp.")] = None,
    wheel_acceleration: Annotated[
        tuple[float, float, float, float] | None, typer.Option(help="Of the four wheels during the ramp [rad/s2].")
    ] = None,
    ramp_duration: Annotated[str | None, typer.Option(metavar="SECONDS", help="How long the ramp lasts [s].")] = None,
    sample: Annotated[str | None, typer.Option(metavar="SEED", help="A random telescope of the family.")] = None,
    case: Annotated[str | None, typer.Option(metavar="NAME", help="A named case: los-testbed plant cases.")] = None,
    cases: Annotated[Path | None, typer.Option(help="YAML file of named cases of your own.")] = None,
    parameters: Annotated[str | None, typer.Option(metavar="FILE", help="Parameter file of your telescope.")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with any of the parameters.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Any other parameter; repeatable.")
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            help="Run this node alone, for a loop over several hosts: plant, estimator, controller, recorder."
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write the HTML report.")] = True,
    json_: Annotated[bool, typer.Option("--json", help="Last line of output is one JSON object.")] = False,
) -> None:
    """See RUN_EXAMPLES."""
    given = {
        "duration": duration, "mode": mode, "loop": loop, "scenario": scenario, "seed": seed, "noise": noise,
        "disturbance": disturbance, "camera_rate": camera_rate, "k_fsm": k_fsm, "k_pma": k_pma,
        "output": output, "domain": domain, "theta": theta, "tau": tau, "wheel_speed": wheel_speed,
        "omega_1": omega_1, "omega_2": omega_2, "theta_rate": theta_rate, "wheel_acceleration": wheel_acceleration,
        "ramp_duration": ramp_duration, "parameters": parameters,
    }  # fmt: skip
    from los_testbed.run.summary import judge, show

    chosen = configure(config, settings or [], given, case=case, cases=cases, sample=sample)
    if only is not None:
        from los_testbed.run.runner import run_alone

        raise typer.Exit(run_alone(only, chosen))
    console = Console(stderr=json_)
    bag, results = execute(chosen, console)
    warnings, failures, interrupted = results.warnings, results.failures, results.interrupted
    for warning in [*warnings, *failures]:
        console.print(f"[yellow]warning:[/yellow] {warning}")
    judgement = judge([bag], bag / "report.html" if report else None)
    show(console, judgement)
    if json_:
        print_json(judgement.runs[0])
    if interrupted or failures:
        raise typer.Exit(130 if interrupted else RESTARTED)


@app.command(help=ANALYSE_EXAMPLES)
def analyse(
    bags: Annotated[list[Path], typer.Argument(help="Bags: folders or .mcap files.")],
    report: Annotated[Path | None, typer.Option(help="HTML file to write.")] = None,
    transient: Annotated[float | None, typer.Option(help="Seconds to leave out at the start.")] = None,
    json_: Annotated[bool, typer.Option("--json", help="Last line of output is one JSON object.")] = False,
) -> None:
    """See ANALYSE_EXAMPLES."""
    from los_testbed.run.summary import judge, show

    target = report
    if target is None and len(bags) == 1 and bags[0].is_dir():
        target = bags[0] / "report.html"
    judgement = judge(bags, target, transient)
    show(Console(stderr=json_), judgement)
    if json_:
        print_json(judgement.runs[0] if len(bags) == 1 else {"runs": list(judgement.runs)})


bag_app = typer.Typer(help="Look after recorded runs.", no_args_is_help=True, rich_markup_mode="markdown")
app.command(name="report", help=REPORT_EXAMPLES)(report)
app.command(name="replay", help=REPLAY_EXAMPLES)(replay)
app.command(name="stages", help=STAGES_EXAMPLES)(stages)
app.add_typer(bag_app, name="bag")
app.add_typer(plant_app, name="plant")
app.add_typer(design_app, name="design")


@bag_app.callback()
def bag_group() -> None:
    """Look after recorded runs."""


@bag_app.command(help=REPAIR_EXAMPLES)
def repair(
    source: Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")],
    output: Annotated[Path | None, typer.Option(help="New bag; default: the old name with -repaired.")] = None,
) -> None:
    """See REPAIR_EXAMPLES."""
    from los_testbed.bags.repair import repair_bag

    target = output or source.with_name(f"{source.stem if source.is_file() else source.name}-repaired")
    found = repair_bag(source, target)
    console = Console()
    console.print(f"{found.messages} messages in {found.chunks} chunks", soft_wrap=True)
    for offset, reason in found.damaged:
        console.print(f"chunk at byte {offset}: {reason}; its messages are lost", soft_wrap=True)
    if found.cut_at is not None:
        console.print(f"the file is cut at byte {found.cut_at}: up to a second of data is missing", soft_wrap=True)
    console.print(f"bag     {target}", soft_wrap=True)


def configure(
    file: Path | None,
    settings: list[str],
    given: dict[str, Any],
    *,
    case: str | None = None,
    cases: Path | None = None,
    sample: str | None = None,
) -> RunConfig:
    """Configuration from file, named case, random member, ``--set`` and options; the later ones win.

    Raises
    ------
    ValueError
        Unknown names, values that do not fit.
    """
    first: dict[str, Any] = read_yaml(file) if file is not None else {}
    stated: dict[str, Any] = {}
    for setting in settings:
        name, sign, text = setting.partition("=")
        if not sign:
            raise ValueError(f"--set expects NAME=VALUE, got {setting!r}")
        stated[name] = parse_value(name, text)
    options = {name: parse_value(name, v) if isinstance(v, str) else v for name, v in given.items() if v is not None}
    named, drawn = chosen_member(case, cases, sample, first, layered(stated, options))
    chosen = RunConfig.from_mapping(layered(first, named, drawn, stated, options))
    if not chosen.output:
        chosen = replace(chosen, output=str(new_bag(chosen)))
    return chosen


def new_bag(config: RunConfig) -> Path:
    """Name for a bag that is not there yet, under bags/."""
    stem = f"{datetime.now():%Y%m%d-%H%M%S}-{config.mode}-{config.loop}"
    folder = Path("bags")
    names = (folder / (stem if i == 0 else f"{stem}-{i}") for i in range(1000))
    return next(name for name in names if not name.exists())


def check(config: RunConfig) -> tuple[str, ...]:
    """Refuse what can be refused before anything is started or written; warnings about the controllers.

    Raises
    ------
    ValueError
        A bag that exists, a telescope outside the family, a file that is no controller, ROS missing.
    """
    check_new_bag(Path(config.output))
    check_ranges(config)
    warnings = check_controllers(config)
    if config.mode != "inprocess":
        from los_testbed.run.runner import check_ros

        check_ros()
    return warnings


def execute(config: RunConfig, console: Console) -> tuple[Path, Results]:
    """Run, with a progress bar; the bag and what happened."""
    said = check(config)
    for warning in said:
        sys.stderr.write(f"warning: {warning}\n")
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} ms"),
        TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"{config.loop}, {config.mode}", total=config.ticks)

        def progress(ticks: int) -> None:
            bar.update(task, completed=ticks)

        if config.mode == "inprocess":
            from los_testbed.loop.simulate import run_in_process

            path = Path(config.output)
            run_in_process(config, path, progress=progress)
            return path, Results(bag=path)
        from los_testbed.run.runner import Runner

        results = Runner(replace(config, wait_for_recorder=True), progress).run()
    if results.bag is None:
        raise KeyboardInterrupt
    results.warnings = [warning for warning in results.warnings if warning not in said]
    return results.bag, results


def print_json(content: dict[str, Any]) -> None:
    """One JSON object on one line of the output."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Entry point: mistakes are one line on the error output and exit code 2, failures 1."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    signal.signal(signal.SIGTERM, _interrupt)
    command: Callable[..., Any] = typer.main.get_command(app)
    try:
        result = command(args=arguments, prog_name="los-testbed", standalone_mode=False)
    except typer.Exit as stop:
        code: int = stop.exit_code
        return _leave(code)
    except typer.Abort:
        return _leave(130)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except ValueError as error:
        return _fail(str(error), 2)
    except (LoopDivergedError, OSError) as error:
        return _fail(str(error), 1)
    except RuntimeError as error:
        return _fail(str(error), int(getattr(error, "code", 1)))
    except Exception as error:
        if type(error).__module__.startswith(("click", "typer")) and hasattr(error, "format_message"):
            return _fail(error.format_message(), 2)
        raise
    return _leave(result if isinstance(result, int) else 0)


def _leave(code: int) -> int:
    if code:
        sys.exit(code)
    return 0


def _fail(message: str, code: int) -> int:
    sys.stderr.write(f"los-testbed: {' '.join(message.split())}\n")
    sys.exit(code)


if __name__ == "__main__":
    main()
