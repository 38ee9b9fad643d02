"""Dependencies of the results of runs: software versions, and digests of all inputs of a configuration.

:attr:`titop_plant.telescope.telescope.Telescope.parameters_hash` names a telescope for its designs: it leaves out what
no design depends on. The rows of a campaign, the runs of `stages` and those of a trade depend on all of it.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import scipy

from los_testbed import __version__
from los_testbed.config.plugins import source_hashes
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.input_files import content_of, map_files
from titop_plant.telescope.telescope import Telescope

DIGITS = 16
"""Hexadecimal digits of a digest that is compared and shown."""


def software() -> dict[str, str]:
    """Versions that affect a result bitwise."""
    return {"version": __version__, "numpy": np.__version__, "scipy": scipy.__version__}


def identity(config: RunConfig, *, controllers: bool = True) -> dict[str, str]:
    """Versions, and digests of the inputs of a run besides its settings.

    Parameters
    ----------
    config : RunConfig
    controllers : bool
        Whether the controllers that the configuration names count; not where they are designed on the way.

    Returns
    -------
    dict of str to str
        ``version``, ``numpy``, ``scipy``; ``telescope``, of all its values and of the files that they name; ``k_fsm``,
        ``k_pma``; where there are any ``disturbances``, of further files of sources, ``profile``, of the file of a
        ramp, and user code by the name of its setting.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    parts = RunParts(config)
    found = {"telescope": telescope_digest(parts.telescope)}
    if controllers:
        found |= {name: content_digest(path) for name, path in parts.model_files.items()}
    if config.files_of_disturbance:
        from los_testbed.parts.disturbance_files import digest, entries_of

        found["disturbances"] = digest(entries_of(config.files_of_disturbance))
    if config.motion_from_file:
        found["profile"] = content_digest(Path(config.profile))
    found |= source_hashes(config.code_of_user)
    return {**software(), **{name: text[:DIGITS] for name, text in found.items()}}


def telescope_digest(telescope: Telescope) -> str:
    """SHA-256 of all values of a telescope and of the content of the files that it names, wherever they are.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    content = map_files(telescope.named_values(), content_digest)
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def content_digest(path: Path) -> str:
    """SHA-256 of the content of a file; ValueError: it cannot be read."""
    return hashlib.sha256(content_of(path)).hexdigest()
