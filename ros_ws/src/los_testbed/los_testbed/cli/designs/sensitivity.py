"""Command ``los-testbed design sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.errors import InputError
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import Screen, on_screen, warn
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from titop_plant.interface import MIRROR_STAGES

if TYPE_CHECKING:
    from los_design.search.parameter_sensitivity import ParameterEffect


def sensitivity(
    *,
    folder: Annotated[Path | None, typer.Argument(help="Folder of `design all`; default: the stored designs.")] = None,
    entry: Annotated[
        list[str] | None,
        typer.Option(metavar="TABLE.KEY", help="Entry of the parameter file, scaled by 0.99 and 1.01; repeatable."),
    ] = None,
    json_: Json = False,
) -> None:
    """Sensitivity of each worst case to the parameters: derivatives at the worst point, and one parameter at a time.

    Each parameter of the box sweeps its range with the others at the worst point of the figure. Entries of the
    parameter file change by 1 %: they are constants of the model, and no proof covers their changes. Peaks are tracked
    within 5 % of the frequency.

    Example: los-testbed design sensitivity --entry isolator.stiffness --entry isolator.damping
    """
    from lftkit.support.threads import one_thread
    from los_design.folder import load_folder
    from los_design.search.parameter_sensitivity import changed_entry, effects_of_box, effects_of_entries
    from los_design.verification.figure_proofs import loops_of
    from los_design.verification.loop_models import figures_of
    from titop_plant.telescope.load import load_telescope

    telescope = load_telescope() if folder is None else load_folder(folder)[0]
    for one in entry or ():
        changed_entry(telescope, one, 1.0)
    with one_thread():
        loops, points = loops_of(folder, MIRROR_STAGES, warn=warn)
        metrics = {stage: figures_of(telescope, stage, loop.ports) for stage, loop in loops.items()}
        points = [p for p in points if p.requirement in metrics.get(p.stage, {})]
        if not points:
            raise InputError(f"{folder} must contain worst points from `los-testbed design all`, got none")
        box = [e for p in points for e in effects_of_box(loops[p.stage], metrics[p.stage][p.requirement], p)]
        entries = effects_of_entries(list(loops.values()), metrics, points, entry or [])
    if json_:
        print_json({"box": [vars(effect) for effect in box], "entries": [vars(effect) for effect in entries]})
        return
    _show(box, "One parameter at a time, the others at the worst point", "slope, range")
    if entries:
        _show(entries, "Entries of the parameter file, plus and minus 1 %", "slope, per cent")


def _show(effects: list[ParameterEffect], title: str, slope: str) -> None:
    rows = []
    for e in effects:
        values = (f"{e.value:.4f}", f"{e.least:.4f}", f"{e.largest:.4f}", f"{100.0 * e.slope:+.2f} %")
        rows.append((f"{e.stage}, {e.figure}", e.parameter, *values))
    heads = (*texts("figure", "parameter"), *numbers("value", "least", "largest", slope))
    Screen().print(on_screen(TextTable.of(heads, rows, f"{title} (1 is the limit)")))
