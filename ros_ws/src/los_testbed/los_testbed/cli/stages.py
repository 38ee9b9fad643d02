"""Command ``los-testbed stages``: the four loop stages in one table and one report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.progress import Progress
from los_testbed.cli.command_group import HelpAll
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.options import Case, Cases, Designs, NewFolder, chosen, with_settings
from los_testbed.config.run_settings import SIMULATED
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen, say, warn

if TYPE_CHECKING:
    from los_testbed.run.stages import Plan, StageResult, StageRun

STAGES_EXAMPLES = """Compare the four stages: none, isolator, fsm, fsm+pma.

All stages have the same seed and disturbance and several members of the family; disturbance and sensor noise also act
alone, and transmissibilities are compared with the model's. In the scenario worst_case each stage has its own worst
parameters and tones. Writes stages.md, stages.json and one report per scenario. Run the same command again to resume
after an interrupt: in-process runs with a bag are not repeated (with --keep-all no run is).

**Examples**

    los-testbed stages                                       # worst_case and imbalance; some minutes

    los-testbed stages --scenario worst_case --json

    los-testbed stages --scenario design --samples 1 --no-parts

    los-testbed stages --case spin_up                        # all wheels from 30 to 1000 rad/s; --no-parts is shorter

    los-testbed stages --k-fsm my_observer.json --duration 30

    los-testbed stages --mode realtime --samples 1 --no-parts     # on ROS 2, in real time
"""


@with_settings(
    [*(name for name in SIMULATED if name not in ("loop", "noise", "disturbance")), "seed", "mode"],
    helps={
        "scenario": "worst_case, unit_norm, design, imbalance, ramp, or both (worst_case and imbalance); default: the "
        "case's, or both.",
        "mode": "inprocess, lockstep or realtime; default: inprocess.",
    },
)
def stages(
    *,
    given: dict[str, Any],
    samples: Annotated[
        int | None,
        typer.Option(help="Number of telescopes: nominal and random members; default: 3, or 1 with --case or a ramp."),
    ] = None,
    designs: Designs = None,
    case: Case = None,
    cases: Cases = None,
    parts: Annotated[
        bool, typer.Option("--parts/--no-parts", help="Also run disturbance alone and noise alone.")
    ] = True,
    keep_all: Annotated[bool, typer.Option("--keep-all", help="Keep the bags of all runs.")] = False,
    output: NewFolder = None,
    json_: Json = False,
    help_all: HelpAll = False,
) -> None:
    """See STAGES_EXAMPLES."""
    from los_testbed.bags.writer import check_new_bag
    from los_testbed.config.run_config import RunConfig
    from los_testbed.config.run_settings import chosen_member, layered, of_designs
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.run.processes.node_launch import check_ros
    from los_testbed.run.stages import COMPARED, MOVING, PARTS, PLAN, Plan, finish
    from titop_plant.interface import SCENARIOS

    if samples is not None:
        number("--samples", samples, 1, 100)
    settings = layered(of_designs(designs or ""), chosen_member(case, cases, None, {}, {})[0], chosen(given))
    scenario = settings.pop("scenario", "both")
    if scenario not in (*SCENARIOS, "both"):
        raise InputError(f"scenario must be one of {', '.join(SCENARIOS)}, both, got {scenario!r}")
    base = RunConfig.from_mapping({"mode": "inprocess", **settings})
    folder = output or Path("bags") / f"{datetime.now():%Y%m%d-%H%M%S}-stages"
    if not (folder / PLAN).exists():
        check_new_bag(folder)
    warn(RunParts(base).check())
    if base.mode != "inprocess":
        check_ros(base.domain)
    names = COMPARED if scenario == "both" else (scenario,)
    count = samples or (1 if case or MOVING in names else 3)
    plan = Plan(base, folder, names, count, tuple(PARTS) if parts else ("all",), keep_all, designs or "")
    with resume_hint("bags of finished runs", folder):
        content = _write(Screen(stderr=json_), _perform(plan), plan)
        finish(plan)
    if json_:
        print_json(content)


def _perform(plan: Plan) -> tuple[StageResult, ...]:
    """The runs of a plan, with a progress bar."""
    from los_testbed.run.stages import perform

    with Progress("stages") as bar:
        runs, each = plan.runs, plan.base.ticks
        index = {run.name: i for i, run in enumerate(runs)}

        def progress(run: StageRun, ticks: int) -> None:
            bar.report(index[run.name] * each + ticks, len(runs) * each, what=f"{run.name} [ticks]")

        return perform(plan, progress)


def _write(console: Console, results: Sequence[StageResult], plan: Plan) -> dict[str, Any]:
    """Tables, files and reports."""
    from los_testbed.run import stages_tables

    for table in stages_tables.screen(results, plan):
        console.print(on_screen(table))
    for result in results:
        if result.note:
            say(console, f"{result.run.name}: {result.note}", "note")
    content = stages_tables.as_json(results, plan)
    write_text(plan.folder / "stages.md", stages_tables.markdown(results, plan))
    with Progress("reports"):
        content["reports"] = [str(path) for path in _reports(results, plan)]
    write_text(plan.folder / "stages.json", json.dumps(content, indent=1) + "\n")
    for path in (plan.folder / "stages.md", plan.folder / "stages.json", *content["reports"]):
        say(console, str(path))
    return content


def _reports(results: Sequence[StageResult], plan: Plan) -> list[Path]:
    """One report per scenario: the stages side by side, the model beside the measured lines."""
    from los_testbed.run.stages import REPORTED, WORST, select
    from los_testbed.run.summary.summary import judged
    from pointing_analysis.read.run import Run
    from pointing_analysis.report.outputs import ReportOutputs
    from pointing_analysis.report.report import labels

    paths = []
    for scenario in plan.scenarios:
        shown = REPORTED if scenario == WORST else "nominal"
        kept = [select(results, scenario, loop, "all")[shown].bag for loop in plan.stages]
        runs = [Run.open(bag) for bag in kept if bag is not None]
        lines = {}
        for run, label in zip(runs, labels(runs)):
            alone = select(results, scenario, str(run.parameters["loop"]), "disturbance").get(shown)
            if alone is not None and alone.tones:
                lines[label] = alone.model()
        if runs:
            page = plan.folder / f"report-{scenario}.html"
            judged(runs, None, None).write_page(ReportOutputs(page), lines=lines)
            paths.append(page)
    return paths
