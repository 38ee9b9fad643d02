"""What a bag says about its run: configuration, origin, controllers, results."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import yaml

from los_design.provenance import commit
from los_testbed.config import RunConfig, physical_hash
from los_testbed.factories import controller_files

METADATA_NAME = "los_testbed"
"""Name of the metadata record; it is written at the start and, with the results, at the end."""


def run_metadata(config: RunConfig) -> dict[str, str]:
    """Configuration, seed, hash of the plant's figures, software version and commit."""
    return {
        **config.to_strings(),
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
    """Controller files as implemented and the configuration as YAML."""
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
