"""Designs from scripts and notebooks: make, verify and prove the controllers of a telescope."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.support.atomic_output import check_output, write_text
from lftkit.support.job import Job
from lftkit.support.kept_workers import KeptWorkers
from lftkit.support.progress import Progress
from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from los_design import redesign
from los_design.files import BOUNDS, TELESCOPE, WORST_POINTS
from los_design.folder import load_folder, refuse_shipped, removed_if_refused, store_telescope
from los_design.search.worst_points import load_adversarial
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import source_digest
from los_design.synthesis.store import load_designs
from los_design.verification.certify import FigureBounds, ProofLevel
from los_design.verification.figure_proofs import figures_to_prove, load_bounds, loops_of, prove_figures
from los_design.verification.loop_models import refuse_other_rates
from los_design.verification.stage_check import RESULTS
from los_design.verification.verification import (
    ImplementedCheck,
    broken_requirements,
    check_implemented,
    failures,
    verification_points,
)
from los_testbed.campaign.cluster_work import versions
from los_testbed.campaign.proof_parts import prover_of
from los_testbed.run.identity import telescope_digest
from los_testbed.run.mission import NO_MISSION, Mission, sources_of_mission, verify_mission
from titop_plant.interface import design_warnings
from titop_plant.telescope.control_plant import control_loop_plant, loop_plant
from titop_plant.telescope.load import REFERENCE, difference_summary, load_telescope
from titop_plant.telescope.requirements import unseen_by_design
from titop_plant.telescope.telescope import Telescope

PathLike = str | os.PathLike[str]
Report = Callable[[str], None]

EFFORTS = ("full", "short")

ROUNDS_SHARE = 0.4
"""Part of the wall limit that the rounds of a design may take where proofs follow."""

NOMINAL_POINTS = 60
"""Parameter points at which the nominal design is evaluated."""

VERIFIED = ("implemented", "implemented_nominal")
"""Variants of the stored designs that are evaluated."""


def _silent(text: str | Sequence[str]) -> None:
    return None


@dataclass(frozen=True)
class DesignResult:
    """Gammas, verdicts and proofs of the designs of a folder.

    Parameters
    ----------
    folder : Path
    check : ImplementedCheck
        Gammas and margins of the loop as implemented, at verification points and at the worst points found.
    not_met : tuple of str
        One line for each requirement that is not met; empty if all are.
    mission : Mission
        Verdicts under the disturbance sources of the telescope's file.
    bounds : tuple of FigureBounds
        Proven bounds of the figures, where they were asked for.
    """

    folder: Path
    check: ImplementedCheck
    not_met: tuple[str, ...]
    mission: Mission = NO_MISSION
    bounds: tuple[FigureBounds, ...] = ()

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return not self.not_met

    @property
    def gammas(self) -> dict[str, list[float]]:
        """Gammas in the paper's order, mirror alone and with the proof-mass actuators where there are any."""
        return self.check.gammas

    def to_mapping(self) -> dict[str, Any]:
        """For JSON."""
        proofs = {"figures": [one.to_mapping() for one in self.bounds]} if self.bounds else {}
        values = {"implemented": self.check.to_mapping(), **self.mission.to_mapping(), "not_met": list(self.not_met)}
        return {"folder": str(self.folder), **values, **proofs}


@dataclass(frozen=True)
class Verification:
    """Options of a verification.

    Parameters
    ----------
    samples : int
        Random parameter points.
    uncertain : sequence of str
        Further uncertain factors, as ``isolator.stiffness=10%``.
    output : path, optional
        JSON file of the result; finished parts are beside it until it is written.
    workers : int or Workers
    report : callable
        Receives what no figure of a design covers, and what is read from an earlier call.
    warn : callable
        Receives the warnings about the controllers.
    """

    samples: int = 200
    uncertain: Sequence[str] = ()
    output: PathLike | None = None
    workers: int | Workers = 1
    report: Report = _silent
    warn: Callable[[Sequence[str]], object] = _silent


