"""Proven statements about the loop of a run, for its bag; without a proof, the reasons.

Proofs are of one loop (:mod:`los_loop.implemented_loop`): the linear telescope at any point of its box that does not
move, the camera of 50 frames per second of which none is lost, both laws each tick, and tones. A setting that
changes the loop, or is unknown here, leaves no proof.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from los_testbed.config.run_config import ACTIVE, RunConfig
from los_testbed.parts.run_parts import RunParts
from pointing_analysis.requirements import guarantee
from pointing_analysis.requirements.guarantee import METADATA as PROOF_BOUNDS
from pointing_analysis.requirements.image_guarantee import METADATA as PROOF_RPE
from pointing_analysis.units import ANGLES
from titop_plant.interface import MIRROR_STAGES

if TYPE_CHECKING:
    from los_design.verification.statements import Statement

ADMITTED = frozenset(
    {
        # tones, or none; noise of the sensors, or none
        *("scenario", "worst_of", "seed", "noise", "disturbance"),
        # members of the family: others are refused
        *("parameters", "theta", "tau", "wheel_speed", "omega_1", "omega_2", "frequencies"),
        # what acts only on samples and commands that come late or not at all
        *("hold_ticks", "fade_ticks", "old_frames", "lost_samples", "camera_latency"),
        # where and how long the same loop runs, and how it starts
        *("loop", "duration", "mode", "start", "output", "namespace", "domain", "priority", "pin"),
        *("processes", "exercise", "max_missed", "hang_timeout", "mode_choice"),
        *("wait_for_recorder", "wait_for_start", "start_timeout"),
        # of a device, which is none of these
        *("device_address", "device_key"),
    }
)
"""Settings that a proof admits with any value."""

MOTION = ("theta_rate", "wheel_acceleration", "ramp_duration", "profile")
"""Settings that make the telescope move, each together with others."""

JUDGED = frozenset(
    {
        *MOTION,
        *("fsm_authority", "pma_authority"),
        *("disturbance_source", "disturbance_files"),
        *("k_fsm", "k_pma", "ports_in_order"),  # the controllers as they are read
    }
)
"""Settings that a proof admits with some values, see :func:`reasons_against`; any other must have its default."""

PROOF_KEYS = ("proof", guarantee.NOISE, PROOF_RPE, PROOF_BOUNDS)
"""Keys of a bag's metadata that :func:`proof_of` makes."""

OTHER_LOOP = ("loop", "camera_dropout", "fsm_authority", "pma_authority")
"""Settings whose change during a run makes another loop."""


def proof_of(parts: RunParts, statistics: Mapping[str, Mapping[str, str]] | None = None) -> dict[str, str]:
    """Proven bounds of a run's loop: lines under ``proof`` and ``proof_noise``; bound of the RPE under ``proof_rpe``.

    Bounds with noise are under ``proof_bounds`` (:mod:`pointing_analysis.requirements.guarantee`), also of a run of
    which there is no proof for nothing else than ticks with an older command. Nothing for a stage without fine control.

    Parameters
    ----------
    parts : RunParts
    statistics : mapping, optional
        Of each node, at the end of the run: ticks without a command, and changes by request, leave no proof.
    """
    config = parts.config
    if config.loop not in MIRROR_STAGES:
        return {}
    from los_design.verification.statements import NO_PROOF, statement_of
    from los_design.verification.subject import Subject

    missed, changed = _missed(statistics or {}), _happened(statistics or {})
    late = [f"{_ticks(missed)} had an older command"] * (missed > 0)
    against = [*reasons_against(parts), *changed]
    if against:
        return {"proof": f"no proof of this run: {'; '.join([*late, *against])}"}
    folders = {path.parent for path in parts.files.values()}
    folder = folders.pop() if len(folders) == 1 else None
    subject = Subject.of(**parts.models, telescope=parts.telescope.digest)
    found = statement_of(subject, config.loop, folder, parts.telescope)
    if found is None:
        return {"proof": NO_PROOF}
    bounds = _bounds(parts, found, missed)
    if late:
        return {"proof": f"no proof of this run: {late[0]}", **bounds}
    stated = bounds | {"proof": found.text} | ({guarantee.NOISE: found.noise_text} if found.noise_text else {})
    if found.relative is None:
        return stated
    window = parts.telescope.weights.rpe_window
    return {**stated, PROOF_RPE: json.dumps({"rms_rad": found.relative, "exposure_s": window})}


