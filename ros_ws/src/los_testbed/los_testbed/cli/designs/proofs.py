"""Command ``los-testbed design certify``."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import Designs, Uncertain
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen, tell, warn
from pointing_analysis.formatting.number_text import ABSENT, at_least, at_most
from pointing_analysis.formatting.tables import TextTable, numbers, texts

if TYPE_CHECKING:
    from los_design.verification.certify import FigureBounds

CERTIFY_EXAMPLES = """Prove the figures of a pair of controllers for the whole box of parameters and all frequencies.

Writes a proof STAGE-FIGURE.npz for each proven figure, bounds.json, and bundle.zip: the proofs with controllers and
telescope, for `design check-proof`. Proven parts are stored: the same command resumes after an interrupt, and another
level starts from those that hold for it. The exit code is 7 if a figure is violated, 8 if one is not fully proven.

**Examples**

    los-testbed design certify --output proofs                     # the shipped pair, below its limits

    los-testbed design certify --designs designs/soft --output soft-proofs

    los-testbed design certify --output proofs --stage fsm+pma --figure slow --gap 0.05

    los-testbed design certify --output proofs --stage fsm+pma --figure "sensitivity, mirror"   # a disk margin

    los-testbed design certify --output proofs --uncertain isolator.stiffness=10% --figure slow

    los-testbed design certify --output proofs --scheduler tcp://host:8786    # its workers prove the parts
"""


@with_cluster
def design_certify(
    *,
    output: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the proofs.")],
    designs: Designs = None,
    level: Annotated[float, typer.Option(help="Fraction of the limit to be proven.")] = 1.0,
    gap: Annotated[
        float | None, typer.Option(help="Prove a level this fraction above the largest known value instead, e.g. 0.05.")
    ] = None,
    stage: Annotated[str | None, typer.Option(help="fsm or fsm+pma. Default: both.")] = None,
    figure: Annotated[
        str | None,
        typer.Option(
            help="A gain of the table of figures: APE, slow, fast, mirror, force (default: all of them); a margin as "
            "`sensitivity, mirror`, noise, or a part of the fast tones' band as `fast, 85 to 126`."
        ),
    ] = None,
    uncertain: Uncertain = None,
    time_limit: Annotated[float, typer.Option(help="Wall-clock limit [s]; run again to resume.")] = 10800.0,
    cluster: Cluster,
    json_: Json = False,
) -> None:
    """See CERTIFY_EXAMPLES."""
    from los_testbed.api.designs import certify

    number("--level", level, 1e-6, 1e6)
    number("--time-limit", time_limit, 1.0, 1e7, "s")
    if gap is not None:
        number("--gap", gap, 1e-3, 10.0)
    with cluster.workers() as pool, resume_hint("proven parts", output):
        bounds = certify(
            output,
            designs=designs,
            stage=stage,
            figure=figure,
            level=level,
            gap=gap,
            uncertain=uncertain or (),
            time_limit=time_limit,
            workers=pool,
            report=tell,
            warn=warn,
        )
    if json_:
        print_json({"figures": [one.to_mapping() for one in bounds]})
    else:
        show_bounds(bounds)
    leave_if_unproven(bounds)


def leave_if_unproven(figures: Sequence[FigureBounds]) -> None:
    """End the command with the code of a figure that is violated, or not proven."""
    others = {bounds.status for bounds in figures} - {"proven"}
    if others:
        raise typer.Exit(ExitCode.NOT_MET if "violated" in others else ExitCode.NOT_DEMONSTRATED)


def show_bounds(figures: Sequence[FigureBounds]) -> None:
    """Table of bounds, and the figures not proven."""
    bounds = numbers("lower", "upper", "at rad/s")
    heads = (*texts("stage", "figure"), *bounds, *texts("status", "stable"), *numbers("strips", "CPU s"))
    rows = []
    for b in figures:
        upper, stable = (at_most(b.upper) if math.isfinite(b.upper) else ABSENT), ("all" if b.stable else "")
        work = (f"{b.strips}", f"{b.seconds:.0f}")
        rows.append((b.stage, b.figure, at_least(b.lower), upper, f"{b.frequency:.5g}", b.status, stable, *work))
    Screen().print(on_screen(TextTable.of(heads, rows, "Bounds over the whole box (1 is the limit)")))
    for b in figures:
        if b.status == "violated":
            values = ", ".join(f"{name} {value:.5g}" for name, value in b.point.items())
            sys.stderr.write(
                f"{b.stage}, {b.figure}: {at_least(b.lower)} of the limit at {b.frequency:.6g} rad/s, {values}\n"
            )
        elif b.status == "unstable":
            sys.stderr.write(f"{b.stage}, {b.figure}: the nominal loop is not proven stable\n")
        elif b.uncovered:
            low, high = b.uncovered[0]
            sys.stderr.write(
                f"{b.stage}, {b.figure}: {len(b.uncovered)} parts not covered, first {low:.6g} to {high:.6g} rad/s\n"
            )
