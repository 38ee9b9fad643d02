"""Line of sight due to the normalised disturbances in each stage of control, at one member of the family.

Two loops are drawn: the implemented one, of sampled controllers whose commands act one tick late, and that of the
paper's design problem, which is continuous and has no delay. Without fine control both are the same telescope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsm_pma_controller.problem import FORCE, MEASUREMENTS, actuator_plant
from lftkit import SampledSystem, System, close
from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.norms import spectral_abscissa
from los_design.synthesis.store import continuous
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop_norms import disturbance_response, loop_grid
from los_loop.spec import LINE_OF_SIGHT, LOS_ROWS
from titop_plant.disturbances.responses import ALL, ARCSEC, Curve, DisturbanceResponses
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import weight_amplitudes

LOWEST, HIGHEST = 1e-2, 2e3
"""Frequencies of the curves of the sampled loop [rad/s]."""

PAPER_HIGHEST = 1e4
"""Highest frequency of those of the continuous loop [rad/s]; there is no sampling rate that ends them."""

TOLERANCE = 1e-6
"""Relative error of a curve that nobody sees in a picture: the modal form of a loop at high gain has some 1e-8 of it,
and to solve for every frequency instead takes sixty times as long."""

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
    laws = ControlLaws(*pair, stage, telescope.fsm.los_sensitivity, telescope.loop_ports.used_by(*pair))
    loop = sampled_loop(plant, laws)
    omega = loop_grid(plant, loop.free, LOWEST, HIGHEST)
    response = disturbance_response(loop, plant, omega)[:, LOS_ROWS]
    gains = largest_gains(response * weight_amplitudes(telescope, omega)[:, None, :])
    return Curve(omega, np.asarray(gains / ARCSEC))


@dataclass(frozen=True)
class PaperStages:
    """The stages of the paper's problem, closed once with the uncertainty kept in them.

    Parameters
    ----------
    responses : DisturbanceResponses
        Of the telescope, for the weights.
    systems : mapping of str to System
        Stage to the uncertain loop from the disturbances to the line of sight [rad].
    """

    responses: DisturbanceResponses
    systems: Mapping[str, System]

    @classmethod
    def of(
        cls,
        telescope: Telescope,
        responses: DisturbanceResponses,
        pair: tuple[SampledSystem, SampledSystem],
    ) -> PaperStages:
        """Close the continuous controllers of a pair of designs around the plants that they were designed on.

        Raises
        ------
        ValueError
            A file without its continuous controller.
        """
        observer, actuators = (continuous(design) for design in pair)
        plant = actuator_plant(telescope, observer).system
        disturbances = disturbances_of(plant)
        open_forces = plant[(LINE_OF_SIGHT, *MEASUREMENTS), (*disturbances, FORCE.name)]
        both = close(open_forces, actuators, {**{name: name for name in MEASUREMENTS}, FORCE.name: FORCE.name})
        systems = {
            "none": responses.hard,
            "isolator": responses.isolated,
            "fsm": plant[LINE_OF_SIGHT, disturbances],
            "fsm+pma": both,
        }
        return cls(responses, systems)

    def curve(self, stage: str, values: Mapping[str, float], tolerance: float = TOLERANCE) -> Curve:
        """Largest singular value [arcsec] of a stage to a relative tolerance, parameters not in `values` nominal.

        **That of an unstable loop is infinite**, at the two ends alone.
        """
        if spectral_abscissa(self.systems[stage].at(values).A) >= 0.0:
            return Curve(np.array([LOWEST, PAPER_HIGHEST]), np.full(2, np.inf))
        return self.responses.weighted(self.systems[stage], values, ALL, LOWEST, PAPER_HIGHEST, tolerance)
