"""Control design for a telescope, from its parameters to a folder of verified designs.

The folder holds ``k_fsm.json``, ``k_pma.json``, ``worst_points.json`` and ``verification.json``. A step whose file is
there and was made for the same parameters, seed and effort is not repeated, and a design of the controllers goes on
in its descent or after its last search (``rounds.json``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.job import Job
from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from los_design.files import CONTROLLERS, ROUNDS, VERIFICATION, WORST_POINTS
from los_design.search.worst_case_search import Search, SearchOptions
from los_design.search.worst_points import (
    WorstPoint,
    load_worst_points,
    store_worst_points,
    worst_of,
)
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import law_digest
from los_design.synthesis.store import of_shipped_designs
from los_design.synthesis.synthesis import design_pair
from los_design.verification.verification import (
    ImplementedCheck,
    broken_requirements,
    check_implemented,
    verification_points,
)
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import LOOP_DELAY, MIRROR_STAGES, STAGES
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.telescope import Telescope

Report = Callable[[str], None]
PAIR = DesignOptions(wall_limit=3600.0)
"""Options where none are given."""
OUT_OF_TIME = "out_of_time"
SAMPLES = {"full": 200, "short": 20}
"""Random parameter points of the verification, beside the nominal one and corners."""
EVERY = {"full": 1, "short": 8}
"""Each of so many corners of the box is among these points."""
SEARCHES = {
    "full": SearchOptions(ascents=150, seed=77, members=60),
    "short": SearchOptions(frequencies=200, points=40, ascents=40, iterations=20, seed=77),
}


@dataclass(frozen=True)
class DesignSummary:
    """Result of :func:`design_all`.

    Parameters
    ----------
    folder : Path
    check : ImplementedCheck
        Of the pair, at verification points and at the worst points found.
    not_met : list of str
        One line for each requirement that is not met; empty if all are.
    further : mapping
        What else was verified, see :func:`design_all`.
    """

    folder: Path
    check: ImplementedCheck
    not_met: list[str]
    further: Mapping[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return not self.not_met

    @property
    def gammas(self) -> dict[str, list[float]]:
        """Gammas in the paper's order, mirror alone and with the proof-mass actuators where there are any."""
        return self.check.gammas


def design_all(
    telescope: Telescope,
    folder: Path,
    options: DesignOptions = PAIR,
    *,
    report: Report = lambda text: None,
    resume: bool = True,
    workers: Workers | None = None,
    verify_further: Callable[[Report], tuple[Mapping[str, Any], list[str]]] = lambda report: ({}, []),
) -> DesignSummary:
    """Design K_FSM and K_PMA for a telescope, find their worst points and verify them.

    Parameters
    ----------
    telescope : Telescope
        Of :func:`titop_plant.telescope.load.load_telescope`.
    folder : Path
        Made if it does not exist.
    options : DesignOptions
        Of the implemented loop. The wall limit is that of the rounds; the last thorough search and the verification
        come after it, and a design that it ended goes on in another call. With less effort there are also fewer
        points in searches and verification. Of a nominal design, too, the verification is that of the whole box.
    report : callable
        Receives one line for each step and round.
    resume : bool
        Keep the steps that are there already.
    workers : Workers, optional
        Processes of searches and verification; default: as many as the options say. The result does not depend on
        them.
    verify_further : callable
        Verifies more of the designs, which are in the folder when it is called: content for ``verification.json``, and
        a line for each requirement that is not met.

    Raises
    ------
    ValueError
        Another loop delay than that of the testbed, or a folder that cannot be written to.
    """
    if options.loop_delay != LOOP_DELAY:
        raise InputError(f"loop_delay must be that of the testbed, {LOOP_DELAY:g} s, got {options.loop_delay:g}")
    # Make the folder and a file in it before hours of work
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"output must be a folder that can be written to, got {folder}: {error.strerror}") from None
    effort = _effort(options)
    with one_thread(), Workers(options.workers) as started:
        workers = workers or started
        options = replace(options, workers=workers.count)
        k_fsm, k_pma = _pair(folder, telescope, options, resume, report, workers)
        report("worst points of the stages")
        worst_points = search_stages(telescope, k_fsm, k_pma, SEARCHES[effort], workers)
        adversarial = adversarial_points(worst_points, (k_fsm, k_pma))
        basis = {"parameters_hash": telescope.parameters_hash, "k_fsm": law_digest(k_fsm), "k_pma": law_digest(k_pma)}
        worst = [replace(p, requirement=name) for table in worst_points.values() for name, p in worst_of(table).items()]
        store_worst_points(folder / WORST_POINTS, worst, basis, adversarial)
        system = loop_plant(telescope, telescope.loop_ports.used_by(k_fsm, k_pma))
        at = verification_points(telescope, system, SAMPLES[effort], options.seed + 1, EVERY[effort])
        report(f"verification at {len(at) + len(adversarial)} parameter points")
        check = check_implemented(system, telescope, k_fsm, k_pma, [*at, *adversarial], workers=workers)
    further, lines = verify_further(report)
    not_met = [*broken_requirements(check), *lines]
    content = {"implemented": check.to_mapping(), **further, "not_met": not_met}
    write_text(folder / VERIFICATION, json.dumps(content, indent=1) + "\n")
    return DesignSummary(folder, check, not_met, further)