VERIFICATION = Verification()
"""Options where none are given."""


@dataclass(frozen=True)
class StoredDesigns:
    """Gammas and margins of the stored designs.

    Parameters
    ----------
    values : mapping
        As the JSON object of ``los-testbed design verify``.
    failures : tuple of str
        One line for each loop that is unstable, or requirement that the robust design violates.
    """

    values: Mapping[str, Any]
    failures: tuple[str, ...]


def design(
    output: PathLike | None,
    *,
    parameters: PathLike | None = None,
    uncertain: Sequence[str] = (),
    effort: str = "full",
    nominal: bool = False,
    seed: int = 0,
    time_limit: float = 3600.0,
    workers: int | Workers = 1,
    resume: bool = True,
    certify: bool = False,
    report: Report = _silent,
) -> DesignResult:
    """Design K_FSM and K_PMA for a telescope, find their worst points and verify them; optionally, prove their figures.

    Parameters
    ----------
    output : path
        Folder of the designs, for ``designs=`` of :func:`los_testbed.api.run`. Its ``telescope.toml`` is the parameter
        file, with copies of the files that it names.
    parameters : path, optional
        Parameter file; default: the reference telescope.
    uncertain : sequence of str
        Further uncertain factors, as ``isolator.stiffness=10%``.
    effort : {"full", "short"}
    nominal : bool
        Tune for the nominal parameters only.
    seed, time_limit, resume
        As the options of ``los-testbed design all``.
    workers : int or Workers
        Processes of searches, verification and proofs. The result does not depend on them.
    certify : bool
        Prove all figures below their limits and bundle the proofs.
    report : callable
        Receives what the tuning does not consider, how the telescope differs from the reference, and what is proven.

    Raises
    ------
    InputError
        An unreadable parameter file, a folder that is not writable, of another telescope, or of a shipped design.
    """
    folder = refuse_shipped(None if output is None else Path(output), "a folder for the designs")
    file = None if parameters is None else Path(parameters)
    if effort not in EFFORTS:
        raise InputError(f"--effort must be one of {', '.join(EFFORTS)}, got {effort}")
    telescope = load_telescope(file).with_uncertain(uncertain)
    if certify:
        refuse_other_rates(telescope.loop_ports.sensors, telescope.frame_ticks)
    new = not folder.exists()
    store_telescope(folder, file, uncertain)
    if unseen := sources_of_mission(None if file is None else str(file)):
        report(f"sources: the tuning does not consider {', '.join(unseen)}; the verification does")
    for line in unseen_requirements(telescope):
        report(line)
    for line in difference_summary(file or REFERENCE):
        report(f"telescope: {line}")
    mission = NO_MISSION

    def verify_further(tell: Report) -> tuple[Mapping[str, Any], list[str]]:
        nonlocal mission
        mission = verify_mission(folder, tell)
        return mission.to_mapping(), mission.not_met

    until = time.monotonic() + time_limit
    limit = ROUNDS_SHARE * time_limit if certify else time_limit
    options = DesignOptions(seed=seed, short=effort == "short", wall_limit=limit, nominal=nominal)
    with _workers(workers) as pool, removed_if_refused(folder, new):
        with Progress("design") as bar:
            summary = redesign.design_all(
                telescope,
                folder,
                options,
                resume=resume,
                report=bar.print,
                workers=pool,
                verify_further=verify_further,
            )
        bounds = prove_designs(telescope, folder, pool, until, report) if certify else []
    return DesignResult(folder, summary.check, tuple(summary.not_met), mission, tuple(bounds))


