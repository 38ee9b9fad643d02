"""LQG controllers of sampled plants: a closed form, loops, and perturbed controllers."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import Port, System, h2_norm
from lftkit.synthesis import h2syn
from lftkit.synthesis.sampled_lqg import sampled_lqg
from lftkit.synthesis.standard_plant import standard_plant
from lftkit.tuning import H2Gain, TuningOptions, TuningStatus, state_space, tune_discrete

ROOT5 = float(np.sqrt(5.0))
DT = 0.1


def integrator() -> System:
    """``x+ = x + u + w``, ``y = x + v``, with the errors x and u: both equations have the golden ratio as solution."""
    ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    return System([[1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], *ports, dt=DT)


def random_plant(seed: int, through: float) -> System:
    """Direct paths everywhere, or nowhere."""
    rng = np.random.default_rng(seed)
    A, B, C, D = (rng.standard_normal(shape) for shape in ((4, 4), (4, 5), (5, 4), (5, 5)))
    return System(0.6 * A, B, C, through * D, (Port("w", 3), Port("u", 2)), (Port("z", 3), Port("y", 2)), "P", DT)


@pytest.mark.parametrize(("direct", "variance"), [(True, ROOT5), (False, 1.0 + ROOT5)])
def test_the_integrator_has_the_variance_of_its_closed_form(direct: bool, variance: float) -> None:
    assert sampled_lqg(standard_plant(integrator(), "y", "u").extended, direct=direct).norm ** 2 == pytest.approx(
        variance
    )


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize(("seed", "through"), [(0, 1.0), (1, 1.0), (3, 0.0)])
def test_the_loop_has_the_stated_norm_and_no_controller_beside_it_less(seed: int, through: float, direct: bool) -> None:
    given, rng = standard_plant(random_plant(seed, through), "y", "u"), np.random.default_rng(0)
    matrices, least = sampled_lqg(given.extended, direct=direct)

    def norm(own: list[np.ndarray]) -> float:
        return float(h2_norm(given.closed(System(*own, given.measured, given.commanded, "K", DT))))

    assert norm(list(matrices)) == pytest.approx(least, rel=1e-9)
    for _ in range(20):
        other = [M + 1e-3 * rng.standard_normal(M.shape) for M in matrices]
        other[3] = other[3] if direct else np.zeros_like(other[3])
        assert norm(other) > least


def test_h2syn_of_a_sampled_plant() -> None:
    found = h2syn(integrator(), "y", "u")
    assert found.value**2 == pytest.approx(ROOT5) and found.lower == pytest.approx(found.value)
    plant = integrator()
    undisturbed = System(plant.A, [[0, 0, 1]], plant.C, plant.D, plant.inputs, plant.outputs, dt=DT)
    with pytest.raises(ValueError, match="no zeros on the unit circle"):
        h2syn(undisturbed, "y", "u")


@pytest.mark.parametrize(("through", "variance"), [(True, ROOT5), (False, 1.0 + ROOT5)])
def test_tuning_on_samples_knows_the_least_h2_norm(through: bool, variance: float) -> None:
    """Once there was no bound, and the search went on at the optimum; white noise of unit density here."""
    law = state_space([("y", 1)], [("u", 1)], 1, feedthrough=through)
    result = tune_discrete([integrator()], [H2Gain("w", "z")], law, options=TuningOptions(starts=4, wall_limit=60.0))
    assert result.lower_bound == pytest.approx(np.sqrt(ROOT5 / DT), rel=1e-5)
    assert result.soft == pytest.approx(np.sqrt(variance / DT), rel=1e-3)
    assert result.status is TuningStatus.CONVERGED
