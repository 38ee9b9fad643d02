"""The tuner on the telescope with a quarter of the isolator's stiffness, where it once ended at the untouched start."""

from __future__ import annotations

import copy

import pytest

from lftkit.tuning.problem import Problem, worst_values
from lftkit.tuning.tuner import TuningOptions, tune
from los_design.synthesis.state_space_requirements import paper_requirements
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.parameters import load_parameters, uncertain_parameters


@pytest.mark.slow
def test_the_kalman_start_is_left_or_the_status_does_not_promise_an_optimum() -> None:
    parameters = copy.deepcopy(dict(load_parameters()))
    parameters["isolator"]["stiffness"] = [0.25 * k for k in parameters["isolator"]["stiffness"]]
    telescope = build_telescope(parameters)
    plant = observer_plant(telescope, parameters)
    structure = observer_structure(plant)
    requirements = paper_requirements(parameters, "fsm")
    model = plant({name: p.nominal for name, p in uncertain_parameters(parameters).items()})
    start = kalman_start(structure, telescope, parameters)
    problem = Problem([model], requirements, structure)
    first, _ = worst_values(problem, problem.evaluate(start, gradients=False))
    result = tune([model], requirements, structure, initial=[start], options=TuningOptions(starts=0, iterations=12))
    assert result.certificate is not None and result.certificate.stable
    assert result.soft < 0.9 * first, "the smooth phase alone lowers the start's value"
    if result.status == "converged":
        assert result.certificate.upper.max() == pytest.approx(result.soft, rel=1e-3)
