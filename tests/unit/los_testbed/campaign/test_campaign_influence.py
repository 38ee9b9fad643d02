"""Shares of the variance of parameters that have few values, as corners and lists of members have them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.influence import bins_of, influences, pair_effects
from los_testbed.campaign.sampling import members

COLUMNS = tuple("abcdefg")
"""Seven parameters."""

CORNERS = members("corners", 0, 0)
SIGNS = np.sign(CORNERS - CORNERS.mean(axis=0))


def shares(telescope: Any, metric: Any) -> dict[str, float]:
    """First-order shares by parameter."""
    return {one.parameter: one.first_order for one in influences(dict(zip(COLUMNS, telescope.T)), metric)}


def pairs(telescope: Any, metric: Any) -> dict[tuple[str, str], float]:
    """Shares of the pairs that have one."""
    return {
        one.parameters: one.share for one in pair_effects(dict(zip(COLUMNS, telescope.T)), metric) if one.share > 0.0
    }


def test_corners_have_the_shares_of_a_two_level_design() -> None:
    """Of a sum of two signs each has half of the variance and nothing else has any; the order does not matter."""
    for first, second in itertools.combinations(range(7), 2):
        found = shares(CORNERS, SIGNS[:, first] + SIGNS[:, second])
        for k, name in enumerate(COLUMNS):
            assert found[name] == pytest.approx(0.5 if k in (first, second) else 0.0, abs=0.01)
    order = np.random.default_rng(1).permutation(128)
    metric = SIGNS[:, 0] + SIGNS[:, 6]
    assert shares(CORNERS[order], metric[order]) == pytest.approx(shares(CORNERS, metric), abs=1e-12)


def test_a_sum_has_no_pairs_and_a_product_is_one() -> None:
    assert pairs(CORNERS, SIGNS[:, 0] + SIGNS[:, 1] + SIGNS[:, 2]) == {}
    found = pairs(CORNERS, SIGNS[:, 0] + 2.0 * SIGNS[:, 2] * SIGNS[:, 5])
    assert list(found) == [(COLUMNS[2], COLUMNS[5])] and found[COLUMNS[2], COLUMNS[5]] == pytest.approx(0.8, abs=0.02)


def test_a_list_with_repeated_values_has_those_of_its_values() -> None:
    """Three values of one parameter, half of the members at one value of another, the rest of it continuous."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1.0, 1.0, (3000, 7))
    x[:, 0] = rng.choice([-1.0, 0.0, 1.0], 3000)
    x[:1500, 3] = 0.25
    for metric, only in ((x[:, 0] ** 2, 0), (np.where(x[:, 3] == 0.25, 1.0, 0.0), 3)):
        found = shares(x, metric)
        assert found[COLUMNS[only]] == pytest.approx(1.0, abs=0.1)
        assert max(value for name, value in found.items() if name != COLUMNS[only]) < 0.02
    assert pairs(x, x[:, 0] + x[:, 1]) == {}
    assert next(iter(pairs(x, x[:, 0] * x[:, 1]))) == (COLUMNS[0], COLUMNS[1])


@pytest.mark.parametrize("bins", [3, 8, 20])
def test_equal_values_are_in_one_bin(bins: int) -> None:
    """Whatever the ties; bins follow the order of the values and are numbered without gaps."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        values = rng.integers(0, rng.integers(1, 60), 200).astype(float)
        place = bins_of(values, bins)
        assert all(len(set(place[values == value])) == 1 for value in set(values))
        assert (np.diff(place[np.argsort(values)]) >= 0).all()
        assert set(place) == set(range(int(place.max()) + 1)) and place.max() < bins
        if len(set(values)) <= bins:
            assert len(set(place)) == len(set(values))