def _bounds(parts: RunParts, found: Statement, missed: int) -> dict[str, str]:
    """Bounds with noise, for the tone of norm 1 that the scenario makes, or for none; nothing for others."""
    from los_design.verification.error_sum import WITH_NOISE

    config = parts.config
    if not found.sums or not (config.scenario == "worst_case" or not config.scenario_acts):
        return {}
    kinds = {
        "APE": guarantee.ABSOLUTE,
        "slow tone": guarantee.SLOW,
        "fast tone": guarantee.FAST,
        "both": guarantee.BOTH,
    }
    content = {kinds[WITH_NOISE[row.name]]: (row.value * ANGLES[row.unit], row.probability) for row in found.sums}
    window = parts.telescope.weights.rpe_window
    return {PROOF_BOUNDS: json.dumps({**content, "window_s": window, "condition": _ticks(missed, "missed ")})}


def reasons_against(parts: RunParts) -> list[str]:
    """Why no proof is of a run with these settings, one phrase each; empty where one may be.

    Examples
    --------
    >>> reasons_against(RunParts(RunConfig(scenario="imbalance", seed=7)))
    []
    >>> reasons_against(RunParts(RunConfig(scenario="imbalance", camera_dropout=0.5, nonlinear=True)))
    ['nonlinear is on, proofs have off', 'camera_dropout is 0.5, proofs have 0']
    """
    config = parts.config
    found = [
        f"{name} is {_shown(value)}, proofs have {_shown(setting.default)}"
        for name, setting in RunConfig.SETTINGS.items()
        if name not in ADMITTED | JUDGED and (value := getattr(config, name)) != setting.default
    ]
    found += [f"{name} is code: {text}" for name, text in parts.code.items()]
    if config.other_plant:
        return found  # nothing more is known of it
    found += [
        f"{name} uses {', '.join(port.name for port in ports.further)} of the telescope's file"
        for name, ports in ({} if parts.code else parts.used).items()  # code is not made for its ports
        if ports.further and parts.acts(name)
    ]
    own = parts.telescope.design_basis
    found += [
        f"{name} is {limit:g}, proofs have the telescope's {proven:g}"
        for name in ("fsm_authority", "pma_authority")
        if (limit := getattr(parts.basis, name)) != (proven := getattr(own, name))
    ]
    moved = any(getattr(config, name) != RunConfig.SETTINGS[name].default for name in MOTION)
    if moved and parts.settings.ramps:  # most runs need not load for it what builds a plant
        found.append("array angle or wheel speeds vary")
    if (config.disturbance_source and config.disturbance) or parts.sources:
        found.append("other disturbances than the tones of the scenario act")
    if parts.star_camera is not None:
        found.append("the camera takes images")
    return found


def _shown(value: Any) -> str:
    """A value of a setting."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _missed(statistics: Mapping[str, Mapping[str, str]]) -> int:
    """Ticks for which no command came in time."""
    missed = str(statistics.get("plant", {}).get("missed_ticks", "0"))
    return int(missed) if missed.isdecimal() else 0


def _ticks(count: int, which: str = "") -> str:
    """Number of ticks in words; empty without any."""
    return f"{count} {which}{'tick' if count == 1 else 'ticks'}" if count else ""


def _happened(statistics: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Changes of the loop during the run, one phrase each."""
    plant = statistics.get("plant", {})
    found = ["plant is an object of a program"] if "plant" in plant else []
    rows = [row for values in statistics.values() for row in _changes(values.get("changes", ""))]
    changed = {str(row["name"]) for row in rows if row.get("name") in OTHER_LOOP}
    changed |= {"what was active" for row in rows if row.get("name") == ACTIVE and not row.get("value")}
    return found + [f"{name} changed" for name in sorted(changed)]


def _changes(text: str) -> list[dict[str, Any]]:
    """Changes that a node reports (:meth:`los_testbed.run.loop.changes.Changes.record`), if it is such a list."""
    with contextlib.suppress(ValueError, TypeError, RecursionError):
        rows = json.loads(text)
        return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return []
