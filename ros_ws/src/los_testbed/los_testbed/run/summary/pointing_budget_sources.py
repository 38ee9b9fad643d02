"""Sources of a pointing budget from the testbed's own closed loop: tones of the disturbance, noise by sensor.

Everything is the steady state of the loop as implemented: plant sampled at 1 kHz, commands one tick late, camera held
between its frames. Windows are those of the analysis, whole numbers of ticks; noise is averaged over the position of
the window in the camera's frame period.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from los_loop.noise import correlation, covariances_in_window
from los_loop.sampled_loop import SampledLoop
from los_loop.tone_model import ToneModel
from los_testbed.config.members import MEMBER
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.source_alone import errors_of_source
from pointing_analysis.budget import sources as kinds
from pointing_analysis.budget.sources import ErrorSource
from pointing_analysis.files.settings import refuse_unknown
from pointing_analysis.indices.metrics import samples_or_one
from pointing_analysis.requirements.requirement import Requirement
from titop_plant.interface import DT, MIRROR_STAGES, STAGES
from titop_plant.sensors import MEASURED_SENSORS

GROUPS = {entry.port.name: entry.group for entry in MEASURED_SENSORS}
PARTS = ("tones", "noise", "sources", "all")
SETTINGS = {
    *MEMBER,
    *("parameters", "k_fsm", "k_pma", "camera_rate"),
    *("disturbance_files", "duration"),
}


def testbed_sources(path: tuple[str, ...], table: Mapping[str, Any], unit: float) -> list[ErrorSource]:
    """Sources of a table of type ``testbed``.

    Parameters
    ----------
    path : tuple of str
        Of the table in the tree.
    table : mapping
        ``loop``, ``scenario``, ``seed``; ``part``: ``tones``, ``noise``, ``sources`` (files of disturbances) or
        ``all`` (default); ``settings``: of the run.
    unit : float
        Unit of the budget [rad].

    Raises
    ------
    ValueError
        A part, a stage or a setting that does not exist, or a loop that is unstable.
    """
    part = table.get("part", "all")
    if part not in PARTS:
        raise InputError(f"{' / '.join(path)}: part must be one of {', '.join(PARTS)}, got {part!r}")
    settings = dict(table.get("settings", {}))
    refuse_unknown(settings, sorted(SETTINGS), ".".join(("sources", *path, "settings")))
    values = {key: table[key] for key in ("loop", "scenario", "seed") if key in table}
    config = RunConfig.from_mapping({**settings, **values})
    parts = RunParts(config)
    model = parts.tone_model()
    if not model.loop.spectral_radius() < 1:
        raise InputError(f"{' / '.join(path)}: loop must be stable, got a spectral radius of 1 or more")
    sources = []
    if part in ("tones", "all"):
        sources += _tones(path, model, unit)
    if part in ("sources", "all"):
        sources += _of_files(path, parts, unit)
    if part in ("noise", "all") and config.loop in MIRROR_STAGES and config.noise:
        sources += _noise(path, model.loop, unit)
    return sources


def with_designs(table: Mapping[str, Any], designs: str | None, parameters: Path | None = None) -> Mapping[str, Any]:
    """A table of type ``testbed`` for the controllers of a folder of designs, and its telescope or that of a file.

    Its own settings win. A stage that the telescope does not have is its last one.

    Raises
    ------
    ValueError
        A controller is missing.
    """
    if designs is None and parameters is None:
        return table
    telescope_file = {} if parameters is None else {"parameters": str(parameters)}
    settings = {**of_designs(designs or ""), **telescope_file, **dict(table.get("settings", {}))}
    telescope = RunParts(RunConfig.from_mapping(settings)).telescope
    stages, loop = telescope.stages, table.get("loop", RunConfig().loop)
    return {**table, "settings": settings, "loop": loop if loop in stages or loop not in STAGES else stages[-1]}


def testbed_requirements(table: Mapping[str, Any]) -> tuple[Requirement, ...]:
    """Requirements of the telescope of a table of type ``testbed``, those of its stage."""
    config = RunConfig.from_mapping({**dict(table.get("settings", {})), "loop": table.get("loop", RunConfig().loop)})
    return tuple(r for r in RunParts(config).telescope.requirements if not r.loops or config.loop in r.loops)


def _tones(path: tuple[str, ...], model: ToneModel, unit: float) -> list[ErrorSource]:
    """One source for each tone; tones of one frequency on several channels are one."""
    with one_thread():
        phasors = model.settled() / unit
    hertz = [float(w) / (2.0 * np.pi) for w in model.omega]
    digits = next(n for n in range(3, 17) if len({f"{f:.{n}f}" for f in hertz}) == len(hertz))
    return [
        kinds.tones((*path, f"tone {f:.{digits}f} Hz"), [w], phasors[:, i : i + 1], DT)
        for i, (w, f) in enumerate(zip(model.omega, hertz))
    ]


def _of_files(path: tuple[str, ...], parts: RunParts, unit: float) -> list[ErrorSource]:
    """One source for each file or table of disturbances: a run of the loop under it alone, start-up left out."""
    return [
        kinds.measured((*path, source.name), errors_of_source(parts, i, parts.config.ticks) / unit, DT)
        for i, source in enumerate(parts.sources)
    ]


def _noise(path: tuple[str, ...], loop: SampledLoop, unit: float) -> list[ErrorSource]:
    """One source for each group of sensors, and for each sensor at a place."""
    ports, sources = loop.ports, list[ErrorSource]()
    sigma = ports.noise
    groups = [GROUPS.get(sensor.port.name, sensor.port.name) for sensor in ports.sensors]
    for name in dict.fromkeys(groups):
        chosen = np.zeros_like(sigma)
        rows = ports.measured_columns(row.port for row, group in zip(ports.sensors, groups) if group == name)
        chosen[rows] = sigma[rows]
        if not chosen.any():
            continue
        with one_thread():
            correlated = correlation(loop, chosen, unit)
        sources.append(kinds.gaussian((*path, f"noise, {name}"), correlated(0), _within(correlated), "noise"))
    return sources


def _within(correlated: Callable[[int], FloatArray]) -> Callable[[float], FloatArray]:
    """Covariance of the line of sight less its mean over a window [s], at each of its ticks."""

    @cache
    def within(window: float) -> FloatArray:
        return covariances_in_window(correlated, samples_or_one(window, DT))

    return within