def search_stages(
    telescope: Telescope,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    options: SearchOptions,
    workers: Workers | None = None,
) -> dict[str, dict[str, list[WorstPoint]]]:
    """Worst points of all bands by stage and requirement: APE, slow and fast tones, and what else a stage has.

    The worst points that the design of these controllers found are climbed from, too, and on the reference telescope
    those of the stored designs.
    """
    ports = telescope.loop_ports.used_by(k_fsm, k_pma)
    open_loops = {
        isolated: OpenLoop(loop_plant(telescope, ports, isolated=isolated), telescope, ports)
        for isolated in {stage != STAGES[0] for stage in telescope.stages}
    }
    stages = telescope.stages
    known: dict[str, list[WorstPoint]] = {stage: [] for stage in stages}
    if of_shipped_designs(telescope):
        known |= {stage: [*points.values()] for stage, points in load_worst_points().items()}
    for stage, system in zip(telescope.mirror_stages, (k_fsm, k_pma)):
        known[stage] += [_found_in_design(stage, case) for case in system.provenance.get("worst_cases", [])]
    return {
        stage: Search(ImplementedLoop(open_loops[stage != STAGES[0]], k_fsm, k_pma, stage), options).run(
            starts=known[stage], workers=workers
        )
        for stage in stages
    }


def _found_in_design(stage: str, case: Mapping[str, Any]) -> WorstPoint:
    """A worst case of a provenance as a start: frequency and parameters."""
    none = np.zeros(0, dtype=complex)
    value, omega = float(case["value"]), float(case["omega"])
    return WorstPoint(stage, case["requirement"], value, 1.0, omega, dict(case["parameters"]), none, none)


def adversarial_points(
    worst_points: Mapping[str, Mapping[str, Sequence[WorstPoint]]], pair: Sequence[SampledSystem]
) -> list[dict[str, float]]:
    """Different parameters of the worst points of all bands with fine control, and those that a design was tuned at."""
    fine = [worst_points[stage] for stage in MIRROR_STAGES if stage in worst_points]
    points = [dict(p.parameters) for tables in fine for table in tables.values() for p in table]
    points += [dict(values) for system in pair for values in system.provenance.get("active_models", []) if values]
    return list({tuple(values.items()): values for values in points}.values())


def _effort(options: DesignOptions) -> str:
    return "short" if options.short else "full"


def _key(telescope: Telescope, options: DesignOptions) -> dict[str, Any]:
    """What a design is the same for."""
    effort = _effort(options)
    key: dict[str, Any] = {"parameters_hash": telescope.parameters_hash, "seed": options.seed, "effort": effort}
    placed = telescope.placed_sensors or telescope.placed_actuators  # sensors are not part of the hash
    devices = {"devices": _devices(telescope)} if placed else {}
    return {**key, **devices, **({"nominal": True} if options.nominal else {})}


def _devices(telescope: Telescope) -> str:
    """Devices at places as the key of a design has them in its files: a design goes on where this text is the same."""
    sensors, actuators = telescope.placed_sensors, telescope.placed_actuators
    noise = tuple(value for row in sensors for value in row.noise.tolist())
    measured, commanded = tuple(row.port for row in sensors), tuple(row.port for row in actuators)
    units = tuple(row.scale for row in actuators)
    return f"Placed(sensors={measured}, actuators={commanded}, noise={noise}, units={units})"


def _pair(
    folder: Path,
    telescope: Telescope,
    options: DesignOptions,
    resume: bool,
    report: Report,
    workers: Workers,
) -> tuple[SampledSystem, SampledSystem]:
    """The designs in the folder if they were made with the same key; otherwise made, or continued, and written."""
    key = _key(telescope, options)
    files, job = [folder / name for name in CONTROLLERS.values()], Job("design", key, folder / ROUNDS)
    if resume and all(path.exists() for path in files):
        k_fsm, k_pma = (SampledSystem.from_file(path) for path in files)
        same = all(system.provenance.get("design_all") == key for system in (k_fsm, k_pma))
        if same and not (k_fsm.provenance["status"] == OUT_OF_TIME and job.record.exists()):
            report("k_fsm.json, k_pma.json: kept")
            return k_fsm, k_pma
    if not resume:
        job.finish()
    made = design_pair(telescope, options, report, job, workers)
    k_fsm, k_pma = (replace(system, provenance={**system.provenance, "design_all": key}) for system in made)
    k_fsm.to_file(files[0])
    k_pma.to_file(files[1])
    if k_fsm.provenance["status"] != OUT_OF_TIME:
        job.finish()
    report(f"k_fsm.json, k_pma.json: {k_fsm.provenance['status']}")
    return k_fsm, k_pma
