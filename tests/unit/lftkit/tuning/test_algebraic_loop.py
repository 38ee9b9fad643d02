"""The algebraic loop of plant and controller stays away from being singular."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, gain, tune
from lftkit.tuning.gains.algebraic_loop import LEAST, algebraic_values


def test_values_have_the_slopes_of_their_differences() -> None:
    rng = np.random.default_rng(2)
    D22, X = rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    worst = np.linalg.eigvals(D22 @ X).real.max()
    K = X * (1.0 - 1.5 * LEAST) / worst
    ((value, gradient),) = algebraic_values(D22, K)
    assert value == pytest.approx(1.0 / 1.5, rel=1e-6)
    h = 1e-9
    for i, j in np.ndindex(K.shape):
        E = np.zeros(K.shape)
        E[i, j] = h
        ((more, _),), ((less, _),) = algebraic_values(D22, K + E), algebraic_values(D22, K - E)
        assert gradient[i, j] == pytest.approx((more - less) / (2.0 * h), rel=1e-4, abs=1e-4)


def test_a_value_that_falls_up_to_the_singular_loop_ends_before_it() -> None:
    """x' = -x + w + u, y = x - u / 2, u = k y: x = w / (s + 1 - k / (1 + k / 2)), singular at k = -2."""
    plant = System(
        [[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, -0.5]], [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    )
    requirements = [HinfGain("w", "z", name="gain"), HinfGain("w", "z", bound=10.0, hard=True, name="bound")]
    options = TuningOptions(starts=0)
    result = tune([plant], requirements, gain([("y", 1)], [("u", 1)]), initial=[[-0.5]], options=options)
    k = result.x.item()
    assert 1.0 + 0.5 * k == pytest.approx(LEAST, rel=1e-2)
    assert result.soft == pytest.approx(1.0 / (1.0 - k / (1.0 + 0.5 * k)), rel=1e-6)
