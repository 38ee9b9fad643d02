"""Members of a campaign: inside the box, in an order that the seed fixes; shares of variance of their parameters."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.influence import bins_of, influences, pair_effects
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members

REFERENCE = MemberParameters.of()
COLUMNS, RANGES = REFERENCE.columns, REFERENCE.limits


@pytest.mark.parametrize("sampling", ["uniform", "lhs"])
def test_random_members_lie_in_the_box_and_follow_the_seed(sampling: str) -> None:
    points = members(sampling, 50, 3)
    assert points.shape == (50, 7)
    assert np.all(points >= RANGES[:, 0]) and np.all(points <= RANGES[:, 1])
    assert np.array_equal(points, members(sampling, 50, 3))
    assert not np.array_equal(points, members(sampling, 50, 4))
    assert len(np.unique(member_seeds(50, 3))) == 50


def test_more_uniform_members_continue_the_list() -> None:
    assert np.array_equal(members("uniform", 200, 8)[:20], members("uniform", 20, 8))
    assert np.array_equal(member_seeds(200, 8)[:20], member_seeds(20, 8))


def test_latin_hypercube_has_one_member_in_each_interval() -> None:
    unit = (members("lhs", 40, 1) - RANGES[:, 0]) / (RANGES[:, 1] - RANGES[:, 0])
    for column in unit.T:
        assert sorted(np.floor(40 * column).astype(int)) == list(range(40))


def test_corners_are_all_ends_of_all_ranges() -> None:
    points = members("corners", 0, 0)
    assert len(np.unique(points, axis=0)) == 2**7
    for column, ends in zip(points.T, RANGES):
        assert set(column) == set(ends)
    assert np.array_equal(members("corners", 5, 9), points[:5])


def test_list_from_a_file_in_any_order_of_columns(tmp_path: Path) -> None:
    points = members("uniform", 3, 2)
    order = [6, 0, 1, 2, 3, 4, 5]
    lines = [",".join(COLUMNS[k] for k in order), *(",".join(repr(float(p[k])) for k in order) for p in points)]
    (tmp_path / "list.csv").write_text("\n".join(lines), "utf-8")
    assert np.array_equal(members(str(tmp_path / "list.csv"), 0, 1), points)
    assert np.array_equal(members(str(tmp_path / "list.csv"), 2, 1), points[:2])
    (tmp_path / "sheet.csv").write_text("\ufeff" + "\r\n".join([*lines, "", ""]), "utf-8")  # as spreadsheets do
    assert np.array_equal(members(str(tmp_path / "sheet.csv"), 0, 1), points)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("", "the header must be .*, got nothing"),
        (",".join(COLUMNS) + "\n0,0,0,0,0,0.74,9", r"line 2: omega_2 must be between .*, got 9"),
        (",".join(COLUMNS) + "\n0,0,0,0,0,0.74,2.6\n0,0,0,x,0,0.74,2.6", r"line 3: wheel_speed_3 must be .*, got 'x'"),
        (",".join(COLUMNS) + "\n0,0,0", r"line 2: wheel_speed_3 must be between .*, got ''"),
    ],
)
def test_bad_lists_are_refused(lines: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "list.csv").write_text(lines, "utf-8")
    with pytest.raises(ValueError, match=message):
        members(str(tmp_path / "list.csv"), 0, 1)


NAMES = tuple("abcdefg")

"""Seven parameters."""

CORNERS = members("corners", 0, 0)

SIGNS = np.sign(CORNERS - CORNERS.mean(axis=0))


def shares(telescope: Any, metric: Any) -> dict[str, float]:
    """First-order shares by parameter."""
    return {one.parameter: one.first_order for one in influences(dict(zip(NAMES, telescope.T)), metric)}


def pairs(telescope: Any, metric: Any) -> dict[tuple[str, str], float]:
    """Shares of the pairs that have more than chance makes."""
    return {one.parameters: one.share for one in pair_effects(dict(zip(NAMES, telescope.T)), metric) if one.known}


def test_by_chance_five_percent_of_the_campaigns_have_an_influence() -> None:
    """60 members whose metric depends on nothing: some parameter has a share of 8 % in half of such campaigns."""
    known = largest = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        telescope, metric = rng.uniform(size=(60, 7)), rng.standard_normal(60)
        found = influences(dict(zip(NAMES, telescope.T)), metric)
        known += any(one.known for one in found)
        largest += max(one.first_order for one in found) > 0.07
    assert largest > 20 and known <= 9  # 3 are expected


def test_an_influence_that_is_there_is_known() -> None:
    rng = np.random.default_rng(0)
    telescope = rng.uniform(-1.0, 1.0, size=(60, 7))
    found = influences(dict(zip(NAMES, telescope.T)), 2.0 * telescope[:, 4] + rng.standard_normal(60))
    assert [one.parameter for one in found if one.known] == ["e"]
    assert abs(found[0].rank_correlation) > found[0].chance_rank_correlation > abs(found[1].rank_correlation)


def test_corners_have_the_shares_of_a_two_level_design() -> None:
    """Of a sum of two signs each has half of the variance and nothing else has any; the order does not matter."""
    for first, second in itertools.combinations(range(7), 2):
        found = shares(CORNERS, SIGNS[:, first] + SIGNS[:, second])
        for k, name in enumerate(NAMES):
            assert found[name] == pytest.approx(0.5 if k in (first, second) else 0.0, abs=0.01)
    order = np.random.default_rng(1).permutation(128)
    metric = SIGNS[:, 0] + SIGNS[:, 6]
    assert shares(CORNERS[order], metric[order]) == pytest.approx(shares(CORNERS, metric), abs=1e-12)


def test_a_sum_has_no_pairs_and_a_product_is_one() -> None:
    assert pairs(CORNERS, SIGNS[:, 0] + SIGNS[:, 1] + SIGNS[:, 2]) == {}
    found = pairs(CORNERS, SIGNS[:, 0] + 2.0 * SIGNS[:, 2] * SIGNS[:, 5])
    assert list(found) == [(NAMES[2], NAMES[5])] and found[NAMES[2], NAMES[5]] == pytest.approx(0.8, abs=0.02)


def test_a_list_with_repeated_values_has_those_of_its_values() -> None:
    """Three values of one parameter, half of the members at one value of another, the rest of it continuous."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1.0, 1.0, (3000, 7))
    x[:, 0] = rng.choice([-1.0, 0.0, 1.0], 3000)
    x[:1500, 3] = 0.25
    for metric, only in ((x[:, 0] ** 2, 0), (np.where(x[:, 3] == 0.25, 1.0, 0.0), 3)):
        found = shares(x, metric)
        assert found[NAMES[only]] == pytest.approx(1.0, abs=0.1)
        assert max(value for name, value in found.items() if name != NAMES[only]) < 0.02
    assert pairs(x, x[:, 0] + x[:, 1]) == {}
    assert next(iter(pairs(x, x[:, 0] * x[:, 1]))) == (NAMES[0], NAMES[1])


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
