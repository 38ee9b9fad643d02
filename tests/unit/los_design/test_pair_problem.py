"""The samples that the controllers are tuned on are the implemented loop that is searched and verified."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.tuning.responses import ResponseProblem, parameters_of
from los_design.synthesis.pair_problem import (
    ACTUATORS,
    ALONE,
    BOTH,
    OBSERVER,
    Samples,
    blocks,
    gains,
    limits,
    named,
    noises,
    pair_problem,
    sample,
)
from los_design.synthesis.store import continuous, load_designs
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.noise import noise_covariances, noise_rms
from los_loop.open_loop import OpenLoop
from titop_plant.interface import FRAME_TICKS
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.error_budget import ABSOLUTE_ON_AXIS, combined_level, error_budget


@pytest.fixture(scope="module")
def open_loop(telescope):
    return OpenLoop(control_loop_plant(telescope), telescope)


@pytest.fixture(scope="module")
def pair():
    return load_designs("implemented")


@pytest.fixture(scope="module")
def x(telescope, pair):
    matrices = []
    for system in pair:
        A, B, C, D = continuous(system).at({}).matrices
        matrices.append(np.block([[A, B], [C, D]]))
    return parameters_of(blocks(telescope, (OBSERVER, ACTUATORS)), matrices)


def test_every_gain_is_that_of_the_implemented_loop(telescope, open_loop, pair, x) -> None:
    """Both stages, all requirements, at random points and frequencies on both sides of the bands' edge."""
    rng = np.random.default_rng(3)
    points, omega = rng.uniform(size=(3, 7)), np.array([0.03, 4.3, 64.0, 145.0, 402.0, 690.0, 2000.0])
    samples = sample(open_loop, omega, points)
    problem = ResponseProblem(blocks(telescope, (OBSERVER, ACTUATORS)), samples, gains(telescope, (ALONE, BOTH)))
    found = {gain.name: row for gain, row in zip(problem.gains, problem.values(x))}
    for stage, name in ((ALONE, "fsm"), (BOTH, "fsm+pma")):
        loop = ImplementedLoop(open_loop, *pair, name)
        for metric in loop_metrics(telescope, name).values():
            share = limits(telescope, stage)[metric.name]
            expected = [
                float(loop.gains(loop.at(w), metric, point[None])[0]) * metric.limit / share
                if metric.band[0] <= w < metric.band[1]
                else 0.0
                for w in omega
                for point in points
            ]
            np.testing.assert_allclose(found[named(metric.name, stage)], expected, rtol=1e-7, atol=1e-12)


@pytest.mark.further
def test_noise_is_that_of_the_sampled_loop(telescope, open_loop, pair, x) -> None:
    """The integral over frequency against the periodic Lyapunov equation: within 0.1 %.

    The absolute error has some noise below the lowest frequency of the integral; verification uses the equation.
    """
    problem = ResponseProblem(
        blocks(telescope, (OBSERVER, ACTUATORS)),
        sample(open_loop, np.array([1.0]), np.full((1, 7), 0.5)),
        gains(telescope, (BOTH,)),
        noises(Samples(open_loop), (ALONE, BOTH)),
    )
    plant, budget = open_loop.system.at({}), error_budget(telescope)
    shares = {"fsm": (budget.ape_noise, budget.noise), "fsm+pma": (budget.ape_noise, budget.total_noise)}
    values = np.reshape(problem.noise(x), (2, 2))
    for found, (stage, share) in zip(values, shares.items()):
        exact = noise_rms(noise_covariances(plant, *pair, telescope, loop=stage, frame_ticks=FRAME_TICKS))
        assert found[1] * share[1] == pytest.approx(exact[1], rel=1e-3)
        assert 0.97 * exact[0] < found[0] * share[0] < exact[0]


def test_samples_are_dense_where_modes_are_narrow(open_loop) -> None:
    """Every slow mode of an added point has samples within half of its width; the nominal point's fast ones, too."""
    samples = Samples(open_loop)
    point = np.random.default_rng(1).uniform(size=7)
    samples.add(point[None])
    samples.add_around(402.0, point)
    omega = samples.all().omega
    for mode in [*open_loop.modes(point, 0.1, 85.0), *open_loop.modes(open_loop.point({}), 130.0, 3000.0)]:
        assert np.abs(omega / mode - 1.0).min() <= 5e-4
    assert np.sum(np.abs(omega / 402.0 - 1.0) < 4e-3) >= 9
    assert len(samples.all()) == len(omega)  # joined once more, nothing is lost or doubled


def test_only_the_tuned_controller_is_free(telescope) -> None:
    for tuned in ((OBSERVER,), (ACTUATORS,), (OBSERVER, ACTUATORS)):
        for k, block in enumerate(blocks(telescope, tuned)):
            assert block.free.any() == (k in tuned)
    observer = blocks(telescope, (OBSERVER,))[OBSERVER]
    assert np.sum(~observer.free) == 4  # no direct path from the camera


def test_the_shares_together_keep_the_limit(telescope) -> None:
    """Slow tones and noise of both stages, together 40 mas for 99.7 % of the windows; alone 100 mas; the APE."""
    budget, both, alone = error_budget(telescope), limits(telescope, BOTH), limits(telescope, ALONE)
    weights = telescope.weights
    assert combined_level(both["slow"], budget.total_noise, 0.997) <= weights.rpe_limit_fine * (1 + 1e-9)
    assert combined_level(alone["slow"], budget.noise, 0.997) <= weights.rpe_limit
    assert combined_level(alone["fast"], budget.noise, 0.997, turn=5.0) <= weights.rpe_limit
    for stage in (alone, both):
        assert combined_level(stage["APE"], budget.ape_noise, 0.997, ABSOLUTE_ON_AXIS) <= weights.ape_limit


def test_a_problem_of_one_controller_has_its_stage_only(open_loop) -> None:
    samples = Samples(open_loop)
    problem = pair_problem(samples, (BOTH,), (ACTUATORS,))
    assert all("alone" not in gain.name for gain in problem.gains)
    assert [noise.name for noise in problem.noises] == ["all noise -> APE", "noise -> RPE"]
    assert problem.free.sum() == 100
