"""Designs of the paper's problem: certified on the assembled loops, and no lower than the telescope allows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsm_pma_controller.problem import actuator_plant, actuator_structure
from lftkit import System
from lftkit.arrays import FloatArray
from lftkit.tuning import certify
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.state_space_requirements import observer_requirements, paper_requirements
from los_design.synthesis.store import continuous
from los_design.synthesis.synthesis import design_actuators, design_observer
from los_estimator.problem import observer_plant
from los_loop.continuous_loop import continuous_open_loop
from titop_plant.telescope.load import load_telescope

FILE = str(Path(__file__).parents[3] / "examples" / "paper" / "telescope.toml")


def largest_error(telescope) -> float:
    """Largest line of sight of the nominal telescope on its isolator [rad], normalised disturbances."""
    loop = continuous_open_loop(telescope)
    omega = np.geomspace(0.03, 0.12, 60)
    responses: list[FloatArray] = [loop.closed_over(lft, loop.point({})[None])[0] for lft in loop.at(omega)]
    return max(float(np.linalg.norm(r[-2:, : loop.disturbances], 2)) for r in responses)


@pytest.fixture(scope="module")
def k_fsm():
    telescope = load_telescope(FILE)
    return design_observer(telescope, DesignOptions(nominal=True, loop_delay=0.0))


def test_the_nominal_k_fsm_is_at_the_bound_of_the_mirror(k_fsm) -> None:
    """APE >= (L0 - reach g3) / limit for every observer; the design is there, by the norms of the assembled loop."""
    telescope = load_telescope(FILE)
    assert k_fsm.provenance["status"] == "converged"
    asked = observer_requirements(telescope)
    found = certify([observer_plant(telescope)({})], continuous(k_fsm), asked)
    gammas = dict(zip((r.name for r in asked), found.upper[:, 0]))
    assert found.abscissae.max() < 0.0
    for name, value in k_fsm.provenance["tuned_values"].items():
        assert gammas[name] == pytest.approx(value, rel=5e-3)  # samples beside a peak
    reach = telescope.fsm.authority * telescope.fsm.los_sensitivity
    floor = (largest_error(telescope) - reach * gammas["mirror"]) / telescope.weights.ape_limit
    assert floor * (1.0 - 1e-3) <= gammas["APE"] <= floor * 1.01
    assert gammas["mirror"] <= 1.0 + 1e-5


def test_noise_asked_of_k_fsm_is_that_of_the_platform_behind_an_idle_k_pma(k_fsm) -> None:
    """From the plant of K_FSM with the observer closed, and from that of K_PMA with no force."""
    telescope, observer = load_telescope(FILE), continuous(k_fsm)
    noise = observer_requirements(telescope)[-1]
    alone = certify([observer_plant(telescope)({})], observer, [noise]).values.item()
    plant = actuator_plant(telescope, observer)
    structure = actuator_structure(plant)
    size = structure.outputs[0].size, structure.inputs[0].size
    idle = System.static(np.zeros(size), structure.inputs, structure.outputs)
    (both,) = (r for r in paper_requirements(telescope, "fsm+pma") if r.name == noise.name)
    assert 0.1 < alone < 1.0
    assert abs(certify([plant({})], idle, [both]).values.item() / alone - 1.0) < 1e-6


@pytest.mark.slow
def test_the_nominal_k_pma_is_converged_and_certified(k_fsm) -> None:
    telescope, options = load_telescope(FILE), DesignOptions(nominal=True, loop_delay=0.0, starts=2)
    k_pma = design_actuators(telescope, k_fsm, options)
    asked = paper_requirements(telescope, "fsm+pma")
    plant = actuator_plant(telescope, continuous(k_fsm))
    found = certify([plant({})], continuous(k_pma), asked)
    assert k_pma.provenance["status"] == "converged" and len(k_pma.provenance["starts"]) == 2
    assert found.abscissae.max() < 0.0
    for requirement, upper in zip(asked, found.upper[:, 0], strict=True):
        assert upper == pytest.approx(k_pma.provenance["tuned_values"][requirement.name], rel=5e-3)
        assert upper <= k_fsm.provenance["tuned_values"]["APE"] * 1.001 or requirement.hard
