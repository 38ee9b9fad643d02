"""What each source of a run's disturbance files does to the line of sight (:mod:`los_testbed.loop.source_alone`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

from los_testbed.config import RunConfig
from los_testbed.factories import RunParts
from los_testbed.loop.source_alone import errors_of_source
from los_testbed.run.replay import controller_of
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.report.source_share import SourceShare
from pointing_analysis.requirements.summary import Performance
from titop_plant.interface import DT

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
    ticks = min(config.ticks, round(LONGEST / DT))
    errors = [Performance.of(errors_of_source(parts, i, ticks), DT) for i in range(len(parts.sources))]
    total = math.fsum(error.rpe_rms**2 for error in errors)
    return tuple(
        SourceShare(one.name, one.kind, one.place, e.ape_p997, e.rpe_rms, e.rpe_rms**2 / total if total else 0.0)
        for one, e in zip(parts.sources, errors)
    )


def as_rows(shares: Sequence[SourceShare]) -> list[dict[str, str | float]]:
    """Rows for JSON, six digits."""
    return [{k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in asdict(s).items()} for s in shares]