def prove_designs(
    telescope: Telescope, folder: Path, workers: Workers, until: float, report: Report = _silent
) -> list[FigureBounds]:
    """Bounds of all figures of the designs of a folder; the proofs and their bundle go there, too.

    Raises
    ------
    InputError
        The telescope of the folder is not `telescope`, or the controllers were made for another one.
    """
    stored, _, _ = load_folder(folder)
    if stored.parameters_hash != telescope.parameters_hash:
        raise InputError(
            f"{folder / TELESCOPE} must be of the telescope {telescope.parameters_hash} to be proven, "
            f"got {stored.parameters_hash}"
        )
    loops = loops_of(folder, stored.mirror_stages, same_telescope=True)
    chosen = figures_to_prove(stored, stored.mirror_stages)
    with one_thread():
        return prove_figures(chosen, loops, folder, prover_of(workers), until, workers=workers, report=report)


def certify(
    output: PathLike,
    *,
    designs: PathLike | None = None,
    stage: str | None = None,
    figure: str | None = None,
    level: float = 1.0,
    gap: float | None = None,
    uncertain: Sequence[str] = (),
    time_limit: float = 10800.0,
    workers: int | Workers = 1,
    report: Report = _silent,
    warn: Callable[[Sequence[str]], object] = _silent,
) -> list[FigureBounds]:
    """Prove figures of a pair of controllers for the whole box of parameters and all frequencies.

    Parameters
    ----------
    output : path
        Folder of the proofs, of ``bounds.json`` and ``bundle.zip``; proven parts in it are not proven again.
    designs : path, optional
        Folder of :func:`design`; default: the shipped pair.
    stage : {"fsm", "fsm+pma"}, optional
        Default: both.
    figure : str, optional
        Default: all gains from the disturbances.
    level, gap, uncertain, time_limit
        As the options of ``los-testbed design certify``.
    workers : int or Workers
    report : callable
        Receives a line for each figure.
    warn : callable
        Receives the warnings about the controllers.

    Raises
    ------
    InputError
        An unknown stage or figure, controllers made for another telescope, a folder that is not writable.
    """
    pair = None if designs is None else Path(designs)
    telescope = load_telescope() if pair is None else load_folder(pair)[0]
    if stage not in (None, *telescope.mirror_stages):
        raise InputError(f"--stage must be one of {', '.join(telescope.mirror_stages)}, got {stage}")
    stages = telescope.mirror_stages if stage is None else (stage,)
    chosen = figures_to_prove(telescope, stages, figure)
    folder = Path(output)
    check_output(folder, "--output", folder=True)
    if folder.is_dir():
        check_output(folder / BOUNDS, f"{BOUNDS} in --output")
    load_bounds(folder / BOUNDS)  # another file of that name is refused before the work
    until = time.monotonic() + time_limit
    loops = loops_of(pair, telescope.mirror_stages, uncertain, same_telescope=True, warn=warn)
    with one_thread(), _workers(workers) as pool:
        return prove_figures(
            chosen,
            loops,
            folder,
            prover_of(pool),
            until,
            ProofLevel(level, gap),
            workers=pool,
            report=report,
        )


def unseen_requirements(telescope: Telescope) -> list[str]:
    """A line with the requirements that no figure of a design covers, if any."""
    unseen = [f"{one.name} ({one.exact_text})" for one in unseen_by_design(telescope.requirements)]
    if not unseen:
        return []
    return [f"requirements: the design does not consider {', '.join(unseen)}; runs are judged by them"]


