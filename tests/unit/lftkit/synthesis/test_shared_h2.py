"""The bound of several root mean squares: of no controller, however it is found, are all of them below it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, optimize

from lftkit.errors import InputError
from lftkit.synthesis.shared_h2 import Noise, SampledPlant, shared_bound

STATES, COMMANDS, MEASURED = 4, 1, 2


def plant(seed: int, scale: float = 1.0) -> SampledPlant:
    """Stable, with two process noises and measurement noise; `scale` of its states leaves it the same."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(STATES, STATES))
    A *= 0.98 / np.abs(linalg.eigvals(A)).max()
    size = scale ** np.arange(STATES)
    B, C, M = rng.normal(size=(STATES, COMMANDS)), rng.normal(size=(1, STATES)), rng.normal(size=(MEASURED, STATES))
    process = [Noise(rng.normal(size=(STATES, 1)) / size[:, None], np.zeros(MEASURED)) for _ in range(2)]
    heard = Noise(np.zeros((STATES, 0)), rng.uniform(0.3, 1.0, MEASURED))
    return SampledPlant(A * size / size[:, None], B / size[:, None], C * size, M * size, (*process, heard))


def largest(plant: SampledPlant, gain: np.ndarray, order: int) -> float:
    """Largest root mean square with ``x+ = a x + b y, u = c x + d y``; infinite if the loop is not stable."""
    a, b, c, d = gain[:order, :order], gain[:order, order:], gain[order:, :order], gain[order:, order:]
    A = np.block([[plant.A + plant.B @ d @ plant.M, plant.B @ c], [b @ plant.M, a]])
    if not np.abs(linalg.eigvals(A)).max() < 1.0:
        return np.inf
    C = np.hstack([plant.C, np.zeros((1, order))])
    found = []
    for noise in plant.noises:
        process = np.vstack([noise.process, np.zeros((order, noise.process.shape[1]))])
        heard = np.vstack([plant.B @ d, b]) * noise.measurement
        P = linalg.solve_discrete_lyapunov(A, process @ process.T + heard @ heard.T)
        found.append((C @ P @ C.T).item())
    return float(np.sqrt(max(found)))


@pytest.mark.further
@pytest.mark.parametrize("seed", range(6))
def test_no_controller_that_is_tuned_is_below_and_one_comes_near(seed: int) -> None:
    """Direct search over controllers of order 2; of full order the bound is the optimum."""
    given = plant(seed)
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
    given = plant(1)
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
    assert shared_bound(plant(2, scale)).value == pytest.approx(shared_bound(plant(2)).value, rel=1e-6)


def test_what_has_a_weight_is_equal_and_the_mean_is_the_bound() -> None:
    found = shared_bound(plant(3))
    assert found.weights @ found.reached**2 == pytest.approx(found.value**2, rel=1e-9)
    assert found.reached.max() <= 1.02 * found.value


def test_a_plant_without_a_bound_is_refused() -> None:
    given = plant(0)
    with pytest.raises(InputError, match=r"^plant must be stable without control, got a spectral radius of 1\.96"):
        shared_bound(SampledPlant(2.0 * given.A, given.B, given.C, given.M, given.noises))
    with pytest.raises(InputError, match=r"^every measurement must have noise, got variances \[0\.0, 0\.0\]"):
        SampledPlant(given.A, given.B, given.C, given.M, given.noises[:2])
