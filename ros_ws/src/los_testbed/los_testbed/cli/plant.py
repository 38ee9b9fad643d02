"""Command group ``los-testbed plant``: the telescope's model in numbers and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table as ScreenTable

from los_testbed.cli.options.options import TelescopeFile
from los_testbed.config.cases import named_cases, telescope_cases
from los_testbed.config.members import check_ranges
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import Screen, on_screen
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import TextTable, numbers
from titop_plant.interface import FORCE_STAGES, K_PMA_OUTPUTS

if TYPE_CHECKING:
    from titop_plant.telescope.summary import PlantSummary

PLANT_EXAMPLES = """The telescope's model: order, parameters, poles, inertia, bodies.

**Examples**

    los-testbed plant                                  # the reference telescope

    los-testbed plant --json                           # one JSON object

    los-testbed plant --parameters my_telescope.toml   # your own

    los-testbed plant figures --output pictures        # disturbances to line of sight, PNG and SVG
"""

CHECK_EXAMPLES = """Check a parameter file: loop, mass properties, modes, and what differs from its base.

**Examples**

    los-testbed plant check my_telescope.toml

    los-testbed plant check my_telescope.toml --output pictures    # also responses to the line of sight
"""

FIGURES_EXAMPLES = """Draw the responses from wheels and array drives to the line of sight.

**Example**

    los-testbed plant figures --output pictures
"""

CASES_EXAMPLES = """List the named telescopes of `los-testbed run --case NAME`.

**Example**

    los-testbed plant cases
"""

ROWS_EXAMPLES = """Write tables of a parameter file with all their values, as one that stands alone has them.

**Examples**

    los-testbed plant rows > my_telescope.toml              # the reference, with the sources of its values

    los-testbed plant rows sensors camera >> mine.toml      # what a file lacks

    los-testbed plant rows --parameters my_telescope.toml   # with what it takes from its base
"""

EXPORT_EXAMPLES = """Write the assembled telescope as an uncertain system with named ports.

A parameter file with a table `[plant]` and `file = "FILE"` uses it, or one of your own, in place of the assembly.

**Examples**

    los-testbed plant export --output telescope.mat

    los-testbed plant export --output mine.json --parameters my_telescope.toml --loads
"""

plant_app = typer.Typer(rich_markup_mode="markdown")


@plant_app.callback(invoke_without_command=True, help=PLANT_EXAMPLES)
def plant(
    context: typer.Context,
    parameters: Annotated[
        str, typer.Option(metavar="FILE", help="Parameter file; default: the reference telescope.")
    ] = "",
    json_: Json = False,
) -> None:
    """See PLANT_EXAMPLES."""
    if context.invoked_subcommand is not None:
        context.obj = parameters
        return
    from lftkit.support.threads import one_thread
    from titop_plant.telescope.load import load_telescope
    from titop_plant.telescope.summary import summarise

    with one_thread():
        summary = summarise(load_telescope(parameters))
    if json_:
        print_json(summary.to_mapping())
    else:
        show(Screen(), summary)


@plant_app.command(help=FIGURES_EXAMPLES)
def figures(
    context: typer.Context,
    output: Annotated[Path, typer.Option(help="Folder for the figures.")] = Path("figures"),
    parameters: TelescopeFile = None,
) -> None:
    """See FIGURES_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from los_design.figures.plant_figures import draw_figures

    check_output(output, "--output", folder=True)
    from lftkit.support.progress import Progress
    from lftkit.support.threads import one_thread

    with one_thread(), Progress("figures"):
        paths = draw_figures(output, str(parameters) if parameters else context.obj or None)
    console = Screen()
    for path in paths:
        console.print(str(path), soft_wrap=True, highlight=False)


