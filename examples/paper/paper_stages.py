"""Line of sight due to the normalised disturbances in each stage of control of the paper's own problem.

Its loop is continuous and has no delay; without fine control it is the same telescope as that of the sampled loop
(:mod:`los_design.figures.stage_curves`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsm_pma_controller.problem import FORCE, MEASURED_NAMES, actuator_plant
from lftkit import SampledSystem, System, close
from lftkit.analysis.norms import spectral_abscissa
from los_design.synthesis.store import continuous
from los_loop.spec import LINE_OF_SIGHT
from titop_plant.disturbances.responses import ALL, Curve, DisturbanceResponses
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.telescope import Telescope

LOWEST, HIGHEST = 1e-2, 1e4
"""Frequencies of the curves [rad/s]."""

TOLERANCE = 1e-6
"""Relative error of a curve that nobody sees in a picture: the modal form of a loop at high gain has some 1e-8 of it,
and to solve for every frequency instead takes sixty times as long."""


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
        open_forces = plant[(LINE_OF_SIGHT, *MEASURED_NAMES), (*disturbances, FORCE.name)]
        both = close(open_forces, actuators, {**{name: name for name in MEASURED_NAMES}, FORCE.name: FORCE.name})
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
            return Curve(np.array([LOWEST, HIGHEST]), np.full(2, np.inf))
        return self.responses.weighted(self.systems[stage], values, ALL, LOWEST, HIGHEST, tolerance)
