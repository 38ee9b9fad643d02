"""No value that synthesis or tuning returns is below a lower bound, numerical or proven, of the same problem.

Random plants, every second one sampled, stable and unstable, with more and with as many disturbances as measurements.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations
from support.slow_cases import slow

from lftkit import System, h2_norm, hinf_norm
from lftkit.synthesis import h2syn, hinfsyn, lower_bound_proof, mixsyn
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.tuning import HinfGain, TuningOptions, state_space, tune

ROUNDING = 5e-6
"""Of a numerical bound, the width of its last bisection; a proven bound has none."""
NORM = 1e-9
"""Of a norm that is computed."""


def random_plant(seed: int, most: int) -> System:
    """One to `most` states; noise on every measurement, weights on every command, but in a seventh; D11 in a third."""
    rng = np.random.default_rng(seed)
    n, u, y = (int(k) for k in rng.integers(1, [most + 1, 3, 3]))
    w, z = y + int(rng.integers(3)), u + int(rng.integers(1, 3))
    D = np.zeros((z + y, w + u))
    D[:z, w:], D[z:, :w] = rng.standard_normal((z, u)), rng.standard_normal((y, w))
    D[:z, :w] = rng.standard_normal((z, w)) * (seed % 3 == 0)
    if seed % 7 == 4:
        D[z:] = 0.0
    if seed % 14 == 4:
        D[:, w:] = 0.0
    # without noise and weights an optimum of four unstable modes can be at 1e5, where equations end
    A = rng.standard_normal((n, n)) - rng.uniform(1.0 if seed % 7 == 4 else -1.0, 2.0) * np.eye(n)
    matrices = A, rng.standard_normal((n, w + u)), rng.standard_normal((z + y, n)), D
    return System(*matrices, [("w", w), ("u", u)], [("z", z), ("y", y)], "P")


def sampled(plant: System, dt: float = 0.1) -> System:
    return System(*to_discrete(*plant.matrices, dt), plant.inputs, plant.outputs, plant.name, dt)


def norm(closed: System) -> float:
    return hinf_norm(*closed.matrices, dt=closed.dt or None).value


def check_synthesis(seed: int, most: int) -> None:
    plant = random_plant(seed, most)
    given = sampled(plant) if seed % 2 else plant
    found = hinfsyn(given, "y", "u")
    assert found.value >= found.lower * (1.0 - ROUNDING)
    if seed % 4 < 2:
        proven = lower_bound_proof(given, "y", "u").level
        assert min(found.value, norm(found.closed)) >= proven * (1.0 - NORM)
        assert found.regularised or not np.isfinite(found.lower) or proven <= found.lower * (1.0 + ROUNDING)
    if seed % 7 != 4 and (given is not plant or seed % 3):  # the H2 optimum bounds every loop that has an H2 norm
        best = h2syn(given, "y", "u")
        assert norm(best.closed) >= found.lower * (1.0 - ROUNDING)
        if given is not plant or not found.closed.D.any():
            assert float(h2_norm(found.closed)) >= best.lower * (1.0 - ROUNDING)


def check_mixed_sensitivity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    A = rng.standard_normal((n, n)) - rng.uniform(0.0, 2.0) * np.eye(n)
    G = System(A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)), np.zeros((1, 1)), [("u", 1)], [("y", 1)])
    pole, gain = -(10.0 ** rng.uniform(-3, 0)), rng.uniform(0.3, 2.0)
    weight = System([[pole]], [[1.0]], [[gain]], [[0.5]], [("e", 1)], [("z", 1)])
    found = mixsyn(G, weight, 10.0 ** rng.uniform(-2, 0), certify=not seed % 2)
    assert found.value >= found.lower * (1.0 - (ROUNDING if seed % 2 else NORM))


def check_tuning(seed: int) -> None:
    plant = random_plant(seed, 3)
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], 1 + seed % 2)
    options = TuningOptions(starts=1, seed=seed, iterations=5, wall_limit=100.0)
    with pytest.MonkeyPatch.context() as patch:  # the limit is a number of evaluations
        counted_evaluations(Clock(), patch)
        result = tune([plant], [HinfGain("w", "z")], structure, options=options)
    assert result.soft >= result.lower_bound * (1.0 - ROUNDING)
    assert result.soft >= lower_bound_proof(plant, "y", "u").level * (1.0 - NORM)


def test_no_controller_of_synthesis_is_below() -> None:
    for seed in range(12):  # each kind of plant
        check_synthesis(seed, 3)


@pytest.mark.parametrize("seed", range(3))
def test_no_mixed_sensitivity_is_below(seed: int) -> None:
    check_mixed_sensitivity(seed)


@pytest.mark.parametrize("seed", [slow(0), 1])
def test_no_tuned_controller_is_below(seed: int) -> None:
    check_tuning(seed)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(100, 600, 50))
def test_no_controller_of_many_plants_is_below(first: int) -> None:
    """Up to eight states."""
    for seed in range(first, first + 50):
        check_synthesis(seed, 8)
    for seed in range(first, first + 10):
        check_mixed_sensitivity(seed)
        check_tuning(seed)
