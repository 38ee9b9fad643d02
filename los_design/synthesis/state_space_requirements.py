"""Figures of merit as requirements of the state-space tuner, on the generalised plants of K_FSM and K_PMA.

The rows are those of :mod:`los_loop.figures_of_merit`; here they get the ports and weights of these plants.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType

import numpy as np

import fsm_pma_controller.problem
import los_estimator.problem
from lftkit import System
from lftkit.errors import InputError
from lftkit.tuning import H2Gain, HinfGain, TuningRequirement
from los_loop.figures_of_merit import FigureOfMerit, figure, figures, paper_figures
from titop_plant.interface import FORCE_STAGES
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import band_error_weight, disturbance_weight, relative_error_weight

BANDS = {figure(name).band: name for name in ("slow", "fast")}


def paper_requirements(telescope: Telescope, stage: str) -> tuple[TuningRequirement, ...]:
    """What the paper's problem asks of K_FSM (stage ``fsm``) or of K_PMA (``fsm+pma``), in the order of its gammas."""
    return tuple(requirement(row, telescope, stage, float(row.limit(telescope, stage))) for row in paper_figures(stage))


def implemented_requirements(telescope: Telescope, stage: str) -> tuple[TuningRequirement, ...]:
    """The figures of a stage of the implemented loop, with what is tuned for as bounds.

    Designs of that loop are tuned on its responses (:mod:`los_design.synthesis.pair_problem`) with the same rows.
    """
    return tuple(requirement(row, telescope, stage, row.tuned_for(telescope, stage)) for row in figures(stage))


def requirement(row: FigureOfMerit, telescope: Telescope, stage: str, bound: float) -> TuningRequirement:
    """A row as a requirement of the controller of a stage; the band of a relative error by filters of order 4.

    Raises
    ------
    ValueError
        A row that these plants have no ports or no filters for.
    """
    ports = fsm_pma_controller.problem if stage in FORCE_STAGES else los_estimator.problem
    inputs, output, weight_in = _ports(row, ports, tuple(port.name for port in telescope.disturbance_ports))
    kind = H2Gain if row.is_noise else HinfGain
    expected = disturbance_weight(telescope).at({}).named("W_rws, W_sa") if weight_in else None
    weight_out = _weight_out(row, telescope)
    return kind(inputs, (output,), bound, weight_in=expected, weight_out=weight_out, hard=row.hard, name=row.name)


def _ports(row: FigureOfMerit, ports: ModuleType, disturbances: tuple[str, ...]) -> tuple[tuple[str, ...], str, bool]:
    """Inputs and output of a row in the plant of a problem, and whether the inputs have the disturbance's weight."""
    if row.is_noise:
        noise: Mapping[str, str] = ports.NOISE_PORTS
        inputs = tuple(dict.fromkeys(noise[name] for name in row.inputs))
        for port in inputs:
            together = [name for name, known in noise.items() if known == port]
            if not set(together) <= set(row.inputs):
                raise InputError(f"{row.name}: the plant has one noise for {', '.join(together)}, got {row.inputs}")
        return inputs, row.output, False
    if row.is_sensitivity:
        added, applied = ports.SENSITIVITY_PORTS[row.inputs[0]]
        return (added,), applied, False
    return disturbances, row.output, True


def _weight_out(row: FigureOfMerit, telescope: Telescope) -> System | None:
    if row.band in BANDS and row.relative:
        return band_error_weight(telescope, BANDS[row.band])
    if row.band != (0.0, np.inf):
        raise InputError(f"{row.name}: band must be the whole axis, or that of slow or fast tones, got {row.band}")
    if row.relative:
        return relative_error_weight(telescope.weights.rpe_window).at({}).named("W_RPE")
    return None
