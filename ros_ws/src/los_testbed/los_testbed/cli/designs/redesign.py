"""Commands of ``los-testbed design`` for folders of designs: a redesign for any telescope, and its verification."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from lftkit.support.progress import Progress
from los_testbed.cli.designs.folders import designs_in, name_unseen_requirements
from los_testbed.cli.designs.mission import (
    NO_MISSION,
    Mission,
    show_mission,
    sources_of_mission,
    verify_mission,
)
from los_testbed.cli.designs.proofs import leave_if_unproven, loops_of, prove_figures, show_bounds
from los_testbed.cli.designs.verification_tables import verification_tables
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import DesignSeed, TelescopeFile, Uncertain
from los_testbed.config.run_settings import DESIGN_FILES, TELESCOPE_FILE
from los_testbed.run.input_files import with_files_beside
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen

if TYPE_CHECKING:
    from lftkit.support.workers import Workers
    from los_design.verification.certify import FigureBounds
    from titop_plant.telescope.telescope import Telescope

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

EFFORTS = ("full", "short")
ROUNDS_OF_ALL = 0.4
"""Part of the wall limit that the rounds may take where proofs follow."""


def given_output(output: Path | None, what: str) -> Path:
    """Path of --output.

    Raises
    ------
    ValueError
        It is not given, or a design that the package has would be overwritten.
    """
    from los_design.synthesis.store import DESIGN_PACKAGES, shipped

    if output is None:
        raise InputError(f"--output must be given: {what}; shipped designs are never overwritten")
    for path in (output, *(output / f"{kind.replace('-', '_')}.json" for kind in DESIGN_PACKAGES)):
        if shipped(path):
            raise InputError(f"--output must not be a shipped design, got {path}")
    return output


def check_output(folder: Path, parameters: Path | None, uncertain: Sequence[str] = ()) -> None:
    """Reject an unusable folder before any work is done, and store the telescope's values in it.

    The files that they refer to are copied, too, so that the folder can be moved.
    Further uncertain factors become the table ``[uncertain]`` of the file that is kept.

    Raises
    ------
    ValueError
        The path is a file, a folder of another telescope's designs, or not writable.
    """
    from titop_plant.telescope.load import load_telescope
    from titop_plant.telescope.tables.uncertain import UNCERTAIN

    given = load_telescope(parameters)
    own = given.with_uncertain(uncertain)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output must be a folder, got the file {folder}")
    kept = folder / TELESCOPE_FILE
    if kept.exists() and load_telescope(kept).parameters_hash != own.parameters_hash:
        raise InputError(f"--output must be a folder without designs of another telescope, got {folder}")
    if uncertain and given.factors:
        raise InputError(f"--uncertain must be in the table [{UNCERTAIN}] of {parameters}, got the option")
    text, beside = ("", {}) if parameters is None else with_files_beside(parameters)
    if uncertain:
        table = "".join(f"{name} = {spread!r}\n" for name, spread in own.spreads.items())
        text = f"{text}\n[{UNCERTAIN}]\n{table}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if kept.exists() and parameters is not None and kept.samefile(parameters) and not uncertain:
            return
        if text:  # without, the folder is of the reference, or of the telescope of its file, which has the same hash
            _write_telescope(folder, text, beside)
    except OSError as error:
        raise InputError(f"--output must be a writable folder, got {folder}: {error.strerror}") from None


def _write_telescope(folder: Path, text: str, beside: Mapping[str, bytes]) -> None:
    """Write the telescope's values, and before them the files that they name, below the folder."""
    for name, content in {**beside, TELESCOPE_FILE: text.encode()}.items():
        (folder / name).parent.mkdir(exist_ok=True)
        with atomic_file(folder / name) as temporary:
            temporary.write_bytes(content)


