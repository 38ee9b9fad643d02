"""Members of a campaign: inside the box, in an order that the seed fixes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
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
