"""Line of sight due to the normalised disturbances in each stage of the implemented loop, at one parameter point."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lftkit import SampledSystem, System
from lftkit.analysis.batched_linalg import largest_gains
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop_norms import disturbance_response, loop_grid
from los_loop.spec import LOS_ROWS
from titop_plant.disturbances.responses import ALL, ARCSEC, Curve, DisturbanceResponses
from titop_plant.telescope.weights import weight_amplitudes

LOWEST, HIGHEST = 1e-2, 2e3
"""Frequencies of the curves [rad/s]."""

NAMES = {"none": "hard", "isolator": "isolated"}
"""Stage without fine control to the response that it is."""


def sampled_curve(
    responses: DisturbanceResponses,
    system: System,
    pair: tuple[SampledSystem, SampledSystem],
    stage: str,
    values: Mapping[str, float],
) -> Curve:
    """Largest singular value [arcsec] of a stage of the implemented loop.

    Parameters
    ----------
    responses : DisturbanceResponses
        Of the telescope, for the stages without fine control and for the weights.
    system : System
        The control-loop plant on its isolator, with the ports of the telescope that the controllers use.
    pair : (SampledSystem, SampledSystem)
        K_FSM and K_PMA.
    stage : str
    values : mapping
        Parameter values; others nominal.
    """
    if stage in NAMES:
        return responses.weighted(getattr(responses, NAMES[stage]), values, ALL, LOWEST, HIGHEST)
    plant, telescope = system.at(values), responses.telescope
    laws = ControlLaws(*pair, stage, telescope.loop_ports.used_by(*pair), telescope.fsm.los_sensitivity)
    loop = sampled_loop(plant, laws)
    omega = loop_grid(plant, loop.free, LOWEST, HIGHEST)
    response = disturbance_response(loop, plant, omega)[:, LOS_ROWS]
    gains = largest_gains(response * weight_amplitudes(telescope, omega)[:, None, :])
    return Curve(omega, np.asarray(gains / ARCSEC))
