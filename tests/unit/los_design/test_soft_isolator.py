"""The tuner on the telescope with a quarter of the isolator's stiffness, where it once ended at the untouched start."""

from __future__ import annotations

import pytest

from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem, worst_values
from lftkit.tuning.tuner import tune
from los_design.synthesis.state_space_requirements import paper_requirements
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from titop_plant.telescope.load import load_telescope


@pytest.mark.slow
def test_the_kalman_start_is_left_or_the_status_does_not_promise_an_optimum() -> None:
    stiffness = [0.25 * k for k in load_telescope().isolator.stiffness]
    telescope = load_telescope().changed({"isolator": {"stiffness": stiffness}})
    plant = observer_plant(telescope)
    structure = observer_structure(plant)
    requirements = paper_requirements(telescope, "fsm")
    model = plant({name: p.nominal for name, p in telescope.uncertain.items()})
    start = kalman_start(structure, telescope)
    problem = Problem([model], requirements, structure)
    first, _ = worst_values(problem, problem.evaluate(start, gradients=False))
    result = tune([model], requirements, structure, initial=[start], options=TuningOptions(starts=0, iterations=12))
    assert result.certificate is not None and result.certificate.stable
    assert result.soft < 0.9 * first, "the smooth phase alone lowers the start's value"
    if result.status == "converged":
        assert result.certificate.upper.max() == pytest.approx(result.soft, rel=1e-3)
