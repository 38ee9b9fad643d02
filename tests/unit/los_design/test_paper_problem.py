"""What the paper's problem asks of K_FSM: the platform's noise as K_PMA meets it."""

from __future__ import annotations

import numpy as np
import pytest

from fsm_pma_controller.problem import actuator_plant, actuator_structure
from lftkit import System
from lftkit.tuning import certify
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.state_space_requirements import observer_requirements, paper_requirements
from los_design.synthesis.store import continuous, load_designs
from los_design.synthesis.synthesis import MET, design_actuators, design_observer
from los_estimator.problem import observer_plant
from titop_plant.simulation.build import telescope
from titop_plant.telescope.parameters import load_parameters


def test_noise_asked_of_k_fsm_is_that_of_the_platform_behind_an_idle_k_pma() -> None:
    """From the plant of K_FSM with the observer closed, and from that of K_PMA with no force."""
    parameters, k_fsm = load_parameters(), continuous(load_designs("paper")[0])
    *others, noise = observer_requirements(parameters)
    assert [r.name for r in others] == [r.name for r in paper_requirements(parameters, "fsm")]
    alone = certify([observer_plant(telescope(), parameters)({})], k_fsm, [noise]).values.item()
    plant = actuator_plant(telescope(), parameters, k_fsm)
    structure = actuator_structure(plant)
    size = structure.outputs[0].size, structure.inputs[0].size
    idle = System.static(np.zeros(size), structure.inputs, structure.outputs)
    (both,) = (r for r in paper_requirements(parameters, "fsm+pma") if r.name == noise.name)
    assert 0.01 < alone < 1.0
    assert abs(certify([plant({})], idle, [both]).values.item() / alone - 1.0) < 1e-6


@pytest.mark.slow
def test_the_nominal_designs_are_converged_from_their_own_starts() -> None:
    """From the Kalman observer and from a random K_PMA; the soft figures are certified to be at most what counts."""
    parameters, options = load_parameters(), DesignOptions(nominal=True, loop_delay=0.0)
    k_fsm = design_observer(telescope(), parameters, options)
    k_pma = design_actuators(telescope(), parameters, k_fsm, options)
    for system in (k_fsm, k_pma):
        assert system.provenance is not None and system.provenance["status"] == "converged"
    of_pma = paper_requirements(parameters, "fsm+pma")
    for system, asked, plant in (
        (k_fsm, observer_requirements(parameters), observer_plant(telescope(), parameters)),
        (k_pma, of_pma, actuator_plant(telescope(), parameters, continuous(k_fsm))),
    ):
        found = certify([plant({})], continuous(system), asked)
        assert found.abscissae.max() < 0.0
        for requirement, upper in zip(asked, found.upper[:, 0], strict=True):
            assert upper <= (1.0 if requirement.hard else MET)