@plant_app.command(help=CHECK_EXAMPLES)
def check(
    file: Annotated[Path, typer.Argument(help="Parameter file of your telescope.")],
    output: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for figures; default: none.")] = None,
    json_: Json = False,
) -> None:
    """See CHECK_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from lftkit.support.threads import one_thread
    from los_testbed.config.run_config import RunConfig
    from los_testbed.parts.run_parts import RunParts
    from titop_plant.interface import DT
    from titop_plant.telescope.load import base_of, difference_counts, difference_summary, load_telescope
    from titop_plant.telescope.summary import summarise

    if output is not None:
        check_output(output, "--output", folder=True)
    telescope, changed = load_telescope(file), difference_counts(file)
    config = RunConfig(parameters=str(file), mode="inprocess", loop="none", duration=DT)
    _ = RunParts(config).sources  # one that cannot be used is refused
    with one_thread():
        summary = summarise(telescope)
    # Stages, sensors, actuators, requirements and own disturbances of a telescope, in words
    ports = telescope.loop_ports
    forces = K_PMA_OUTPUTS if telescope.stages[-1] not in FORCE_STAGES else ()
    driven = [port for port in ports.commanded if port not in forces]
    measured, commanded = (", ".join(f"{p.name}[{p.size}]" for p in side) for side in (ports.measured, driven))
    loop = {
        "stages": ", ".join(telescope.stages),
        "sensors": measured,
        "actuators": commanded,
        "wheels": ", ".join(wheel.name for wheel in telescope.wheels),
        "arrays": ", ".join(array.name for array in telescope.solar_arrays) or "none",
        "disturbances": ", ".join(str(table.get("name", "unnamed")) for table in telescope.sources)
        or "none of the file",
        "requirements": "; ".join(telescope.requirement_texts) or "none",
    }
    console = Screen(stderr=json_)
    for name, text in loop.items():
        console.print(f"{name:<14}{text}", highlight=False)
    show(console, summary)
    for line in difference_summary(file) or ["no value differs" if base_of(file) else "none: the file stands alone"]:
        console.print(f"{'base':<14}{line}", highlight=False)
    pictures: list[Path] = []
    if output is not None:
        from lftkit.support.progress import Progress
        from los_design.figures.plant_figures import draw_figures

        with one_thread(), Progress("figures"):
            pictures = draw_figures(output, str(file))
        for path in pictures:
            console.print(str(path), soft_wrap=True, highlight=False)
    if json_:
        further = {"loop": loop, "changed": {name: counts._asdict() for name, counts in changed.items()}}
        print_json({**summary.to_mapping(), **further, "figures": [str(path) for path in pictures]})


@plant_app.command(help=ROWS_EXAMPLES)
def rows(
    tables: Annotated[
        list[str] | None, typer.Argument(metavar="[TABLE]...", help="Names of tables; default: all of them.")
    ] = None,
    parameters: TelescopeFile = None,
) -> None:
    """See ROWS_EXAMPLES."""
    from titop_plant.telescope.standalone import standalone

    typer.echo(standalone(parameters, tables or ()), nl=False)


@plant_app.command(help=EXPORT_EXAMPLES)
def export(
    output: Annotated[Path, typer.Option(metavar="FILE", help="New file, .mat or .json.")],
    parameters: TelescopeFile = None,
    loads: Annotated[
        bool, typer.Option("--loads", help="With an input load_NODE at each node where a source can act.")
    ] = False,
) -> None:
    """See EXPORT_EXAMPLES."""
    from lftkit import write_mat, write_system
    from lftkit.support.atomic_output import check_output
    from lftkit.support.threads import one_thread
    from titop_plant.telescope.assembly import build_telescope
    from titop_plant.telescope.load import load_telescope

    check_output(output, "--output", new=True, suffixes=(".mat", ".json"))
    telescope = load_telescope(parameters)
    with one_thread():
        system = build_telescope(telescope, loads=telescope.loaded_nodes if loads else ()).system
    if output.suffix.lower() == ".json":
        write_system(output, system)
    else:
        write_mat(output, P=system)
    Screen().print(f"{output}: order {system.order}, {len(system.channels)} channels of Delta", highlight=False)


@plant_app.command(help=CASES_EXAMPLES)
def cases(
    parameters: TelescopeFile = None,
    file: Annotated[Path | None, typer.Option(help="YAML file of cases of your own.")] = None,
) -> None:
    """See CASES_EXAMPLES."""
    from los_testbed.config.run_config import RunConfig
    from titop_plant.telescope.load import load_telescope

    rows = []
    telescope = load_telescope(parameters)
    for name, settings in (telescope_cases(telescope) if file is None else named_cases(file)).items():
        if isinstance(settings, str):
            rows.append((name, f"not of this telescope: {settings}"))
            continue
        member_settings = {key: value for key, value in settings.items() if key != "description"}
        member = RunConfig.from_mapping({"loop": telescope.stages[-1], **member_settings})
        check_ranges(member, load_telescope(member.parameters) if member.parameters else telescope)
        rows.append((name, str(settings.get("description", member_settings))))
    Screen().print(on_screen(TextTable.of(("case", "telescope"), rows)))


def show(console: Console, summary: PlantSummary) -> None:
    """Print a model's properties as tables."""
    stable = "all poles in the left half plane" if summary.hurwitz else "not stable"
    console.print(f"order {summary.order}, {stable}; slowest pole {summary.slowest_pole:.3g} rad/s", highlight=False)
    if summary.bodies:
        inertia = ", ".join(f"{x:.0f}" for x in summary.to_mapping()["total_inertia"])
        centre = ", ".join(f"{x:.3f}" for x in summary.centre_of_mass)
        console.print(f"mass {summary.mass:.1f} kg, centre of mass at {centre} m from G", highlight=False)
        console.print(f"total inertia about x, y, z: {inertia} kg m2", highlight=False)
    console.print(
        _table("parameters", ("parameter", "Delta", "nominal", "range", "unit", "role"), _parameters(summary))
    )
    heads = ("body", "mass [kg]", "modes", "clamped at [rad/s]", "smallest residual mass")
    if summary.bodies:
        console.print(_table("bodies", heads, _bodies(summary)))
    if summary.mechanisms:
        rotors = ("rotor", "at rest [rad/s]", "at the default speed [rad/s]")
        rows: list[tuple[Any, ...]] = [(mode.name, mode.at_rest, mode.at_speed) for mode in summary.mechanisms]
        console.print(_table("modes of rotors, their mounts held", rotors, rows))


def _table(title: str, heads: tuple[str, ...], rows: list[tuple[Any, ...]]) -> ScreenTable:
    cells = [tuple(digits(x, 4) if isinstance(x, float) else str(x) for x in row) for row in rows]
    return on_screen(TextTable.of((heads[0], *numbers(*heads[1:])), cells, title), whole=heads[:1])


def _parameters(summary: PlantSummary) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for p in summary.parameters:
        span = f"{digits(p.lower, 4)} .. {digits(p.upper, 4)}"
        rows.append((p.name, summary.occurrences[p.name], p.nominal, span, p.in_unit.strip(), summary.roles[p.name]))
    return rows


def _bodies(summary: PlantSummary) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for b in summary.bodies:
        span = f"{b.frequencies[0]:.4g} .. {b.frequencies[1]:.4g}" if b.modes else "rigid"
        fraction = b.min_residual_fraction if abs(b.min_residual_fraction) > 1e-9 else 0.0  # rounding
        rows.append((b.name, b.mass, b.modes, span, f"{100.0 * fraction:.2g} %"))
    return rows
