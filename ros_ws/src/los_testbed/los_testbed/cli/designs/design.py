"""Command group ``los-testbed design``: make, compare, draw and check the implemented controllers."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.support.progress import Progress
from los_testbed.cli.designs.redesign import ALL_EXAMPLES, design_all
from los_testbed.cli.designs.verify import VERIFY_EXAMPLES, verify
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.options import Designs, DesignSeed, TelescopeFile
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, met, on_screen, tell, warn
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from titop_plant.interface import LOOP_DELAY

if TYPE_CHECKING:
    from lftkit import SampledSystem
    from los_design.synthesis.options import DesignOptions

MAKE_EXAMPLES = """Tune {what} and write it to a file; a shipped design is never overwritten.

After an interrupt or its time limit, the same command resumes in its descent or after its last search.

**Examples**

    los-testbed design {kind} --output mine.json                   # as implemented, for the whole box of parameters

    los-testbed design {kind} --output mine.json --nominal         # for the nominal model only

    los-testbed design {kind} --output mine.json --loop-delay 0    # the paper's continuous problem

    los-testbed design {kind} --output mine.json --loop-delay 0 --order 2

    los-testbed design {kind} --output mine.json --time-limit 60

    los-testbed design {kind} --parameters mine.toml --output mine.json      # for your telescope
{more}"""

WITH_OBSERVER = """
    los-testbed design k-pma --k-fsm mine_observer.json --output mine.json  # on this observer
