"""Metadata of a bag: configuration of the run, its origin, controllers and results."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

import yaml

from lftkit.support.input_files import read_bytes
from los_design.synthesis.provenance import commit
from los_testbed.config.plugins import source_hashes
from los_testbed.config.topics import sensor_topics
from los_testbed.parts.flight_library import LibraryLaw
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import AT_REST, START_FILE, RunStart
from los_testbed.parts.user_blocks import UserBlock, read_law
from los_testbed.run.conditions import conditions
from los_testbed.run.identity import DIGEST
from pointing_analysis.image.optics import METADATA as OPTICS
from pointing_analysis.image.optics import PUPIL
from pointing_analysis.read.mcap.bag_metadata import BUDGET, BUDGET_EDGE, METADATA_NAME
from pointing_analysis.read.recorded_sensors import RecordedSensor
from pointing_analysis.requirements.conditions import MEASURED, NEVER, START_UP
from pointing_analysis.requirements.requirement import entries
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES, RATE
from titop_plant.telescope.guide_camera import NOISE_CURVE, TABLE
from titop_plant.telescope.load import differences
from titop_plant.telescope.telescope import Telescope

NOTHING: Mapping[str, Mapping[str, str]] = MappingProxyType({})

__all__ = ["METADATA_NAME", "attachments", "final_metadata", "run_metadata"]


AUTHORITY = "actuator_authority"
"""Key of the largest values of actuators at places [N, Nm]."""


def run_metadata(
    parts: RunParts, start: RunStart = AT_REST, statistics: Mapping[str, Mapping[str, str]] = NOTHING
) -> dict[str, str]:
    """Configuration, constants of the loop and the telescope, digest of the plant, software and commit.

    ``fsm_authority`` and ``pma_authority`` are the limits in force, also where the configuration leaves them to the
    telescope. ``los_sensitivity`` is the telescope's, ``fsm_frequency`` and ``fsm_damping`` are those of its mirror, in
    a run with a device; ``controller_warnings`` says which controllers were made for
    other parameters or limits, and is missing where none was. ``transient_s`` is 0 for a run that starts in its steady
    state; it is missing for one that does not, and ``start_up`` says that its length is measured in the record.
    ``telescope_differences`` says in which values a parameter file differs from the reference.
    ``requirements`` are those of the telescope, by which the bag is judged;
    ``optics`` are those of its images, ``camera`` the table of a guide camera that takes images; ``sensors`` are topic,
    unit, rate and noise of each sensor.
    ``acting`` names all that acts, ``member`` the parameter values (:mod:`los_testbed.run.conditions`). These, the
    noise of the sensors and ``plant_hash`` are there where the plant has announced its digest: `statistics` of each
    node, as far as they are known.
    ``plant_source_sha256`` and the like, for `disturbance_source`, `k_fsm` and `k_pma`, are of the source files of code
    of the user, or of a flight library, whose tables have ``k_fsm_tables_sha256`` and the like.
    """
    config, warnings = parts.config, parts.compare()
    mirror = zip(("fsm_frequency", "fsm_damping"), parts.telescope.fsm.dynamics) if config.device else ()
    plant = statistics.get("plant", {}).get(DIGEST, "")
    return {
        **config.to_strings(),
        **{name: json.dumps(value) for name, value in (*parts.basis.to_mapping().items(), *mirror)},
        **({"telescope_differences": "; ".join(differences(config.parameters))} if config.parameters else {}),
        "requirements": json.dumps(entries(parts.telescope.requirements)),
        **optics_of(parts),
        **_camera(parts),
        "sensors": json.dumps([sensor.to_mapping() for sensor in _sensors(parts, bool(plant))]),
        **_limits(parts),
        "rate_hz": str(RATE),
        **_start_up(parts, start),
        **_sources(parts),
        **({"plant_hash": plant, **conditions(parts, start)} if plant else {}),
        **({"start_note": start.note} if start.note else {}),
        **({"controller_warnings": "; ".join(warnings)} if warnings else {}),
        **({"idle_devices": parts.idle_devices} if parts.idle_devices else {}),
        **{f"{setting}_source_sha256": digest for setting, digest in source_hashes(config.code_of_user).items()},
        **tables_of(parts),
        "software_version": _version(),
        "commit": commit(),
        "python": sys.version.split()[0],
    }


def _start_up(parts: RunParts, start: RunStart) -> dict[str, str]:
    """Metadata of the start-up: none in a steady state; else it is measured, except for rigs and ramps.

    A loop that is unstable never settles.
    """
    if start.steady and not parts.sources:
        return {"transient_s": "0"}
    config = parts.config
    moves = config.ramp_duration or config.motion_from_file
    return {} if config.device or moves else {START_UP: NEVER if start.unstable else MEASURED}


def tables_of(parts: RunParts) -> dict[str, str]:
    """SHA-256 of the tables of each law that a flight library has, as ``los-testbed export check`` prints it."""
    blocks = {name: law.block for name, law in parts.controllers.items() if isinstance(law, UserBlock)}
    return {f"{name}_tables_sha256": law.tables_sha256 for name, law in blocks.items() if isinstance(law, LibraryLaw)}


def optics_of(parts: RunParts) -> dict[str, str]:
    """Optics of images; a pupil that is a file is an attachment (`attachments`), its name is what stays of its path.

    Raises
    ------
    InputError
        Optics that make no image.
    """
    _ = parts.optics  # refuses those that make no image
    named = asdict(parts.telescope.image_optics)
    return {OPTICS: json.dumps({**named, "pupil": Path(named["pupil"]).name})}


def _camera(parts: RunParts) -> dict[str, str]:
    """Table of a camera that takes images, under ``camera``; nothing of others."""
    if parts.star_camera is None:
        return {}
    table = asdict(parts.telescope.camera)
    return {TABLE: json.dumps({**table, NOISE_CURVE: Path(table[NOISE_CURVE]).name})}


def _sources(parts: RunParts) -> dict[str, str]:
    """Sources of disturbance of files, under ``disturbances``, and the digest of their content; nothing without any."""
    if not parts.sources:
        return {}
    rows = [{"name": s.name, "kind": s.kind, "place": s.place, "remarks": list(s.remarks)} for s in parts.sources]
    return {"disturbances": json.dumps(rows), "disturbances_sha256": parts.sources_digest}


def _limits(parts: RunParts) -> dict[str, str]:
    """Largest values of the actuators at places that the controller commands; nothing without any."""
    limits = {row.name: row.authority for row in parts.ports.actuators if row.mount is not None}
    return {AUTHORITY: json.dumps(limits)} if limits else {}


def _sensors(parts: RunParts, known: bool) -> tuple[RecordedSensor, ...]:
    """The sensors of a run; without noise where it has none or it is not `known`."""
    acts, ports = float(parts.config.noise), parts.ports
    noise = ports.noise * acts
    return tuple(
        RecordedSensor(
            t.name, t.unit, RATE / t.every(ports.ticks), t.framed, tuple(noise[t.columns].tolist()) if known else ()
        )
        for t in sensor_topics(ports.sensors)
    )


def _budget(telescope: Telescope, loop: str) -> dict[str, float]:
    """Allowances of the relative error [mas] in the stage of a run; edge between slow and fast tones [rad/s]."""
    from titop_plant.telescope.error_budget import error_budget

    budget = error_budget(telescope)
    shares = {}
    if loop in MIRROR_STAGES:
        shares = {"noise": budget.noise, "slow": budget.slow, "fast": budget.fast_mirror}
    if loop in FORCE_STAGES:
        shares = {"noise": budget.total_noise, "slow": budget.tone, "fast": budget.fast, "total": budget.limit}
    allowances = {part: float(f"{share / RAD_PER_MAS:.4g}") for part, share in shares.items()}
    return {**allowances, BUDGET_EDGE: telescope.weights.band_edge}


def final_metadata(
    parts: RunParts, statistics: Mapping[str, Mapping[str, str]], start: RunStart = AT_REST
) -> dict[str, str]:
    """The same with the statistics of each node, as one JSON object, the plant's name and tones, ``rpe_budget_mas``.

    The budget is what the stage allows to noise and tones (:mod:`pointing_analysis.spectra.tone_budget`).
    """
    budget = _budget(parts.telescope, parts.config.loop)
    record = {**run_metadata(parts, start, statistics), BUDGET: json.dumps(budget)}
    plant = dict(statistics.get("plant", {}))
    for name in ("plant", "tones_rad_s", "motion", "plant_parameters_hash"):
        if name in plant:
            record[name] = plant.pop(name)
    record["statistics"] = json.dumps({**statistics, "plant": plant})
    return record


def attachments(parts: RunParts, start: RunStart = AT_REST) -> dict[str, tuple[str, bytes]]:
    """Controllers that are files or linear systems, as JSON; configuration as YAML; tone and states of the start."""
    order = parts.config.ports_in_order
    content = {f"{name}.json": ("application/json", _json_of(name, path, order)) for name, path in parts.files.items()}
    for name, law in parts.controllers.items() if parts.code else ():
        if f"{name}.json" not in content and isinstance(law, UserBlock) and law.is_linear and law.linear is not None:
            content[f"{name}.json"] = ("application/json", law.linear.to_json().encode())
    text = yaml.safe_dump(parts.config.to_plain(), sort_keys=False)
    content["run.yaml"] = ("application/yaml", text.encode())
    content[START_FILE] = ("application/json", start.to_bytes())
    if parts.pupil_file:
        content[PUPIL] = ("application/fits", parts.pupil_file)
    return content


def _json_of(name: str, path: Path, in_order: bool) -> bytes:
    """A controller's file as JSON, with the names of ports that it has in the run."""
    return read_bytes(path) if path.suffix == ".json" else read_law(name, path, in_order).to_json().encode()


def _version() -> str:
    try:
        return version("los-testbed")
    except PackageNotFoundError:
        return "unknown"
