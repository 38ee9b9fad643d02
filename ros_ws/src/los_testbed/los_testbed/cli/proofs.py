"""Commands ``los-testbed design certify`` and ``design check-proof``."""

from __future__ import annotations

import json
import math
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from lftkit.support.progress import Progress
from los_testbed.cli.options import Json
from los_testbed.cli.output import number, print_json, warn
from los_testbed.cli.redesign import WorkersOption, processes
from los_testbed.run.screen import Screen
from los_testbed.variants import DESIGN_FILES, TELESCOPE_FILE, WORST_POINTS
from pointing_analysis.files.atomic_output import atomic_file, check_output
from pointing_analysis.files.structured_text import load_json, read_text
from titop_plant.interface import (
    DT,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MIRROR_STAGES,
)

if TYPE_CHECKING:
    from lftkit.proofs.sampled_loop import CheckedLoop
    from los_design.search.worst_points import WorstPoint
    from los_design.verification.certify import FigureBounds
    from los_design.verification.proof_comparison import ProofComparison
    from los_loop.implemented_loop import ImplementedLoop

CERTIFY_EXAMPLES = """Prove the figures of a pair of controllers for the whole box of parameters and all frequencies.

Writes a proof STAGE-FIGURE.npz for each figure that is proven, and bounds.json. Parts that are proven are kept: the
same command goes on after an interruption, and another level begins with what holds of them. The exit code is 1 if a
figure is violated or not proven to its end.

**Examples**

    los-testbed design certify --output proofs                     # the shipped pair, below its limits

    los-testbed design certify designs/soft --output soft-proofs

    los-testbed design certify --output proofs --stage fsm+pma --figure slow --gap 0.05
"""

CHECK_PROOF_EXAMPLES = """Verify a proof of a worst-case gain or of robust stability.

The check has its own short code (`lftkit/proofs/state_space/checker.py`; for the `.npz` of `design certify`
`lftkit/proofs/sampled_loop/checker.py` and what it imports): it optimises nothing. Exit code 1 if the
proof is refused.

The words in a file prove nothing of whom it is about: a proof of `design certify` is compared with the shipped
controllers and telescope, or with those of `--of FOLDER`, and refused if it is not of these.

**Examples**

    los-testbed design check-proof proof.json

    los-testbed design check-proof soft-proofs/fsm+pma-slow.npz --of designs/soft
"""

SUMMARY = "bounds.json"
FIGURES = {"fsm": ("APE", "slow", "fast", "mirror"), "fsm+pma": ("APE", "slow", "fast", "mirror", "force")}


def certify(
    output: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the proofs.")],
    folder: Annotated[Path | None, typer.Argument(help="Folder of `design all`. Default: the shipped pair.")] = None,
    level: Annotated[float, typer.Option(help="Part of the limit to be proven.")] = 1.0,
    gap: Annotated[
        float | None, typer.Option(help="Prove this much above the largest value known instead, e.g. 0.05.")
    ] = None,
    stage: Annotated[str | None, typer.Option(help="fsm or fsm+pma. Default: both.")] = None,
    figure: Annotated[str | None, typer.Option(help="APE, slow, fast, mirror or force. Default: all.")] = None,
    wall_limit: Annotated[float, typer.Option(help="Seconds after which it stops.")] = 10800.0,
    workers: WorkersOption = 0,
    json_: Json = False,
) -> None:
    """See CERTIFY_EXAMPLES."""
    from lftkit.support.workers import Workers
    from los_design.verification.certify import certify_figure

    number("--level", level, 1e-6, 1e6)
    number("--wall-limit", wall_limit, 1.0, 1e7, "s")
    if gap is not None:
        number("--gap", gap, 1e-3, 10.0)
    if stage not in (None, *MIRROR_STAGES):
        raise ValueError(f"--stage must be one of {', '.join(MIRROR_STAGES)}, got {stage}")
    possible = [(s, name) for s in (FIGURES if stage is None else [stage]) for name in FIGURES[s]]
    names = dict.fromkeys(name for _, name in possible)
    if figure not in (None, *names):
        raise ValueError(f"--figure must be one of {', '.join(names)} with these stages, got {figure}")
    chosen = [(s, name) for s, name in possible if figure in (None, name)]
    count = processes(workers)
    check_output(output, "--output", folder=True)
    if output.is_dir():
        check_output(output / SUMMARY, f"{SUMMARY} in --output")
    _bounds_of(output / SUMMARY)  # another file of that name is refused before the work
    until = time.monotonic() + wall_limit
    loops, known = _loops(folder, list(dict.fromkeys(s for s, _ in chosen)))
    found: list[FigureBounds] = []
    with ExitStack() as stack:
        pool = stack.enter_context(Workers(count))
        for s, name in chosen:
            with Progress(f"{s}, {name}") as bar:
                points = known or _searched(loops[s], name, pool)
                found.append(
                    certify_figure(
                        loops[s], name, None if gap else level, gap or 0.0, points, output, pool, until, bar.report
                    )
                )
            _keep(output / SUMMARY, found)
            sys.stderr.write(f"{s}, {name}: {found[-1].status}\n")
    _show(found, json_)
    if any(bounds.status != "proven" for bounds in found):
        raise typer.Exit(1)


