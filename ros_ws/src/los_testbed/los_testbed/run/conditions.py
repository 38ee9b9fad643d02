"""Disturbances of a run and its member of the family, for its metadata: `pointing_analysis` reads them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointing_analysis.requirements.conditions import ACTING, LINES, MEMBER, WHEEL_SPEEDS
from titop_plant.telescope.uncertain_parameters import moves

if TYPE_CHECKING:
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.parts.start import RunStart


def conditions(parts: RunParts, start: RunStart) -> dict[str, str]:
    """Entries of the metadata; none of a run with another plant, of which it is not known."""
    from titop_plant.simulation.plant_config import start_speeds

    if parts.config.other_plant:
        return {}
    entries = {ACTING: json.dumps(acting(parts, start)), MEMBER: member(parts)}
    if parts.config.motion_from_file:
        return entries
    return {**entries, WHEEL_SPEEDS: json.dumps(start_speeds(parts.config, parts.telescope))}


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
    """Angle of the arrays, speeds of the wheels and other parameters that are given, at the start of the run."""
    from titop_plant.simulation.plant_config import start_speeds, stated_values

    config, known = parts.config, parts.telescope.uncertain
    stated = {name: value for name, value in stated_values(config, parts.telescope).items() if not moves(name)}
    texts = [f"{name} {value:.6g}{known[name].in_unit}" for name, value in stated.items()] or ["frequencies nominal"]
    if config.motion_from_file:
        return ", ".join([f"arrays and wheels as in {Path(config.profile).name}", *(texts if stated else ())])
    speeds = ", ".join(f"{speed:.6g}" for speed in start_speeds(config, parts.telescope))
    first = [f"arrays at {config.array_angle:.6g} rad"] if parts.telescope.arrays_turn else []
    return ", ".join([*first, *([f"wheels at {speeds} rad/s"] if speeds else []), *texts])
