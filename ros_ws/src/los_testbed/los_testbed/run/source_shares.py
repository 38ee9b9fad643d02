"""What each source of a run's disturbance files does to the line of sight: the loop with that source alone.

The loop is the one of the run as implemented, without noise of the sensors and without the other sources; it is linear
while no command is limited. So the squares of the relative errors of independent sources add up to that of the run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from lftkit.support.threads import one_thread
from los_testbed.config import RunConfig
from los_testbed.factories import RunParts
from los_testbed.loop.simulate import SampleBlock, simulate
from los_testbed.run.replay import controller_of
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.indices.errors import default_transient
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.report.source_share import SourceShare
from pointing_analysis.requirements.summary import Performance
from titop_plant.interface import DT
from titop_plant.simulation.driven_plant import DrivenPlant
from titop_plant.simulation.sources.drive import Sources, source_matrix

LONGEST = 20.0
"""Seconds of a run that are simulated for each source."""


def source_shares(run: Recording) -> tuple[SourceShare, ...]:
    """Shares of the sources of a bag; empty where it has none.

    Raises
    ------
    ValueError
        The files of the sources, or the telescope, are no longer those of the run.
    """
    if not isinstance(run, Run) or "disturbances" not in run.parameters or "run.yaml" not in run.attachments:
        return ()
    config = RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "run.yaml of the bag"))
    parts = RunParts(config, {name: controller_of(run, name)[0] for name in ("k_fsm", "k_pma")})
    if parts.sources_digest != run.parameters.get("disturbances_sha256"):
        raise ValueError("the files of the disturbances are no longer those of the run: no shares of them")
    errors = [_errors(parts, i) for i in range(len(parts.sources))]
    total = math.fsum(error.rpe_rms**2 for error in errors)
    return tuple(
        SourceShare(one.name, one.kind, one.place, e.ape_p997, e.rpe_rms, e.rpe_rms**2 / total if total else 0.0)
        for one, e in zip(parts.sources, errors)
    )


def _errors(parts: RunParts, index: int) -> Performance:
    """Errors of the loop with one source alone."""
    quiet = replace(parts.config, start="rest", noise=False, disturbance=False)
    alone = RunParts(quiet, parts.recorded)
    source = parts.sources[index : index + 1]
    with one_thread():
        telescope = alone.family.build(alone.settings, np.zeros(alone.family.control_loop.order))
        matrix = source_matrix(alone.family, alone.settings, source, telescope.dt)
    plant = DrivenPlant(telescope, matrix, Sources(source, telescope.dt), source[0].name)
    estimator, controller = alone.estimator(), alone.controller()
    for part in (plant, estimator, controller):
        part.reset()
    ticks = min(parts.config.ticks, round(LONGEST / DT))
    found = np.zeros((ticks, 2))
    done = 0

    def keep(block: SampleBlock, rows: int) -> None:
        nonlocal done
        found[done : done + rows] = block.truth[:rows]
        done += rows

    with one_thread():
        simulate(plant, estimator, controller, ticks, keep)
    return Performance.of(found[round(default_transient(ticks * DT) / DT) :], DT)


def as_rows(shares: Sequence[SourceShare]) -> list[dict[str, str | float]]:
    """Rows for JSON, six digits."""
    return [{k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in asdict(s).items()} for s in shares]