@contextmanager
def _removed_if_refused(folder: Path, new: bool) -> Iterator[None]:
    """A new folder that holds only the telescope's files is removed where the design refuses its input."""
    from los_design.redesign import ROUNDS_FILE

    try:
        yield
    except InputError:
        if new and not any((folder / name).exists() for name in (*DESIGN_FILES.values(), ROUNDS_FILE)):
            shutil.rmtree(folder, ignore_errors=True)
        raise


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
    from los_design import redesign
    from los_design.synthesis.options import DesignOptions
    from titop_plant.telescope.load import REFERENCE, difference_summary, load_telescope

    folder = given_output(output, "a folder for the designs")
    number("--seed", seed, 0, 2**31 - 1)
    number("--time-limit", time_limit, 1e-3, 1e7, "s")
    if effort not in EFFORTS:
        raise InputError(f"--effort must be one of {', '.join(EFFORTS)}, got {effort}")
    own = load_telescope(parameters).with_uncertain(uncertain or ())
    if certify and (further := own.loop_ports.further):
        names = ", ".join(port.name for port in further)
        raise InputError(
            f"--certify must be used with a telescope without sensors and actuators of its own, got {names}"
        )
    new = not folder.exists()
    check_output(folder, parameters, uncertain or ())
    if unseen := sources_of_mission(None if parameters is None else str(parameters)):
        sys.stderr.write(f"sources: the tuning does not consider {', '.join(unseen)}; the verification does\n")
    name_unseen_requirements(own)
    for line in difference_summary(parameters or REFERENCE):
        sys.stderr.write(f"telescope: {line}\n")
    mission = Mission()

    def verify_further(report: Callable[[str], None]) -> tuple[Mapping[str, Any], list[str]]:
        nonlocal mission
        mission = verify_mission(folder, report)
        return mission.to_mapping(), mission.not_met

    until = time.monotonic() + time_limit
    limit = ROUNDS_OF_ALL * time_limit if certify else time_limit
    options = DesignOptions(seed=seed, short=effort == "short", wall_limit=limit, nominal=nominal)
    kept = resume_hint("rounds and designs so far", folder, without=("--anew",))
    with cluster.workers() as pool, kept, _removed_if_refused(folder, new):
        with Progress("design") as bar:
            summary = redesign.design_all(
                own,
                folder,
                options,
                resume=resume,
                report=bar.print,
                workers=pool,
                verify_further=verify_further,
            )
        bounds = _proven(own, folder, pool, until) if certify else ()
    show_implemented(folder, summary.check.to_mapping(), list(summary.not_met), json_, bounds, mission)


def _proven(telescope: Telescope, folder: Path, workers: Workers, until: float) -> Sequence[FigureBounds]:
    """Bounds of all figures of the designs of a folder; the proofs and their bundle go there, too.

    Raises
    ------
    ValueError
        The telescope of the folder is not that of the designs, or the controllers were made for another one.
    """
    from los_design.verification.loop_models import figures_of

    wanted, telescope = telescope.parameters_hash, designs_in(folder)[0]
    if (found := telescope.parameters_hash) != wanted:
        raise InputError(f"{folder / TELESCOPE_FILE} must be of the telescope {wanted} to be proven, got {found}")
    stages = telescope.mirror_stages
    loops, known = loops_of(folder, list(stages), same_telescope=True)
    chosen = [(stage, name) for stage in stages for name in figures_of(telescope, stage)]
    return prove_figures(chosen, loops, known, folder, workers, until)


def show_implemented(
    folder: Path,
    implemented: dict[str, Any],
    not_met: list[str],
    json_: bool,
    bounds: Sequence[FigureBounds] = (),
    mission: Mission = NO_MISSION,
) -> None:
    """Table or JSON object, a line for each requirement that is not met; leave if one is not met or proven."""
    if json_:
        proofs = {"figures": [b.to_mapping() for b in bounds]} if bounds else {}
        shown = {"implemented": implemented, **mission.to_mapping(), "not_met": not_met}
        print_json({"folder": str(folder), **shown, **proofs})
    else:
        for table in verification_tables(f"{folder}: gammas as implemented (1 is the limit)", implemented):
            Screen().print(on_screen(table))
        for text in implemented.get("margins", {}).get("unstable_changes", ()):
            Screen().print(f"unstable with {text}", soft_wrap=True, highlight=False)
    if bounds and not json_:
        show_bounds(bounds)
    show_mission(mission)
    for text in not_met:
        sys.stderr.write(f"not met: {text}\n")
    if not_met:
        raise typer.Exit(ExitCode.NOT_MET)
    leave_if_unproven(bounds)
