"""Proofs of the figures of a pair of controllers, in a folder with their bounds and the bundle of all of them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof
from lftkit.support.atomic_output import atomic_file
from lftkit.support.input_files import read_text
from lftkit.support.progress import Progress
from lftkit.support.structured_text import load_json
from lftkit.support.workers import Workers
from los_design.files import BOUNDS, WORST_POINTS
from los_design.folder import load_folder
from los_design.search.worst_case_search import Search
from los_design.search.worst_points import WorstPoint, load_worst_points
from los_design.synthesis.store import load_designs
from los_design.verification.bundle import write_bundle
from los_design.verification.certify import FigureBounds, ProofLevel, Prover, certify_figure
from los_design.verification.loop_models import figures_of, provable, provable_open_loop
from los_design.verification.noise_certificate import NOISE, certify_noise
from los_design.verification.proof_comparison import compare_noise, compare_proof
from los_design.verification.subject import BUNDLE
from los_loop.implemented_loop import ImplementedLoop
from titop_plant.interface import design_warnings
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

Report = Callable[[str], None]


class Loops(NamedTuple):
    """Implemented loops by their stages, and the worst points that are known of them."""

    stages: dict[str, ImplementedLoop]
    worst_points: list[WorstPoint]


def figures_to_prove(telescope: Telescope, stages: Iterable[str], figure: str | None = None) -> list[tuple[str, str]]:
    """Stages and figures: one figure, or all gains of the table from the disturbances.

    Raises
    ------
    InputError
        No stage has a figure of that name.
    """
    ports = telescope.loop_ports  # names are those of any loop
    if figure is None:
        return [(stage, name) for stage in stages for name in figures_of(telescope, stage, ports)]
    known = [(stage, name) for stage in stages for name in (*provable(telescope, stage, ports), NOISE)]
    chosen = [(stage, name) for stage, name in known if name == figure]
    if not chosen:
        names = dict.fromkeys(repr(name) for _, name in known)
        raise InputError(f"--figure must be one of {', '.join(names)} with these stages, got {figure}")
    return chosen


def loops_of(
    folder: Path | None,
    stages: Iterable[str],
    uncertain: Sequence[str] = (),
    *,
    same_telescope: bool = False,
    warn: Callable[[Sequence[str]], object] = lambda warnings: None,
) -> Loops:
    """The implemented loops of a pair of controllers.

    Parameters
    ----------
    folder : Path or None
        Of ``design all``; None for the shipped pair.
    stages : iterable of str
    uncertain : sequence of str
        Further uncertain factors of the telescope, as ``isolator.stiffness=10%``. Known points have them at 1.
    same_telescope : bool
        Reject controllers designed for a telescope other than that of the folder.
    warn : callable
        Receives the warnings about the controllers.
    """
    if folder is None:
        telescope, (k_fsm, k_pma) = load_telescope(), load_designs("implemented")
    else:
        telescope, k_fsm, k_pma = load_folder(folder)
        if same_telescope:
            refuse_other_telescope(folder, telescope, (k_fsm, k_pma))
    telescope = telescope.with_uncertain(uncertain)
    warn(design_warnings((k_fsm, k_pma), telescope.design_basis, closed=True))
    points = []
    if folder is None or (folder / WORST_POINTS).exists():
        points = [point for table in load_worst_points(folder).values() for point in table.values()]
    open_loop = provable_open_loop(telescope, k_fsm, k_pma)
    return Loops({stage: ImplementedLoop(open_loop, k_fsm, k_pma, stage) for stage in stages}, points)


def refuse_other_telescope(folder: Path, telescope: Telescope, controllers: Sequence[SampledSystem]) -> None:
    """Reject controllers designed for a telescope other than that of their folder.

    Parameters
    ----------
    folder : Path
        For the message.
    telescope : Telescope
        Of the folder, without the factors of ``--uncertain``. Controllers made without those of its table
        ``[uncertain]`` are not refused either: the option and the table are the same.
    controllers : sequence of SampledSystem
        One without a design basis is accepted.

    Raises
    ------
    InputError
        A controller was designed for another telescope: hours later the proof would be for the wrong loop.
    """
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


def prove_figures(
    chosen: Sequence[tuple[str, str]],
    loops: Loops,
    output: Path,
    prove: Prover,
    until: float,
    level: ProofLevel | None = None,
    *,
    workers: Workers,
    report: Report = lambda text: None,
) -> list[FigureBounds]:
    """Prove figures one after the other, and bundle all proofs of the folder.

    Parameters
    ----------
    chosen : sequence of (stage, figure)
    loops : Loops
        Of :func:`loops_of`.
    output : Path
        Folder of proofs, bounds and bundle.
    prove : callable
        Proves the parts (:data:`los_design.verification.certify.Prover`).
    until : float
        ``time.monotonic()`` after which no part is started and parts in progress end.
    level : ProofLevel, optional
        Default: the limit of each figure.
    workers : Workers
        Search the worst points where none are known.
    report : callable
        Receives a line for each figure, and what is left at the time limit.
    """
    bounds: list[FigureBounds] = []
    for stage, name in chosen:
        loop = loops.stages[stage]
        with Progress(f"{stage}, {name}") as bar:
            if name == NOISE:
                bounds.append(certify_noise(loop, output, prove, until, bar.report))
            else:
                points = loops.worst_points
                if not points:
                    search = Search(loop)
                    # Some margins have no search
                    points = search.run([name], workers=workers)[name] if name in search.metrics else []
                asked = level or ProofLevel()
                bounds.append(certify_figure(loop, name, asked, points, output, prove, until, bar.report))
        _store_bounds(output / BOUNDS, bounds)
        report(f"{stage}, {name}: {bounds[-1].status}")
    if any(one.status == "proven" for one in bounds):
        with Progress("bundle"):
            bundle_proofs(output, loops.stages, report)
    if time.monotonic() > until and any(one.status == "open" for one in bounds):
        done = sum(one.status == "proven" for one in bounds)
        report(f"time limit: {done} of {len(bounds)} figures proven; run again to resume")
    return bounds


def load_bounds(path: Path) -> list[dict[str, Any]]:
    """Bounds of an earlier call, none if there is no file.

    Raises
    ------
    InputError
        The file has no bounds.
    """
    if not path.exists():
        return []
    try:
        entries = load_json(read_text(path), path)["figures"]
        return [{**entry, "stage": str(entry["stage"]), "figure": str(entry["figure"])} for entry in entries]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        raise InputError(f"{BOUNDS} in --output must be from an earlier run, got another file {path}") from None


def _store_bounds(path: Path, bounds: Sequence[FigureBounds]) -> None:
    """The bounds so far, with those of other figures in the file."""
    new = [one.to_mapping() for one in bounds]
    done = {(entry["stage"], entry["figure"]) for entry in new}
    others = [entry for entry in load_bounds(path) if (entry["stage"], entry["figure"]) not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps({"figures": [*others, *new]}, indent=1) + "\n", encoding="utf-8")


def bundle_proofs(output: Path, loops: Mapping[str, ImplementedLoop], report: Report = lambda text: None) -> None:
    """Put all proofs of the folder that are of these loops into one file, with controllers and telescope."""
    proofs = {}
    for entry in load_bounds(output / BOUNDS):
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
            report(f"{file.name} is not in {BUNDLE}: {'; '.join(compared.mismatches)}")
    loop = next(iter(loops.values()))
    write_bundle(output / BUNDLE, loop.telescope, loop.pair, proofs)
