"""Command ``los-testbed design certify``."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file, check_output
from lftkit.support.progress import Progress
from los_testbed.cli.designs.folders import designs_in
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import Designs, Uncertain
from los_testbed.config.members import WORST_POINTS
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen, warn
from pointing_analysis.files.structured_text import load_json, read_text
from pointing_analysis.formatting.number_text import ABSENT, at_least, at_most
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from titop_plant.interface import (
    DT,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MIRROR_STAGES,
)

if TYPE_CHECKING:
    from lftkit import SampledSystem
    from lftkit.support.workers import Workers
    from los_design.search.worst_points import WorstPoint
    from los_design.verification.certify import FigureBounds, ProofLevel
    from los_loop.implemented_loop import ImplementedLoop
    from titop_plant.telescope.telescope import Telescope

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

SUMMARY = "bounds.json"


@with_cluster
def certify(
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
    from los_design.verification.certify import ProofLevel

    number("--level", level, 1e-6, 1e6)
    number("--time-limit", time_limit, 1.0, 1e7, "s")
    if gap is not None:
        number("--gap", gap, 1e-3, 10.0)
    if stage not in (None, *MIRROR_STAGES):
        raise InputError(f"--stage must be one of {', '.join(MIRROR_STAGES)}, got {stage}")
    chosen = _chosen(stage, figure)
    check_output(output, "--output", folder=True)
    if output.is_dir():
        check_output(output / SUMMARY, f"{SUMMARY} in --output")
    _bounds_of(output / SUMMARY)  # another file of that name is refused before the work
    until = time.monotonic() + time_limit
    folder = None if designs is None else Path(designs)
    loops, known = loops_of(folder, list(MIRROR_STAGES), uncertain or (), same_telescope=True)
    with cluster.workers() as pool, resume_hint("proven parts", output):
        found = prove_figures(chosen, loops, known, output, pool, until, ProofLevel(level, gap))
    if json_:
        print_json({"figures": [bounds.to_mapping() for bounds in found]})
    else:
        show_bounds(found)
    leave_if_unproven(found)


def leave_if_unproven(figures: Sequence[FigureBounds]) -> None:
    """End the command with the code of a figure that is violated, or not proven."""
    found = {bounds.status for bounds in figures} - {"proven"}
    if found:
        raise typer.Exit(ExitCode.NOT_MET if "violated" in found else ExitCode.NOT_DEMONSTRATED)


def prove_figures(
    chosen: Sequence[tuple[str, str]],
    loops: Mapping[str, ImplementedLoop],
    known: Sequence[WorstPoint],
    output: Path,
    workers: Workers,
    until: float,
    level: ProofLevel | None = None,
) -> list[FigureBounds]:
    """Prove figures one after the other, and bundle all proofs of the folder.

    Parameters
    ----------
    chosen : sequence of (stage, figure)
    loops, known
        Of :func:`loops_of`.
    output : Path
    workers : Workers
        Prove the parts.
    until : float
        ``time.monotonic()`` after which no part is started and parts in progress end.
    level : ProofLevel, optional
        Default: the limit of each figure.
    """
    from los_design.verification.certify import ProofLevel, certify_figure
    from los_design.verification.noise_certificate import NOISE, certify_noise
    from los_testbed.campaign.proof_parts import prover_of

    prove = prover_of(workers)
    found: list[FigureBounds] = []
    for s, name in chosen:
        with Progress(f"{s}, {name}") as bar:
            if name == NOISE:
                found.append(certify_noise(loops[s], output, prove, until, bar.report))
            else:
                points = known or _searched(loops[s], name, workers)
                asked = level or ProofLevel()
                found.append(certify_figure(loops[s], name, asked, points, output, prove, until, bar.report))
        _keep(output / SUMMARY, found)
        sys.stderr.write(f"{s}, {name}: {found[-1].status}\n")
    if any(bounds.status == "proven" for bounds in found):
        with Progress("bundle"):
            _bundle(output, loops)
    if time.monotonic() > until and any(bounds.status == "open" for bounds in found):
        done = sum(bounds.status == "proven" for bounds in found)
        sys.stderr.write(f"time limit: {done} of {len(found)} figures proven; run again to resume\n")
    return found


def _chosen(stage: str | None, figure: str | None) -> list[tuple[str, str]]:
    """Stages and figures of the options: one figure, or all gains of the table from the disturbances."""
    from los_design.verification.loop_models import figures_of, provable
    from los_design.verification.noise_certificate import NOISE
    from titop_plant.telescope.load import load_telescope

    telescope, stages = load_telescope(), list(MIRROR_STAGES) if stage is None else [stage]  # names alone
    if figure is None:
        return [(s, name) for s in stages for name in figures_of(telescope, s)]
    known = [(s, name) for s in stages for name in (*provable(telescope, s), NOISE)]
    found = [(s, name) for s, name in known if name == figure]
    if not found:
        names = dict.fromkeys(repr(name) for _, name in known)
        raise InputError(f"--figure must be one of {', '.join(names)} with these stages, got {figure}")
    return found


def loops_of(
    folder: Path | None, stages: list[str], uncertain: Sequence[str] = (), *, same_telescope: bool = False
) -> tuple[dict[str, ImplementedLoop], list[WorstPoint]]:
    """The implemented loops and their known worst points.

    Parameters
    ----------
    folder : Path or None
        Of `design all`; None for the shipped pair.
    stages : list of str
    uncertain : sequence of str
        Further uncertain factors of the telescope, as ``isolator.stiffness=10%``. Known points have them at 1.
    same_telescope : bool
        Reject controllers designed for a telescope other than that of the folder.
    """
    from los_design.search.worst_points import load_worst_points
    from los_design.synthesis.store import load_designs
    from los_loop.implemented_loop import ImplementedLoop
    from los_loop.open_loop import OpenLoop
    from titop_plant.interface import design_warnings
    from titop_plant.telescope.control_plant import control_loop_plant
    from titop_plant.telescope.load import load_telescope

    if folder is None:
        telescope, (k_fsm, k_pma) = load_telescope(), load_designs("implemented")
    else:
        telescope, k_fsm, k_pma = designs_in(folder)
        if same_telescope:
            refuse_other_telescope(folder, telescope, (k_fsm, k_pma))
        refuse_devices(telescope, k_fsm, k_pma)
        k_fsm.require(K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
        k_pma.require(K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    telescope = telescope.with_uncertain(uncertain)
    warn(design_warnings((k_fsm, k_pma), telescope.design_basis, closed=True))
    system = control_loop_plant(telescope)
    points = []
    if folder is None or (folder / WORST_POINTS).exists():
        points = [point for table in load_worst_points(folder).values() for point in table.values()]
    open_loop = OpenLoop(system, telescope)
    return {stage: ImplementedLoop(open_loop, k_fsm, k_pma, stage) for stage in stages}, points


def refuse_other_telescope(folder: Path, telescope: Telescope, controllers: Sequence[SampledSystem]) -> None:
    """Reject controllers designed for a telescope other than that of their folder.

    Parameters
    ----------
    folder : Path
        For the message.
    telescope : Telescope
        Of its telescope, without the factors of ``--uncertain``. Controllers made without those of its table
        ``[uncertain]`` are not refused either: the option and the table are the same.
    controllers : sequence of SampledSystem
        One without a design basis is accepted.

    Raises
    ------
    ValueError
        A controller was designed for another telescope: hours later the proof would be for the wrong loop.
    """
    from titop_plant.interface import design_warnings

    basis = telescope.design_basis
    design_warnings(controllers, basis, closed=True)  # another mirror sensitivity has its own message
    present = basis.parameters_hash
    without = telescope.without_uncertain().parameters_hash
    for controller in controllers:
        made = str(controller.design_basis.get("parameters_hash", present))
        if made not in (present, without):
            raise InputError(
                f"{controller.name} in {folder} must be made for the telescope there, parameters_hash {present}, got "
                f"one for {made}: `design all` makes new ones; without FOLDER the shipped pair is proven for the "
                "reference telescope"
            )


def refuse_devices(telescope: Telescope, k_fsm: SampledSystem, k_pma: SampledSystem) -> None:
    """Reject controllers that use sensors or actuators of the telescope's file.

    Raises
    ------
    ValueError
        They do: proofs, their bundle and its checker have the ports of the reference's loop.
    """
    if telescope.loop_ports.used_by(k_fsm, k_pma).further:
        known = {port.name for port in (*K_FSM_INPUTS, *K_FSM_OUTPUTS, *K_PMA_INPUTS, *K_PMA_OUTPUTS)}
        ports = [p.name for system in (k_fsm, k_pma) for p in (*system.inputs, *system.outputs)]
        further = ", ".join(dict.fromkeys(name for name in ports if name not in known))
        raise InputError(
            "controllers must use no sensors and actuators of the telescope's file here: proofs and their "
            f"checker have the ports of the reference's loop, got {further}"
        )


def _searched(loop: ImplementedLoop, name: str, workers: Any) -> list[WorstPoint]:
    """Worst points by a search, where none are stored."""
    from los_design.search.worst_case_search import Search

    search = Search(loop)
    return search.run([name], workers=workers)[name] if name in search.metrics else []  # of some margins no search


def _bounds_of(path: Path) -> list[dict[str, Any]]:
    """Bounds of a run before, none if there is no file.

    Raises
    ------
    ValueError
        The file has no bounds.
    """
    if not path.exists():
        return []
    try:
        entries = load_json(read_text(path), path)["figures"]
        return [{**entry, "stage": str(entry["stage"]), "figure": str(entry["figure"])} for entry in entries]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        raise InputError(f"{SUMMARY} in --output must be from an earlier run, got another file {path}") from None


def _keep(path: Path, found: list[FigureBounds]) -> None:
    """The bounds so far, with those of other figures in the file."""
    new = [bounds.to_mapping() for bounds in found]
    done = {(entry["stage"], entry["figure"]) for entry in new}
    kept = [entry for entry in _bounds_of(path) if (entry["stage"], entry["figure"]) not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps({"figures": [*kept, *new]}, indent=1) + "\n", encoding="utf-8")


def _bundle(output: Path, loops: Mapping[str, ImplementedLoop]) -> None:
    """Put all proofs of the folder that are of these loops into one file, with controllers and telescope."""
    from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof
    from los_design.verification.bundle import write_bundle
    from los_design.verification.noise_certificate import NOISE
    from los_design.verification.proof_comparison import compare_noise, compare_proof
    from los_design.verification.subject import BUNDLE

    proofs = {}
    for entry in _bounds_of(output / SUMMARY):
        stage, figure, file = entry["stage"], entry["figure"], output / str(entry.get("proof"))
        if stage not in loops or not file.is_file():
            continue
        if figure == NOISE:
            compared = compare_noise(read_noise_proof(file), loops[stage])
        else:
            compared = compare_proof(read_loop_proof(file), loops[stage], figure)
        if compared.same:
            proofs[stage, figure] = file
        else:
            sys.stderr.write(f"{file.name} is not in {BUNDLE}: {'; '.join(compared.mismatches)}\n")
    loop = next(iter(loops.values()))
    write_bundle(output / BUNDLE, loop.telescope, loop.pair, proofs)


def show_bounds(found: Sequence[FigureBounds]) -> None:
    """Table of bounds, and the figures not proven."""
    bounds = numbers("lower", "upper", "at rad/s")
    heads = (*texts("stage", "figure"), *bounds, *texts("status", "stable"), *numbers("strips", "CPU s"))
    rows = []
    for b in found:
        upper, stable = (at_most(b.upper) if math.isfinite(b.upper) else ABSENT), ("all" if b.stable else "")
        work = (f"{b.strips}", f"{b.seconds:.0f}")
        rows.append((b.stage, b.figure, at_least(b.lower), upper, f"{b.frequency:.5g}", b.status, stable, *work))
    Screen().print(on_screen(TextTable.of(heads, rows, "Bounds over the whole box (1 is the limit)")))
    for b in found:
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
