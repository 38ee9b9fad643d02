"""Optima of sampled plants: closed forms, loops, perturbed controllers, bounds of several root mean squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, optimize

from lftkit import Port, System, h2_norm
from lftkit.errors import InputError
from lftkit.synthesis import h2syn
from lftkit.synthesis.riccati_controllers import sampled_lqg
from lftkit.synthesis.shared_h2 import Noise, SampledPlant, shared_bound
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
    assert sampled_lqg(standard_plant(integrator(), "y", "u").extended, direct=direct)[1] ** 2 == pytest.approx(
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


STATES, COMMANDS, MEASURED = 4, 1, 2


def disturbed_plant(seed: int, scale: float = 1.0) -> SampledPlant:
    """Stable, with two process noises and measurement noise; `scale` of its states leaves it the same."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(STATES, STATES))
    A *= 0.98 / np.abs(linalg.eigvals(A)).max()
    size = scale ** np.arange(STATES)
    B, C, M = rng.normal(size=(STATES, COMMANDS)), rng.normal(size=(1, STATES)), rng.normal(size=(MEASURED, STATES))
    process = [Noise(rng.normal(size=(STATES, 1)) / size[:, None], np.zeros(MEASURED)) for _ in range(2)]
    heard = Noise(np.zeros((STATES, 0)), rng.uniform(0.3, 1.0, MEASURED))
    return SampledPlant(A * size / size[:, None], B / size[:, None], C * size, M * size, (*process, heard))


def largest(disturbed_plant: SampledPlant, gain: np.ndarray, order: int) -> float:
    """Largest root mean square with ``x+ = a x + b y, u = c x + d y``; infinite if the loop is not stable."""
    a, b, c, d = gain[:order, :order], gain[:order, order:], gain[order:, :order], gain[order:, order:]
    A = np.block(
        [
            [disturbed_plant.A + disturbed_plant.B @ d @ disturbed_plant.M, disturbed_plant.B @ c],
            [b @ disturbed_plant.M, a],
        ]
    )
    if not np.abs(linalg.eigvals(A)).max() < 1.0:
        return np.inf
    C = np.hstack([disturbed_plant.C, np.zeros((1, order))])
    found = []
    for noise in disturbed_plant.noises:
        process = np.vstack([noise.process, np.zeros((order, noise.process.shape[1]))])
        heard = np.vstack([disturbed_plant.B @ d, b]) * noise.measurement
        P = linalg.solve_discrete_lyapunov(A, process @ process.T + heard @ heard.T)
        found.append((C @ P @ C.T).item())
    return float(np.sqrt(max(found)))


@pytest.mark.further
@pytest.mark.parametrize("seed", range(6))
def test_no_controller_that_is_tuned_is_below_and_one_comes_near(seed: int) -> None:
    """Direct search over controllers of order 2; of full order the bound is the optimum."""
    given = disturbed_plant(seed)
    bound = shared_bound(given).value
    rng, order = np.random.default_rng(seed), 2
    shape = order + COMMANDS, order + MEASURED

    def value(x: np.ndarray) -> float:
        return min(largest(given, x.reshape(shape), order), 1e6)

    best = min(
        optimize.minimize(value, 0.3 * rng.normal(size=shape).ravel(), method="Powell", options={"maxfev": 2000}).fun
        for _ in range(3)
    )
    assert bound * (1.0 - 1e-6) <= best <= 1.35 * bound


def test_one_noise_alone_gives_the_optimum_of_lqg() -> None:
    """scipy's equations, and the power of an estimate that uses the measurement at once."""
    given = disturbed_plant(1)
    together = Noise(
        np.hstack([noise.process for noise in given.noises]), np.sqrt(sum(n.measurement**2 for n in given.noises))
    )
    A, B, C, M = given.A, given.B, given.C, given.M
    X = linalg.solve_discrete_are(A, B, C.T @ C, 1e-9 * np.eye(COMMANDS))
    Y = linalg.solve_discrete_are(A.T, M.T, together.process @ together.process.T, np.diag(together.measurement**2))
    gain = Y @ M.T @ linalg.inv(M @ Y @ M.T + np.diag(together.measurement**2))
    weight = A.T @ X @ B @ linalg.inv(B.T @ X @ B + 1e-9 * np.eye(COMMANDS)) @ B.T @ X @ A
    power = np.trace(together.process.T @ X @ together.process) + np.trace(weight @ (Y - gain @ M @ Y))
    found = shared_bound(SampledPlant(A, B, C, M, (together,)))
    assert found.value**2 == pytest.approx(power, rel=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_units_of_states_do_not_matter(scale: float) -> None:
    assert shared_bound(disturbed_plant(2, scale)).value == pytest.approx(
        shared_bound(disturbed_plant(2)).value, rel=1e-6
    )


def test_what_has_a_weight_is_equal_and_the_mean_is_the_bound() -> None:
    found = shared_bound(disturbed_plant(3))
    assert found.weights @ found.reached**2 == pytest.approx(found.value**2, rel=1e-9)
    assert found.reached.max() <= 1.02 * found.value


def test_a_plant_without_a_bound_is_refused() -> None:
    given = disturbed_plant(0)
    with pytest.raises(InputError, match=r"^plant must be stable without control, got a spectral radius of 1\.96"):
        shared_bound(SampledPlant(2.0 * given.A, given.B, given.C, given.M, given.noises))
    with pytest.raises(InputError, match=r"^every measurement must have noise, got variances \[0\.0, 0\.0\]"):
        SampledPlant(given.A, given.B, given.C, given.M, given.noises[:2])