"""

MAX_ORDER = 8

design_app = typer.Typer(rich_markup_mode="markdown", no_args_is_help=True, help="Make and check the controllers.")

Nominal = Annotated[bool, typer.Option("--nominal", help="Tune for the nominal model only.")]
Delay = Annotated[float, typer.Option(help="Delay of the loop [s]; 0: the paper's continuous problem.")]
Limit = Annotated[float, typer.Option(help="Wall-clock limit [s].")]
Starts = Annotated[int, typer.Option(help="Random starts, with --loop-delay 0.")]
Order = Annotated[int, typer.Option(help="Order of the controller; other than 4 with --loop-delay 0 only.")]
Output = Annotated[Path | None, typer.Option(help="File to write; must be given.")]


@design_app.command("k-fsm", help=MAKE_EXAMPLES.format(what="the observer K_FSM", kind="k-fsm", more=""))
def k_fsm(
    nominal: Nominal = False,
    loop_delay: Delay = LOOP_DELAY,
    time_limit: Limit = 1800.0,
    seed: DesignSeed = 0,
    order: Order = 4,
    parameters: TelescopeFile = None,
    output: Output = None,
    json_: Json = False,
) -> None:
    """See MAKE_EXAMPLES."""
    _make("k-fsm", _options(nominal, loop_delay, time_limit, seed, 1, order), parameters, None, output, json_)


@design_app.command(
    "k-pma", help=MAKE_EXAMPLES.format(what="the proof-mass law K_PMA", kind="k-pma", more=WITH_OBSERVER)
)
def k_pma(
    nominal: Nominal = False,
    loop_delay: Delay = LOOP_DELAY,
    time_limit: Limit = 1800.0,
    seed: DesignSeed = 0,
    starts: Starts = 8,
    order: Order = 4,
    parameters: TelescopeFile = None,
    k_fsm: Annotated[Path | None, typer.Option(metavar="FILE", help="Observer; default: the stored design.")] = None,
    output: Output = None,
    json_: Json = False,
) -> None:
    """See MAKE_EXAMPLES."""
    _make("k-pma", _options(nominal, loop_delay, time_limit, seed, starts, order), parameters, k_fsm, output, json_)


def _options(nominal: bool, loop_delay: float, time_limit: float, seed: int, starts: int, order: int) -> DesignOptions:
    from los_design.synthesis.options import DesignOptions

    number("--loop-delay", loop_delay, 0.0, 1.0, "s")
    number("--seed", seed, 0, 2**31 - 1)
    number("--starts", starts, 1, 10_000)
    number("--order", order, 0, MAX_ORDER)
    number("--time-limit", time_limit, 1e-3, 1e7, "s")
    return DesignOptions(
        nominal=nominal,
        loop_delay=loop_delay,
        wall_limit=time_limit,
        seed=seed,
        starts=starts,
        order=order,
        progress=True,
    )


def _make(
    kind: str, options: DesignOptions, file: Path | None, observer: Path | None, output: Path | None, json_: bool
) -> None:
    from lftkit import SampledSystem
    from lftkit.support.atomic_output import check_output
    from lftkit.support.job import Job
    from lftkit.support.threads import one_thread
    from los_design.files import ROUNDS
    from los_design.folder import refuse_shipped
    from los_design.redesign import OUT_OF_TIME
    from los_design.synthesis.provenance import law_digest
    from los_design.synthesis.store import design_file
    from los_design.synthesis.synthesis import design_actuators, design_observer
    from los_testbed.api.designs import unseen_requirements
    from titop_plant.interface import design_warnings
    from titop_plant.telescope.load import load_telescope

    path = refuse_shipped(output, "a file for the design")
    check_output(path, "--output", suffixes=(".json",))
    telescope = load_telescope(file)
    for line in unseen_requirements(telescope):
        tell(line)
    rounds = path.with_name(f"{path.stem}.{ROUNDS}")
    key = {"parameters_hash": telescope.parameters_hash, **asdict(options), "wall_limit": 0.0}
    go_on = resume_hint("rounds so far", path, state=rounds)
    with one_thread(), go_on, Progress(kind) as bar:
        if kind == "k-fsm":
            job = Job(kind, key, rounds)
            system = design_observer(telescope, options, bar.print, job)
        else:
            k_fsm = SampledSystem.from_file(observer or design_file("k-fsm", options.variant))
            warn(design_warnings([k_fsm], telescope.design_basis, closed=True))
            job = Job(kind, {**key, "k_fsm": law_digest(k_fsm)}, rounds)
            system = design_actuators(telescope, k_fsm, options, bar.print, job)
    system.to_file(path)
    if system.provenance["status"] != OUT_OF_TIME:
        job.finish()
    _show_design(system, path, json_)
    # One line for each requirement whose gamma is above 1
    provenance = system.provenance
    worst = {w["requirement"]: w["value"] for w in provenance.get("worst_cases", [])}
    values = {**provenance["tuned_values"], **worst}
    if not_met := [f"{name} {value:.4f}, must be at most 1" for name, value in values.items() if not value <= 1.0]:
        for text in not_met:
            sys.stderr.write(f"not met: {text}\n")
        raise typer.Exit(ExitCode.NOT_MET)


def _show_design(system: SampledSystem, path: Path, json_: bool) -> None:
    provenance = system.provenance
    if json_:
        shown = {key: value for key, value in provenance.items() if key not in ("continuous", "active_models")}
        print_json({"file": str(path), **shown})
        return
    title = f"{system.name}: {provenance['status']} after {provenance['seconds']} s"
    rows = []
    worst = {w["requirement"]: w for w in provenance.get("worst_cases", [])}
    for name, value in provenance["tuned_values"].items():
        peak = worst.get(name)
        row = (f"{peak['value']:.4f}", f"{peak['omega']:.4g}") if peak else ("", "")
        largest = max(value, peak["value"]) if peak else value
        rows.append((name, f"{value:.4f}", *row, met(largest <= 1.0)))
    heads = (*texts("requirement"), *numbers("tuned", "worst found", "at [rad/s]"), *texts(""))
    console = Screen()
    console.print(on_screen(TextTable.of(heads, rows, title)))
    console.print(f"written to {path}", soft_wrap=True)


design_app.command("all", help=ALL_EXAMPLES)(design_all)
design_app.command(help=VERIFY_EXAMPLES)(verify)


@design_app.command()
def table(json_: Json = False) -> None:
    """The gammas of the stored designs, each of what is tuned for."""
    from lftkit import SampledSystem
    from los_design.synthesis.store import DESIGN_PACKAGES, VARIANTS, design_file

    rows: list[dict[str, Any]] = []
    for kind in DESIGN_PACKAGES:
        for variant in VARIANTS:
            path = design_file(kind, variant)
            if not path.exists():
                continue
            provenance = SampledSystem.from_file(path).provenance
            worst = {w["requirement"]: w["value"] for w in provenance.get("worst_cases", [])}
            values = {**provenance.get("tuned_values", {}), **worst}
            rows.append({"design": kind, "variant": variant, "gammas": values, "status": provenance.get("status", "")})
    if json_:
        print_json(rows)
        return
    cells = []
    for row in rows:
        text = ", ".join(f"{name} {value:.4f}" for name, value in row["gammas"].items())
        cells.append((row["design"], row["variant"].replace("_", ", "), text, row.get("status", "")))
    shown = TextTable.of(("design", "problem", "gammas", "status"), cells, "Gammas (1 is the limit)")
    Screen().print(on_screen(shown))


@design_app.command()
def figures(
    output: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("figures"),
    samples: Annotated[int, typer.Option(help="Random parameter points in the clouds.")] = 12,
    designs: Designs = None,
) -> None:
    """Draw the stages over sampled parameters with their templates, and the controllers."""
    from lftkit.support.atomic_output import check_output
    from lftkit.support.threads import one_thread
    from los_design.figures.figures import draw

    number("--samples", samples, 0, 10_000)
    check_output(output, "--output", folder=True)
    with one_thread(), Progress("figures"):
        paths = list(draw(output, samples, designs=None if designs is None else Path(designs)))
    for path in paths:
        sys.stdout.write(f"{path}\n")
