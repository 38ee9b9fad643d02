"""The loop of a run under one of its sources of disturbance alone: without sensor noise and without the others.

The loop is the one of the run as implemented; it is linear while no command is limited. So the squares of the relative
errors of independent sources add up to that of the run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.threads import one_thread
from los_testbed.factories import RunParts
from los_testbed.law_devices import NONE
from los_testbed.loop.simulate import SampleBlock, simulate
from pointing_analysis.indices.errors import default_transient
from titop_plant.interface import DT
from titop_plant.simulation.driven_plant import DrivenPlant
from titop_plant.simulation.sources.drive import Sources, source_matrix


def errors_of_source(parts: RunParts, index: int, ticks: int) -> FloatArray:
    """Line of sight under one source alone, from rest, its start-up left out.

    Parameters
    ----------
    parts : RunParts
        Of the run.
    index : int
        Place of the source in ``parts.sources``.
    ticks : int
        Length of the simulation.

    Returns
    -------
    ndarray, shape (n, 2)
        [rad].
    """
    quiet = replace(parts.config, start="rest", noise=False, disturbance=False)
    laws = None if parts.code else {name: replace(law) for name, law in parts.models.items()}  # states of their own
    alone = RunParts(quiet, laws, known_family=parts.family)
    source = parts.sources[index : index + 1]
    with one_thread():
        family = alone.sensed_family if parts.code else alone.family  # code may read further sensors
        telescope = family.build(alone.settings, np.zeros(family.control_loop.order))
        matrix = source_matrix(family, alone.settings, source, telescope.dt)
    driven = DrivenPlant(telescope, matrix, Sources(source, telescope.dt), source[0].name)
    plant = alone.with_devices(driven) if parts.code else driven
    estimator, controller = alone.estimator(), alone.controller()
    for part in (plant, estimator, controller):
        part.reset()
    found = np.zeros((ticks, 2))
    done = 0

    def keep(block: SampleBlock, rows: int) -> None:
        nonlocal done
        found[done : done + rows] = block.truth[:rows]
        done += rows

    with one_thread():
        simulate(plant, estimator, controller, ticks, keep, wiring=alone.wiring if parts.code else NONE)
    return found[round(default_transient(ticks * DT) / DT) :]
