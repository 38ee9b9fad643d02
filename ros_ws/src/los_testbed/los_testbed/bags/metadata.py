"""Metadata of a bag: configuration of the run, its origin, its controllers and results."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import yaml

from los_design.provenance import commit
from los_testbed.config import RunConfig, physical_hash
from los_testbed.factories import compare_with_telescope, controller_files, load_controllers, telescope_basis
from pointing_analysis.bag_metadata import METADATA_NAME
from titop_plant.interface import RATE

__all__ = ["METADATA_NAME", "attachments", "final_metadata", "run_metadata"]


def run_metadata(config: RunConfig) -> dict[str, str]:
    """Configuration, constants of the loop and the telescope, hash of the plant's settings, software and commit.

    ``fsm_authority`` and ``pma_authority`` are the limits in force, also where the configuration leaves them to the
    telescope. ``los_sensitivity`` is the telescope's; ``controller_warnings`` says which controllers were made for
    other parameters or limits, and is missing where none was.
    """
    telescope = telescope_basis(config)
    warnings = compare_with_telescope(load_controllers(config), telescope, config.loop)
    return {
        **config.to_strings(),
        **{name: json.dumps(value) for name, value in telescope.to_mapping().items()},
        "rate_hz": str(RATE),
        **({"controller_warnings": "; ".join(warnings)} if warnings else {}),
        "plant_hash": physical_hash(config),
        "software_version": _version(),
        "commit": commit(),
        "python": sys.version.split()[0],
    }


def final_metadata(config: RunConfig, statistics: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """The same with the statistics of each node, as one JSON object, and the plant's tones."""
    record = run_metadata(config)
    plant = dict(statistics.get("plant", {}))
    for name in ("tones_rad_s", "plant_parameters_hash"):
        if name in plant:
            record[name] = plant.pop(name)
    record["statistics"] = json.dumps({**statistics, "plant": plant})
    return record


def attachments(config: RunConfig) -> dict[str, tuple[str, bytes]]:
    """Files of the controllers and the configuration as YAML."""
    content = {
        f"{name}.json": ("application/json", path.read_bytes()) for name, path in controller_files(config).items()
    }
    text = yaml.safe_dump(config.to_mapping(), sort_keys=False)
    content["run.yaml"] = ("application/yaml", text.encode())
    return content


def _version() -> str:
    try:
        return version("los-testbed")
    except PackageNotFoundError:
        return "unknown"
