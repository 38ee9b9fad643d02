"""Peaks that the samples of a design of the paper's problem have missed: the design goes on with samples at them.

A closed loop has resonances that the telescope does not have, and a search of the family ends at half of the sampling
rate of the loop that runs. The norms of the assembled loop see them all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fsm_pma_controller.problem import actuator_plant
from lftkit import System
from lftkit.tuning import HinfGain, certify
from los_design.synthesis.state_space_requirements import paper_requirements
from los_estimator.problem import observer_plant
from titop_plant.interface import FORCE_STAGES, K_FSM_INPUTS, K_PMA_INPUTS
from titop_plant.telescope.telescope import Telescope

HIDDEN = 5e-3
"""Part by which the norm of the nominal loop may exceed the samples."""


def hidden_peaks(
    telescope: Telescope,
    pair: Sequence[System],
    stage: str,
    reached: Mapping[str, float],
) -> list[float]:
    """Frequencies [rad/s] of peaks of the nominal loop that samples have missed, by the norms of the assembled loop.

    Parameters
    ----------
    telescope, parameters
    pair : (System, System)
        Continuous K_FSM and K_PMA.
    stage : str
    reached : mapping
        Value of each gain at the samples, of its limit.
    """
    if stage in FORCE_STAGES:
        plant, measured, controller = actuator_plant(telescope, pair[0])({}), K_PMA_INPUTS, pair[1]
    else:
        plant, measured, controller = observer_plant(telescope)({}), K_FSM_INPUTS, pair[0]
    ports = tuple(plant.output_port(port.name) for port in measured)
    K = System(*controller.matrices, ports, controller.outputs, controller.name)
    asked = [r for r in paper_requirements(telescope, stage) if isinstance(r, HinfGain)]
    certified = certify([plant], K, asked)
    return [
        float(certified.peak_frequencies[k, 0])
        for k, r in enumerate(asked)
        if certified.values[k, 0] > reached[r.name] * (1.0 + HIDDEN) and np.isfinite(certified.peak_frequencies[k, 0])
    ]


__all__ = ["hidden_peaks"]
