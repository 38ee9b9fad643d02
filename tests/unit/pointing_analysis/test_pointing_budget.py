"""Error budgets: biases add, independent errors add in squares, bad input is refused."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.budget.lines import combine, contribution, periodic, uniform


def test_means_add_linearly_and_do_not_enter_the_rpe() -> None:
    parts = [contribution("a", 3.0, mean=[1, -2, 0]), contribution("b", 4.0, mean=[1, -2, 0])]
    ape, rpe = combine(parts, "APE", 3.0), combine(parts, "RPE", 3.0)
    assert ape.rss.tolist() == [5, 5, 5]
    assert ape.mean.tolist() == [2, -4, 0]
    assert ape.level.tolist() == [17, 19, 15]
    assert rpe.level.tolist() == [15, 15, 15]


def test_standard_deviations_against_samples() -> None:
    rng = np.random.default_rng(0)
    assert uniform(2.0) == pytest.approx(rng.uniform(-2, 2, 400_000).std(), rel=5e-3)
    assert periodic(2.0) == pytest.approx((2 * np.sin(rng.uniform(0, 2 * np.pi, 400_000))).std(), rel=5e-3)


def test_level_holds_the_stated_share_of_a_mixed_sum() -> None:
    """Two sigmas of a sum of uniform, periodic and Gaussian errors hold about 95 % (central limit)."""
    rng = np.random.default_rng(1)
    n = 200_000
    total = rng.uniform(-3, 3, n) + 2 * np.sin(rng.uniform(0, 2 * np.pi, n)) + rng.standard_normal(n)
    parts = [contribution("u", uniform(3.0)), contribution("p", periodic(2.0)), contribution("g", 1.0)]
    assert np.mean(np.abs(total) < combine(parts, "APE", 2.0).level[0]) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: contribution("a", -1.0), "zero or more"),
        (lambda: contribution("a", [np.nan, 1, 1]), "zero or more"),
        (lambda: combine([contribution("a", 1.0)], "XYZ"), "index must be APE or RPE"),
        (lambda: combine([]), "number of axes, got none"),
        (lambda: combine([contribution("a", 1.0), contribution("b", [1.0, 2.0])]), "number of axes"),
    ],
)
def test_bad_input(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
