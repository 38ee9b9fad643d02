"""Disturbances of a run and its member of the family, for its metadata: `pointing_analysis` reads them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointing_analysis.requirements.conditions import ACTING, LINES, MEMBER, WHEEL_SPEEDS

if TYPE_CHECKING:
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.parts.start import RunStart


def conditions(parts: RunParts, start: RunStart) -> dict[str, str]:
    """Entries of the metadata; none of a run with another plant, of which it is not known."""
    if parts.config.other_plant:
        return {}
    speeds = {} if parts.config.motion_from_file else {WHEEL_SPEEDS: json.dumps(wheel_speeds(parts))}
    return {ACTING: json.dumps(acting(parts, start)), MEMBER: member(parts), **speeds}


def wheel_speeds(parts: RunParts) -> tuple[float, ...]:
    """Speeds of the wheels at the start [rad/s]: of the configuration, else of the parameter file."""
    return parts.config.wheel_speed or parts.telescope.default_speeds


MOST_LINES = 100
"""Frequencies of a source that are stated."""


def acting(parts: RunParts, start: RunStart) -> list[dict[str, Any]]:
    """Scenario, user's disturbance and sources, each with name, kind and details; of sources with tones the lines."""
    config = parts.config
    entries: list[dict[str, Any]] = []
    if config.scenario_acts:
        tone = start.tone
        text = ""
        if tone is not None:
            index = f"{tone.index} tones" if tone.index in ("slow", "fast") else tone.index
            text = f"tone of {tone.omega / (2 * math.pi):.4g} Hz, worst for the {index}"
        entries.append({"name": str(config.scenario), "kind": "scenario", "what": text})
    if config.disturbance and config.disturbance_source:
        entries.append({"name": config.disturbance_source, "kind": "code", "what": "code of the user"})
    for source in parts.sources:
        lines = [float(f"{line:.9g}") for line in source.signal.lines[:MOST_LINES]]
        entry = {"name": source.name, "kind": source.kind, "what": f"{source.kind} at {source.place}"}
        entries.append({**entry, **({LINES: lines} if lines else {})})
    return entries


def member(parts: RunParts) -> str:
    """Angle of the arrays, speeds of the wheels and uncertain frequencies, at the start of the run."""
    from titop_plant.simulation.plant_config import frequencies

    config = parts.config
    if config.motion_from_file:
        return f"arrays and wheels as in {Path(config.profile).name}"
    speeds = ", ".join(f"{speed:.6g}" for speed in wheel_speeds(parts))
    texts = [f"arrays at {config.array_angle:.6g} rad"] if parts.telescope.arrays_turn else []
    texts += [f"wheels at {speeds} rad/s"] if speeds else []
    natural = frequencies(config, parts.telescope)
    texts += [f"{name} {value:.6g} rad/s" for name, value in natural.items()] or ["frequencies nominal"]
    return ", ".join(texts)
