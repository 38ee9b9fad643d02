"""Bags of this testbed from before they held the requirements of their telescope."""

from __future__ import annotations

import copy
from types import MappingProxyType

from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.requirement import entries
from pointing_analysis.requirements.summary import METADATA
from titop_plant.telescope.load import load_telescope

OF_TELESCOPE = ("plant_hash", "parameters_hash", "plant_parameters_hash")
"""Keys of the metadata that name the telescope of a run."""
REMARK = "the bag holds no requirements: judged by those of the reference telescope (or give --requirements FILE)"


def with_requirements(run: Recording) -> Recording:
    """The recording; an older bag of this testbed with the requirements of the reference telescope.

    Recordings of others keep none: no limits are known of them.
    """
    if not is_older(run):
        return run
    found = copy.copy(run)
    reference = entries(load_telescope().requirements)
    found.parameters = MappingProxyType({**run.parameters, METADATA: reference})  # type: ignore[misc]
    return found


def is_older(run: Recording) -> bool:
    """Whether it is a bag of this testbed that names its telescope and holds no requirements."""
    return isinstance(run, Run) and METADATA not in run.parameters and any(k in run.parameters for k in OF_TELESCOPE)
