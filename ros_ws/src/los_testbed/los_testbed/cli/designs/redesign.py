"""Commands of ``los-testbed design`` for folders of designs: a redesign for any telescope, and its verification."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from los_testbed.cli.designs.proofs import leave_if_unproven, show_bounds
from los_testbed.cli.designs.verification_tables import verification_tables
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import DesignSeed, TelescopeFile, Uncertain
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen, tell

if TYPE_CHECKING:
    from los_testbed.api.designs import DesignResult

ALL_EXAMPLES = """Design K_FSM and K_PMA for a telescope; find their worst points and verify them.

Writes k_fsm.json, k_pma.json, worst_points.json, verification.json and telescope.toml, with copies of the files it
refers to, into a folder. After an interrupt or the time limit, a design of the same telescope resumes in its descent or
after its last search. With --certify the proofs of all figures, bounds.json and bundle.zip follow, as from `design
certify`. The tuning does not consider the disturbance sources in the telescope's file: runs under them are judged by
its requirements and compared with runs without fine control. The exit code is 7 if a requirement is not met, 8 if a
figure is not proven.

**Examples**

    los-testbed design all --parameters soft.toml --output designs/soft

    los-testbed run --designs designs/soft                 # the telescope and its controllers

    los-testbed design verify --designs designs/soft

    los-testbed design all --output designs/mine --certify --workers 2           # designs and proofs within the hour

    los-testbed design all --output designs/mine --scheduler tcp://host:8786     # its workers search and verify
"""


@with_cluster
def design_all(
    *,
    output: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder of the designs; must be given.")] = None,
    parameters: TelescopeFile = None,
    uncertain: Uncertain = None,
    seed: DesignSeed = 0,
    effort: Annotated[str, typer.Option(help="full or short.")] = "full",
    nominal: Annotated[bool, typer.Option("--nominal", help="Tune for the nominal parameters only.")] = False,
    resume: Annotated[bool, typer.Option("--resume/--anew", help="Resume from the finished steps.")] = True,
    certify: Annotated[
        bool, typer.Option("--certify", help="Then prove all figures below their limits and bundle the proofs.")
    ] = False,
    time_limit: Annotated[
        float, typer.Option(help="Wall-clock limit [s] of the rounds, with --certify of all; run again to resume.")
    ] = 3600.0,
    cluster: Cluster,
    json_: Json = False,
) -> None:
    """See ALL_EXAMPLES."""
    from los_testbed.api.designs import design

    number("--seed", seed, 0, 2**31 - 1)
    number("--time-limit", time_limit, 1e-3, 1e7, "s")
    kept = resume_hint("rounds and designs so far", output or Path(), without=("--anew",))
    with cluster.workers() as pool, kept:
        result = design(
            output,
            parameters=parameters,
            uncertain=uncertain or (),
            effort=effort,
            nominal=nominal,
            seed=seed,
            time_limit=time_limit,
            workers=pool,
            resume=resume,
            certify=certify,
            report=tell,
        )
    show_implemented(result, json_)


def show_implemented(result: DesignResult, json_: bool) -> None:
    """Table or JSON object, a line for each requirement that is not met; leave if one is not met or proven."""
    if json_:
        print_json(result.to_mapping())
    else:
        values = result.check.to_mapping()
        for table in verification_tables(f"{result.folder}: gammas as implemented (1 is the limit)", values):
            Screen().print(on_screen(table))
        for text in values.get("margins", {}).get("unstable_changes", ()):
            Screen().print(f"unstable with {text}", soft_wrap=True, highlight=False)
        if result.bounds:
            show_bounds(result.bounds)
    for text in result.mission.statements:
        tell(f"sources: {text}")
    for text in result.not_met:
        tell(f"not met: {text}")
    if not result.met:
        raise typer.Exit(ExitCode.NOT_MET)
    leave_if_unproven(result.bounds)
