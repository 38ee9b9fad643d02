"""Requirements and structure of the paper's problem, for tests of its statements."""

from __future__ import annotations

import numpy as np

from fsm_pma_controller.problem import FORCE, ORDER, ActuatorPlant
from lftkit import Port, static_gain
from lftkit.tuning import AffineStructure, H2Gain, TuningRequirement, state_space
from los_design.synthesis.state_space_requirements import paper_requirements
from los_loop.figures_of_merit import figure
from titop_plant.interface import K_PMA_INPUTS, MIRROR_STAGES
from titop_plant.telescope.control_plant import ACCELEROMETER_NOISE
from titop_plant.telescope.telescope import Telescope


def observer_requirements(telescope: Telescope) -> tuple[TuningRequirement, ...]:
    """What the paper's problem asks of K_FSM, with the platform's noise that it asks of both controllers.

    K_PMA cannot change what the observer makes of that noise: without the goal, designs of K_FSM with the same APE and
    RPE differ in it by a factor of 50.
    """
    stage, row = MIRROR_STAGES[0], figure("noise -> APE")
    limit, every = float(row.limit(telescope, stage)), ACCELEROMETER_NOISE
    platform_size = sum(port.size for port in K_PMA_INPUTS)
    unit = np.eye(every.size, platform_size)
    platform = static_gain(unit, [Port("platform_noise", platform_size)], [every])
    noise = H2Gain((every.name,), (row.output,), limit, weight_in=platform, hard=row.hard, name=row.name)
    return (*paper_requirements(telescope, stage), noise)


def actuator_structure(plant: ActuatorPlant) -> AffineStructure:
    """State space of fixed order from the platform's accelerations to the forces, all entries free."""
    return state_space([plant.system.output_port(port.name) for port in K_PMA_INPUTS], [FORCE], ORDER)
