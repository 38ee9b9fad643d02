"""Stored designs, design problems and the command group."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from los_testbed.cli.app import main

from fsm_pma_controller.problem import actuator_plant, actuator_structure
from lftkit import SampledSystem
from lftkit.tuning.problem import Problem
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.starts import random_law
from los_design.synthesis.state_space_requirements import implemented_requirements, requirement
from los_design.synthesis.store import continuous, design_file, load_designs
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from los_loop.figures_of_merit import figure
from los_loop.sampled_loop_norms import sampled_loop_metrics
from titop_plant.interface import LOOP_DELAY, MEASURED
from titop_plant.telescope.control_plant import control_loop_plant

IMPLEMENTED = DesignOptions()


def test_kalman_observer_has_the_noise_of_the_paper(telescope) -> None:
    """Accelerometer noise: 0.98 of 10 arcsec in the paper, 145 mas of relative error on a preliminary model."""
    plant = observer_plant(telescope)
    names, weights = ("noise -> RPE", "noise -> APE", "mirror"), telescope.weights
    bounds = weights.rpe_limit, weights.ape_limit, telescope.fsm.authority
    rows = [replace(figure(name), inputs=MEASURED) if "noise" in name else figure(name) for name in names]
    requirements = [requirement(row, telescope, "fsm", bound) for row, bound in zip(rows, bounds)]
    structure = observer_structure(plant)
    problem = Problem([plant({})], requirements, structure)
    start = kalman_start(structure, telescope)
    found = dict(zip((r.name for r in requirements), problem.evaluate(start, gradients=False).values[:, 0]))
    assert 0.85 < found["noise -> APE"] < 1.05
    assert 1.3 < found["noise -> RPE"] < 1.6
    assert found["mirror"] < 1.0


def test_gradients_of_the_observer_problem_equal_differences(telescope) -> None:
    plant = observer_plant(telescope, **IMPLEMENTED.hold_delays)
    requirements = [r for r in implemented_requirements(telescope, "fsm") if r.name in ("fast", "noise -> RPE")]
    structure = observer_structure(plant, camera_hold=True)
    problem = Problem([plant({})], requirements, structure, loop_delay=IMPLEMENTED.delay)
    x = kalman_start(structure, telescope, lead=LOOP_DELAY)
    pieces = problem.evaluate(x, band=0.01).pieces
    rng = np.random.default_rng(0)
    for i in range(len(requirements)):
        best = max((p for p in pieces if p.requirement == i), key=lambda p: p.value)
        # Every entry changes by a random part of itself, uphill: the slope is then large against rounding of the peak.
        direction = rng.uniform(0.5, 1.0, x.size) * (np.abs(x) + 1e-6) * np.sign(best.gradient)
        h = 1e-4
        ends = [problem.evaluate(x + s * h * direction, gradients=False).values[i, 0] for s in (-1.0, 1.0)]
        assert best.gradient @ direction == pytest.approx((ends[1] - ends[0]) / (2.0 * h), rel=1e-6)


def test_a_random_start_is_stable_and_has_a_small_gain(telescope) -> None:
    k_fsm, _ = load_designs("implemented")
    plant = actuator_plant(telescope, continuous(k_fsm), loop_delay=IMPLEMENTED.delay, **IMPLEMENTED.hold_delays)
    start = random_law(0)
    assert np.linalg.eigvals(start.A).real.max() < 0.0
    structure = actuator_structure(plant)
    problem = Problem(
        [plant({})], implemented_requirements(telescope, "fsm+pma"), structure, loop_delay=IMPLEMENTED.delay
    )
    assert problem.abscissa(structure.parameters_of(start)) < 0.0


@pytest.mark.parametrize("variant", ["implemented", "implemented_nominal"])
def test_stored_designs_have_the_provenance_of_this_telescope(variant: str, telescope) -> None:
    for system in load_designs(variant):
        assert system.design_basis == telescope.design_basis.to_mapping()
        assert system.provenance["command"].startswith("los-testbed design all")
        assert continuous(system).order == 4


def test_implemented_designs_are_stable_and_within_the_templates_at_nominal(telescope) -> None:
    k_fsm, k_pma = load_designs("implemented")
    plant = control_loop_plant(telescope).at({})
    one, two = (
        sampled_loop_metrics(plant, k_fsm, k_pma, telescope, loop=loop, frame_ticks=20) for loop in ("fsm", "fsm+pma")
    )
    assert one.radius < 1.0 and two.radius < 1.0
    assert max(one.ape, one.rpe, one.mirror) < 1.0
    assert max(two.ape, two.rpe_fine, two.force) < 1.0
    assert two.noise_ape < telescope.weights.ape_limit
    assert two.noise_rpe < telescope.weights.rpe_limit


def test_a_controller_without_its_continuous_form_is_named(tmp_path) -> None:
    system, _ = load_designs("implemented")
    bare = SampledSystem(system.A, system.B, system.C, system.D, system.inputs, system.outputs, system.dt, "mine")
    with pytest.raises(ValueError, match="mine: the file holds no continuous controller"):
        continuous(bare)
    with pytest.raises(ValueError, match="must be one of k-fsm, k-pma"):
        design_file("k-xyz")


def test_table_as_json(capsys) -> None:
    assert main(["design", "table", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert {row["design"] for row in rows} == {"k-fsm", "k-pma"}
    assert {row["variant"] for row in rows} == {"implemented", "implemented_nominal"}
