"""Proven statements about the loop of a run; without a proof, the reasons.

Proofs are of one loop (:mod:`los_loop.implemented_loop`): the linear telescope at any point of its box that does not
move, the camera of 50 frames per second of which none is lost, both laws each tick, and tones that have acted since
long ago: a start at rest, or a tone that begins, makes a free motion that no proof bounds. A setting that changes the
loop, or is unknown here, leaves no proof.
"""

from __future__ import annotations

from typing import Any

from los_design.verification.error_sum import WITH_NOISE
from los_design.verification.statements import Statement, statement_of
from los_design.verification.subject import Subject
from los_testbed.config.members import MEMBER
from los_testbed.config.run_config import STEADY, RunConfig
from los_testbed.parts.run_parts import RunParts
from pointing_analysis.requirements.guarantee import ErrorBounds, ProvenBound
from pointing_analysis.units import ANGLES

ADMITTED = frozenset(
    {
        # tones, or none; noise of the sensors, or none
        *("scenario", "worst_of", "seed", "noise", "disturbance"),
        # members of the family: others are refused
        *("parameters", *MEMBER),
        # what acts only on samples and commands that come late or not at all
        *("hold_ticks", "fade_ticks", "old_frames", "lost_samples", "camera_latency"),
        # where and how long the same loop runs
        *("loop", "duration", "mode", "output", "namespace", "domain", "priority", "pin"),
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
        "start",
        "camera_rate",
        *("fsm_authority", "pma_authority"),
        *("disturbance_source", "disturbance_files"),
        *("k_fsm", "k_pma", "ports_in_order"),  # the controllers as they are read
    }
)
"""Settings that a proof admits with some values, see :func:`reasons_against`; any other must have its default."""


def proof_of(parts: RunParts) -> Statement | None:
    """What is proven of the controllers of a run on its telescope, for its stage; None where no bundle fits.

    It is of the run where nothing is against it (:func:`reasons_against`) and where its record shows that this loop ran
    (:mod:`los_testbed.run.summary.ran_loop`). A ProofError says why a bundle cannot be read.
    """
    folders = {path.parent for path in parts.files.values()}
    folder = folders.pop() if len(folders) == 1 else None
    subject = Subject.of(**parts.models, telescope=parts.telescope.digest)
    return statement_of(subject, parts.config.loop, folder, parts.telescope)


def bounds_of(parts: RunParts, proven: Statement) -> ErrorBounds | None:
    """Bounds with noise, for the tone of norm 1 that the scenario makes, or for none; None for other disturbances."""
    config, tone = parts.config, "both"
    if config.scenario_acts:
        if config.scenario != "worst_case" or parts.start.tone is None:
            return None
        tone = "slow tone" if parts.start.tone.omega <= parts.telescope.weights.band_edge else "fast tone"
    bounds = {
        WITH_NOISE[row.name]: ProvenBound(row.value * ANGLES[row.unit], row.probability)
        for row in proven.sums
        if row.probability is not None
    }
    return ErrorBounds(bounds.get("APE"), bounds.get(tone), parts.telescope.weights.rpe_window) if bounds else None


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
    reasons = [
        f"{name} is {_shown(value)}, proofs have {_shown(setting.default)}"
        for name, setting in RunConfig.SETTINGS.items()
        if name not in ADMITTED | JUDGED and (value := getattr(config, name)) != setting.default
    ]
    if config.other_plant:
        return reasons  # nothing more is known of it
    for name, ports in parts.used.items():  # devices at places are not part of the telescope's hash
        placed = [row.name for row in ports.sensors if row.mount is not None]
        placed += [row.name for row in ports.actuators if row.mount is not None]
        if placed and parts.acts(name):
            reasons.append(f"{name} uses {', '.join(placed)} of the telescope's file")
    telescope = parts.telescope
    of_run = {"camera_rate": (config.camera_rate, telescope.camera_rate)}
    of_run |= {
        name: (getattr(parts.basis, name), getattr(telescope.design_basis, name))
        for name in ("fsm_authority", "pma_authority")
    }
    reasons += [
        f"{name} is {value:g}, proofs have the telescope's {proven:g}"
        for name, (value, proven) in of_run.items()
        if value != proven
    ]
    if config.start != STEADY:
        reasons.append("the run starts at rest, proofs are of the steady state")
    moved = any(getattr(config, name) != RunConfig.SETTINGS[name].default for name in MOTION)
    if moved and parts.settings.ramps:  # most runs need not load for it what builds a plant
        reasons.append("array angle or wheel speeds vary")
    if (config.disturbance_source and config.disturbance) or parts.sources:
        reasons.append("other disturbances than the tones of the scenario act")
    if parts.star_camera is not None:
        reasons.append("the camera takes images")
    return reasons


def _shown(value: Any) -> str:
    """A value of a setting."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)