def verify_folder(designs: PathLike, options: Verification = VERIFICATION) -> DesignResult:
    """Verify the pair of a folder of :func:`design`, also under the sources of its telescope's file.

    The parameter points are the nominal one, the corners, random ones and the worst ones that are stored.
    """
    telescope, k_fsm, k_pma = load_folder(folder := Path(designs))
    telescope = telescope.with_uncertain(options.uncertain)
    for line in unseen_requirements(telescope):
        options.report(line)
    options.warn(design_warnings((k_fsm, k_pma), telescope.design_basis, closed=True))
    with one_thread(), _workers(options.workers) as pool, Progress(f"{folder.name} as implemented") as bar:
        system = loop_plant(telescope, telescope.loop_ports.used_by(k_fsm, k_pma))
        adversarial = load_adversarial(folder) if (folder / WORST_POINTS).exists() else []
        at = [*verification_points(telescope, system, options.samples), *adversarial]
        step = _counter(bar, len(telescope.mirror_stages) * len(at))
        with _resumable(pool, options, telescope, (k_fsm, k_pma), at) as kept:
            check = check_implemented(system, telescope, k_fsm, k_pma, at, step, workers=kept)
            mission = verify_mission(folder, bar.print)
            not_met = (*broken_requirements(check), *mission.not_met)
            result = DesignResult(folder, check, not_met, mission)
            _write(options.output, result.to_mapping())
    return result


def verify_stored(options: Verification = VERIFICATION) -> StoredDesigns:
    """Verify the shipped designs, robust and nominal."""
    telescope = load_telescope().with_uncertain(options.uncertain)
    pair, nominal = (load_designs(variant) for variant in VERIFIED)
    for designs in (pair, nominal):
        options.warn(design_warnings(designs, telescope.design_basis, closed=True))
    system = control_loop_plant(telescope)
    at = [*verification_points(telescope, system, options.samples), *load_adversarial()]
    some = at[:: max(1, len(at) // NOMINAL_POINTS)]
    with (
        one_thread(),
        _workers(options.workers) as pool,
        _resumable(pool, options, telescope, (*pair, *nominal), at) as kept,
    ):
        with Progress("loops as implemented") as bar:
            step = _counter(bar, 2 * (len(at) + len(some) + 1))
            implemented = check_implemented(system, telescope, *pair, at, step, workers=kept)
            alone = check_implemented(system, telescope, *nominal, [{}], step, changes=False)
            spread = check_implemented(system, telescope, *nominal, some, step, changes=False, workers=kept)
        checks = {
            "robust design": implemented,
            "nominal design, nominal model": alone,
            "nominal design, uncertain model": spread,
        }
        values = {
            "implemented": implemented.to_mapping(),
            "nominal_design": {"nominal_model": alone.to_mapping(), "uncertain_model": spread.to_mapping()},
        }
        failed = failures(checks) + [f"robust design: {line}" for line in broken_requirements(implemented)]
        _write(options.output, {**values, "failures": failed})
    return StoredDesigns(values, tuple(failed))


@contextmanager
def _workers(workers: int | Workers) -> Iterator[Workers]:
    """Workers as they are, or new ones of a number of processes."""
    if isinstance(workers, Workers):
        yield workers
        return
    with Workers(workers) as pool:
        yield pool


def parts_file(output: Path) -> Path:
    """File of the finished parts of a verification, beside its output."""
    return output.with_name(f"{output.name}.parts")


@contextmanager
def _resumable(
    workers: Workers,
    options: Verification,
    telescope: Telescope,
    designs: Sequence[SampledSystem],
    at: Sequence[Any],
) -> Iterator[Workers]:
    """Workers that store their results beside the output until the verification is finished."""
    if options.output is None:
        yield workers
        return
    depends = {
        "software": [versions(), source_digest()],
        "telescope": telescope_digest(telescope),
        "points": [dict(values) for values in at],
        "designs": [one.to_json() for one in designs],
    }
    parts, done = parts_file(Path(options.output)), False
    kept = KeptWorkers(workers, Job("verification", depends, parts), RESULTS)
    if kept.known:
        options.report(f"{kept.known} parts are read from {parts}")
    try:
        yield kept
        done = True
    finally:
        kept.close(done)


def _write(output: PathLike | None, content: Mapping[str, Any]) -> None:
    if output is not None:
        write_text(Path(output), json.dumps(content, indent=1) + "\n")


def _counter(bar: Progress, total: int) -> Callable[[], None]:
    """Function that counts its calls on a progress bar."""
    calls = count(1)
    return lambda: bar.report(next(calls), total)