def _loops(folder: Path | None, stages: list[str]) -> tuple[dict[str, ImplementedLoop], list[WorstPoint]]:
    """The implemented loops, and the worst points that are known of them."""
    from lftkit import SampledSystem
    from los_design.search.worst_points import load_worst_points
    from los_design.synthesis.store import load_designs
    from los_loop.implemented_loop import ImplementedLoop
    from los_loop.open_loop import OpenLoop
    from titop_plant.interface import design_warnings
    from titop_plant.simulation.build import control_loop_plant
    from titop_plant.telescope.assembly import build_telescope
    from titop_plant.telescope.parameters import REFERENCE, design_basis, load_parameters

    if folder is not None and not folder.is_dir():
        raise ValueError(f"FOLDER must hold {' and '.join(DESIGN_FILES.values())}, got no folder {folder}")
    own = folder is not None and (folder / TELESCOPE_FILE).exists()
    parameters = load_parameters(folder / TELESCOPE_FILE if folder is not None and own else REFERENCE)
    if folder is None:
        k_fsm, k_pma = load_designs("implemented")
    else:
        k_fsm, k_pma = (SampledSystem.from_file(folder / name) for name in DESIGN_FILES.values())
        k_fsm.require(K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
        k_pma.require(K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    warn(design_warnings((k_fsm, k_pma), design_basis(parameters), closed=True))
    system = control_loop_plant(build_telescope(parameters), parameters)
    points = []
    if folder is None or (folder / WORST_POINTS).exists():
        points = [point for table in load_worst_points(folder).values() for point in table.values()]
    open_loop = OpenLoop(system, parameters)
    return {stage: ImplementedLoop(open_loop, k_fsm, k_pma, stage) for stage in stages}, points


def _searched(loop: ImplementedLoop, name: str, workers: Any) -> list[WorstPoint]:
    """Worst points by a search, where none are stored."""
    from los_design.search.worst_case_search import Search

    return Search(loop).run([name], workers=workers)[name]


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
        raise ValueError(f"{SUMMARY} in --output must be that of a run before, got another file {path}") from None


def _keep(path: Path, found: list[FigureBounds]) -> None:
    """The bounds so far, with those of other figures that the file has by now."""
    new = [bounds.to_mapping() for bounds in found]
    done = {(entry["stage"], entry["figure"]) for entry in new}
    kept = [entry for entry in _bounds_of(path) if (entry["stage"], entry["figure"]) not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps({"figures": [*kept, *new]}, indent=1) + "\n", encoding="utf-8")


def _show(found: list[FigureBounds], json_: bool) -> None:
    if json_:
        print_json({"figures": [bounds.to_mapping() for bounds in found]})
        return
    table = Table(title="Bounds over the whole box (1 is the limit)")
    for column in ("stage", "figure", "lower", "upper", "at rad/s", "status", "stable", "strips", "CPU s"):
        table.add_column(column, justify="left" if column in ("stage", "figure", "status", "stable") else "right")
    for b in found:
        upper, stable = (f"{b.upper:.4g}" if math.isfinite(b.upper) else "-"), ("all" if b.stable else "")
        work = (f"{b.strips}", f"{b.seconds:.0f}")
        table.add_row(b.stage, b.figure, f"{b.lower:.4g}", upper, f"{b.frequency:.5g}", b.status, stable, *work)
    Screen().print(table)
    for b in found:
        if b.status == "violated":
            values = ", ".join(f"{name} {value:.5g}" for name, value in b.point.items())
            sys.stderr.write(
                f"{b.stage}, {b.figure}: {b.lower:.4g} of the limit at {b.frequency:.6g} rad/s, {values}\n"
            )
        elif b.status == "unstable":
            sys.stderr.write(f"{b.stage}, {b.figure}: the nominal loop was not proven stable\n")
        elif b.uncovered:
            low, high = b.uncovered[0]
            sys.stderr.write(
                f"{b.stage}, {b.figure}: {len(b.uncovered)} parts not covered, first {low:.6g} to {high:.6g} rad/s\n"
            )


def check_proof(
    file: Annotated[Path, typer.Argument(help="Proof file (.json, or .npz of `design certify`).")],
    of: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of `design all` that an .npz must be a proof of.")
    ] = None,
    workers: WorkersOption = 0,
    json_: Json = False,
) -> None:
    """See CHECK_PROOF_EXAMPLES."""
    from lftkit.proofs import CheckedProof, ProofError
    from lftkit.proofs import check_proof as check
    from lftkit.proofs.checking import proof_format
    from lftkit.proofs.sampled_loop.proof import FORMAT as LOOP
    from lftkit.support.threads import one_thread

    count = processes(workers)
    if not file.exists():
        raise ValueError(f"FILE must be a proof file, got {file}, which does not exist")
    if of is not None and file.suffix != ".npz":
        raise ValueError(f"--of must be given with an .npz of `design certify`, got {file}")
    try:
        if proof_format(file) == LOOP:
            _check_loop(file, count, of, json_)
            return
        with one_thread():
            checked = check(file)
        if not isinstance(checked, CheckedProof):
            raise ProofError(f"the file must be a proof of a system, got one of {type(checked).__name__}")
    except ProofError as error:
        sys.stderr.write(f"refused: {error}\n")
        raise typer.Exit(1) from None
    band = [checked.band[0], None if math.isinf(checked.band[1]) else checked.band[1]]
    if json_:
        print_json({**vars(checked), "band": band, "margin": min(checked.margin, 1e300)})
        return
    box = ", ".join(f"{name} in [{low:.6g}, {high:.6g}]" for name, (low, high) in checked.box.items())
    frequencies = f"from {checked.band[0]:g} rad/s " + ("on" if band[1] is None else f"to {band[1]:g} rad/s")
    if checked.kind == "gain":
        sys.stdout.write(f"proven: gain below {checked.level:.6g} at all frequencies {frequencies}\n")
    if checked.stable:
        sys.stdout.write("proven: stable\n")
    sys.stdout.write(f"for all {box or 'parameters (there are none)'}\n")
    sys.stdout.write(f"{checked.cells} parts; smallest margin {checked.margin:.3g} times the bound of all rounding\n")


def _check_loop(file: Path, count: int, of: Path | None, json_: bool) -> None:
    """Check a proof of a sampled loop, and of which loop it is."""
    from lftkit.proofs.sampled_loop import check_loop_proof
    from lftkit.proofs.verdict import ProofError
    from lftkit.support.threads import one_thread
    from lftkit.support.workers import Workers

    whose = "the shipped controllers and telescope" if of is None else f"the controllers and the telescope of {of}"
    compared = _compared(file, of)
    if of is not None and not compared.same:
        raise ProofError(f"it is not of {whose}: other {', '.join(compared.mismatches)}")
    with one_thread(), Workers(count) as pool:
        checked = check_loop_proof(file, pool.each)
    if json_:
        below = checked.stable_below if math.isfinite(checked.stable_below) else None
        mismatches = {"of": str(of or "shipped"), "mismatches": list(compared.mismatches)}
        print_json({**vars(checked), "stable_below": below, **mismatches})
        return
    if compared.same:
        close = f"to {compared.difference:.1g} of the responses, compared and not proven"
        sys.stdout.write(f"of {whose} ({close})\n")
    else:
        other = ", ".join(compared.mismatches)
        sys.stdout.write(f"not of {whose} (other {other}); what the file says it is about is not confirmed\n")
    box = ", ".join(f"{name} [{low:.6g}, {high:.6g}]" for name, (low, high) in zip(checked.names, checked.box))
    about = ", ".join(f"{k} {v:.6g}" if isinstance(v, float) else f"{k} {v}" for k, v in checked.about.items())
    sys.stdout.write(f"proven: {about}: below {checked.level:.6g} of the limit\n")
    sys.stdout.write(f"at all frequencies from {checked.band[0]:g} to {checked.band[1]:.6g} rad/s\n")
    sys.stdout.write(f"{_stability(checked)}\n")
    sys.stdout.write(f"for all deviations from the nominal values {box} (of an angle [rad])\n")
    sys.stdout.write(f"{checked.strips} strips, {checked.windows} windows of frequency\n")


def _compared(file: Path, of: Path | None) -> ProofComparison:
    """Of which loop a proof is: that of the stage and figure that it names."""
    from lftkit.proofs.sampled_loop import LoopProof
    from los_design.verification.proof_comparison import ProofComparison, compare_proof

    proof = LoopProof.from_file(file)
    stage, figure = (str(proof.about.get(key)) for key in ("stage", "figure"))
    if stage not in MIRROR_STAGES:
        return ProofComparison((f"stage, got {stage}",))
    loops, _ = _loops(of, [stage])
    return compare_proof(proof, loops[stage], figure)


def _stability(checked: CheckedLoop) -> str:
    """What a proof of a loop says about stability, with its condition."""
    if checked.stable:
        return "proven: stable, as a loop without the sidebands that sampling makes of uncertain parameters and frames"
    if checked.stable_below:
        return (
            f"proven: stable nominal loop, and no pole crosses the axis up to {checked.stable_below:.6g} rad/s; "
            "not proven: stable, as poles may cross above"
        )
    return "not proven: stable; the level is that of the frequency response"
