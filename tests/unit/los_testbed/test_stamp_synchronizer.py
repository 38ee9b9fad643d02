"""Samples are joined by stamp, whatever the order in which they come."""

import itertools

import numpy as np
import pytest
from los_testbed.bags.cdr import Codec
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP, Part, StampSynchronizer
from los_testbed.topics import VECTOR3

MS = 1_000_000


def make(camera_every=2):
    codec = Codec(VECTOR3, 2, "f")
    parts = [
        Part(codec, slice(0, 2)),
        Part(codec, slice(2, 4), every=camera_every, nan_allowed=True),
        Part(codec, slice(4, 6)),
    ]
    return StampSynchronizer(parts, 6)


def sample(stamp, value):
    return bytes(Codec(VECTOR3, 2, "f").encode(stamp, np.array([value, -value])))


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_any_order_gives_the_same_vector(order):
    synchronizer = make()
    results = [synchronizer.put(i, sample(4 * MS, i + 1.0)) for i in order]
    assert results[:2] == [None, None]
    assert results[2].tolist() == [1, -1, 2, -2, 3, -3]
    assert synchronizer.stamp == 4 * MS


def test_a_part_that_is_not_due_is_nan_and_not_waited_for():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    row = synchronizer.put(2, sample(5 * MS, 3.0))
    assert np.isnan(row[2:4]).all()


def test_a_due_part_is_waited_for():
    synchronizer = make()
    synchronizer.put(0, sample(4 * MS, 1.0))
    assert synchronizer.put(2, sample(4 * MS, 3.0)) is None
    assert synchronizer.waiting
    assert synchronizer.put(1, sample(4 * MS, 2.0)) is not None
    assert not synchronizer.waiting


def test_a_dropped_frame_is_a_value_and_other_nan_is_refused():
    synchronizer = make()
    synchronizer.put(0, sample(4 * MS, 1.0))
    synchronizer.put(1, sample(4 * MS, np.nan))
    assert synchronizer.put(2, sample(4 * MS, np.nan)) is None
    assert synchronizer.rejected["not_finite"] == 1
    assert np.isnan(synchronizer.put(2, sample(4 * MS, 3.0))[2:4]).all()
    synchronizer.put(1, sample(6 * MS, np.inf))
    assert synchronizer.rejected["not_finite"] == 2


def test_two_ticks_interleaved():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    synchronizer.put(0, sample(7 * MS, 2.0))
    assert synchronizer.put(2, sample(5 * MS, 3.0)).tolist()[0] == 1.0
    assert synchronizer.put(2, sample(7 * MS, 4.0)).tolist()[0] == 2.0
    assert synchronizer.gap == 1


def test_a_lost_sample_costs_its_tick_only_and_is_counted():
    synchronizer = make()
    for stamp in (5, 9):
        synchronizer.put(0, sample(stamp * MS, 1.0))
        synchronizer.put(2, sample(stamp * MS, 1.0))
    assert synchronizer.gap == synchronizer.gaps == 3
    assert synchronizer.put(2, sample(7 * MS, 1.0)) is None
    assert synchronizer.rejected["late"] == 1


def test_duplicates_and_stamps_off_the_grid_are_refused():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    synchronizer.put(2, sample(5 * MS, 1.0))
    assert synchronizer.put(2, sample(5 * MS, 1.0)) is None
    assert synchronizer.put(2, sample(7 * MS + 1, 1.0)) is None
    assert synchronizer.put(2, b"\x00\x01") is None
    assert dict(synchronizer.rejected) == {"late": 1, "off_grid": 1, "size": 1}


def test_a_stamp_from_beyond_the_horizon_is_refused_and_does_no_harm():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    synchronizer.put(2, sample(5 * MS, 1.0))
    synchronizer.horizon = 60 * MS
    assert synchronizer.put(0, sample(7001 * MS, 1.0)) is None
    assert synchronizer.rejected["future"] == 1
    synchronizer.put(0, sample(7 * MS, 1.0))
    assert synchronizer.put(2, sample(7 * MS, 1.0)) is not None


def test_holding_starts_anew_even_with_older_stamps():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    synchronizer.put(2, sample(5 * MS, 1.0))
    for i in range(3):
        row = synchronizer.put(i, sample(HOLD_STAMP, 0.0))
    assert row is not None and synchronizer.stamp == HOLD_STAMP
    synchronizer.put(0, sample(3 * MS, 1.0))
    assert synchronizer.put(2, sample(3 * MS, 1.0)) is not None
    assert synchronizer.gap == 0


def test_a_stray_hold_message_disturbs_no_tick_under_way():
    """Tick 64 and the hold tick would share a place if places were counted modulo 64 alone."""
    synchronizer = make()
    synchronizer.put(0, sample(64 * MS, 1.0))
    synchronizer.put(1, sample(HOLD_STAMP, 0.0))
    synchronizer.put(1, sample(64 * MS, 2.0))
    assert synchronizer.put(2, sample(64 * MS, 3.0)).tolist() == [1, -1, 2, -2, 3, -3]
    assert synchronizer.stamp == 64 * MS
