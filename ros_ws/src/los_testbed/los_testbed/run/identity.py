"""Dependencies of the results of runs: software versions, and digests of all inputs of a configuration.

:attr:`titop_plant.telescope.telescope.Telescope.parameters_hash` names a telescope for its designs: it leaves out what
no design depends on. The rows of a campaign, the runs of `stages` and those of a trade depend on all of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.trusted.digests import digest
from los_design.copied_files import content_of
from los_design.synthesis.provenance import law_digest
from los_testbed import __version__
from los_testbed.config.plugins import source_hashes
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import needs_tone
from titop_plant.interface import LAW_PORTS
from titop_plant.physical_settings import PhysicalSettings
from titop_plant.telescope.named_files import map_files
from titop_plant.telescope.telescope import DEVICE_LIMITS, Telescope

DIGITS = 16
"""Hexadecimal digits of a digest that is compared and shown."""


DIGEST = "digest"
"""Key under which a node announces in its reports what it runs."""


def software() -> dict[str, str]:
    """Versions that affect a result bitwise."""
    import scipy  # nodes, which announce what they run, need not load it

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
    digests = {"telescope": telescope_digest(parts.telescope)}
    if controllers:
        digests |= {name: content_digest(path) for name, path in parts.model_files.items()}
    if config.files_of_disturbance:
        from los_testbed.parts.disturbance_files import digest as files_digest
        from los_testbed.parts.disturbance_files import entries_of

        digests["disturbances"] = files_digest(entries_of(config.files_of_disturbance))
    if config.motion_from_file:
        digests["profile"] = content_digest(Path(config.profile))
    digests |= source_hashes(config.code_of_user)
    return {**software(), **{name: text[:DIGITS] for name, text in digests.items()}}


def announced(parts: RunParts) -> dict[str, str]:
    """Digests by which the nodes of a run announce what they run, by node; empty where it is not known.

    Of the ``plant`` its telescope, settings and disturbances count, and the laws where its tone or its start are those
    of their loop; of the ``estimator`` the numbers of K_FSM; of the ``controller`` those of K_PMA, the gain of the
    mirror, and stage, limits and fade at the start. It is not known of another plant than the telescope, nor of code
    without a model. The length of a run, its name and the machine do not count.

    Raises
    ------
    ValueError
        A file that cannot be read, a law that cannot be used.
    """
    config, laws = parts.config, {name: parts.model_of(name) for name in LAW_PORTS}
    digests = {name: "" if law is None else law_digest(law) for name, law in laws.items()}
    control = parts.control_law()
    values = [control.loop, control.mirror_gain, control.limits.tolist(), config.fade_ticks]
    controller = digest([digests["k_pma"], *values]) if digests["k_pma"] else ""
    plant = "" if config.other_plant else digest(_of_plant(parts, digests))
    return {"plant": plant, "estimator": digests["k_fsm"], "controller": controller}


def _of_plant(parts: RunParts, laws: Mapping[str, str]) -> dict[str, Any]:
    """All that the plant of a run is built from; code counts by its name."""
    config, plain = parts.config, parts.config.to_plain()
    names = {*PhysicalSettings.SETTINGS, "nonlinear", *(("disturbance_source",) if config.disturbance else ())}
    settings = {name: plain[name] for name in sorted(names - {"parameters", "tau", "theta", "profile"})}
    settings |= {"theta": config.array_angle, "isolated": config.loop != "none", "start": config.start}
    telescope = telescope_digest(parts.telescope, device_limits=config.nonlinear)
    settings |= {"telescope": telescope, "disturbances": parts.sources_digest}
    settings["profile"] = content_digest(Path(config.profile)) if config.motion_from_file else config.profile
    if config.start != "rest" or needs_tone(config):
        named = {name: laws[name] or getattr(config, name) for name in laws}
        settings |= {"loop": config.loop, "worst_of": config.worst_of, "laws": named}
    return settings


def telescope_digest(telescope: Telescope, *, device_limits: bool = True) -> str:
    """Digest of all values of a telescope and of the content of the files that it names, wherever they are.

    Limits of its devices count with `device_limits`.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    tables = telescope.to_mapping()
    if not device_limits:
        del tables[DEVICE_LIMITS]
    return digest(map_files(tables, content_digest))


def content_digest(path: Path) -> str:
    """SHA-256 of the content of a file; ValueError: it cannot be read."""
    return hashlib.sha256(content_of(path)).hexdigest()
