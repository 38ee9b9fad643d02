"""Samples are joined by stamp, whatever the order in which they come."""

import itertools

import numpy as np
import pytest
from los_testbed.bags.cdr import Codec
from los_testbed.run.loop.slow_sensor import SlowSensor, frames_in_words
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP, HORIZON_NS, NOT_KNOWN, StampSynchronizer, TickPart

from pointing_analysis.read.messages.message_types import VECTOR3

MS = 1_000_000


def make(camera_every=2):
    codec = Codec(VECTOR3, 2, "f")
    parts = [
        TickPart(codec, slice(0, 2)),
        TickPart(codec, slice(2, 4), every=camera_every, intermittent=range(2)),
        TickPart(codec, slice(4, 6)),
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


def test_a_dropped_frame_is_a_value_and_other_nan_is_refused():
    synchronizer = make()
    synchronizer.put(0, sample(4 * MS, 1.0))
    synchronizer.put(1, sample(4 * MS, np.nan))
    assert synchronizer.put(2, sample(4 * MS, np.nan)) is None
    assert synchronizer.rejected["not_finite"] == 1
    assert np.isnan(synchronizer.put(2, sample(4 * MS, 3.0))[2:4]).all()
    synchronizer.put(1, sample(6 * MS, np.inf))
    assert synchronizer.rejected["not_finite"] == 2


def test_a_single_hold_message_does_not_change_an_incomplete_tick():
    """Tick 64 and the hold tick would share a slot if slots were the tick numbers modulo 64 alone."""
    synchronizer = make()
    synchronizer.put(0, sample(64 * MS, 1.0))
    synchronizer.put(1, sample(HOLD_STAMP, 0.0))
    synchronizer.put(1, sample(64 * MS, 2.0))
    assert synchronizer.put(2, sample(64 * MS, 3.0)).tolist() == [1, -1, 2, -2, 3, -3]
    assert synchronizer.stamp == 64 * MS


def test_nothing_of_an_incomplete_tick_is_left_when_its_slot_is_used_again():
    """Ticks 64 apart share a slot: an older part does not count for the newer tick."""
    synchronizer = make()
    assert not synchronizer.waiting and (synchronizer.gap, synchronizer.gaps, synchronizer.stamp) == (0, 0, HOLD_STAMP)
    synchronizer.put(0, sample(5 * MS, 1.0))
    assert synchronizer.put(2, sample(69 * MS, 3.0)) is None
    assert synchronizer.put(0, sample(69 * MS, 2.0)).tolist()[:2] == [2.0, -2.0]


def test_an_old_tick_does_not_push_a_newer_one_out_of_its_slot():
    synchronizer = make()
    synchronizer.put(0, sample(69 * MS, 2.0))
    assert synchronizer.put(0, sample(5 * MS, 1.0)) is None
    assert dict(synchronizer.rejected) == {"late": 1}
    assert synchronizer.put(2, sample(69 * MS, 3.0)).tolist()[:2] == [2.0, -2.0]


def test_64_ticks_may_be_under_way_at_once():
    synchronizer = make(camera_every=1000)
    for tick in range(1, 65):
        synchronizer.put(0, sample(tick * MS, float(tick)))
    for tick in range(1, 65):
        assert synchronizer.put(2, sample(tick * MS, 0.0)).tolist()[0] == tick
        assert (synchronizer.gap, synchronizer.gaps, synchronizer.stamp) == (0, 0, tick * MS)
        assert synchronizer.waiting is (tick < 64)


def complete(synchronizer, tick):
    synchronizer.put(0, sample(tick * MS, 1.0))
    return synchronizer.put(2, sample(tick * MS, 1.0))


def test_the_horizon_itself_is_accepted_and_none_applies_before_the_time_is_known():
    synchronizer = make()
    assert complete(synchronizer, 5) is not None
    synchronizer.now = 7 * MS - HORIZON_NS
    assert complete(synchronizer, 7) is not None
    assert complete(synchronizer, 9) is None
    assert synchronizer.gaps == 1


def test_gaps_add_up_and_the_first_tick_and_a_hold_are_none():
    synchronizer = make()
    for tick, gap in ((1, 0), (3, 1), (5, 1), (6, 0), (11, 4)):
        row = complete(synchronizer, tick)
        if row is None:  # an even tick has a camera frame
            row = synchronizer.put(1, sample(tick * MS, 1.0))
        assert row is not None and synchronizer.gap == gap and isinstance(synchronizer.gap, int)
    assert synchronizer.gaps == 6
    for i in range(3):
        synchronizer.put(i, sample(HOLD_STAMP, 0.0))
    assert (synchronizer.gap, synchronizer.gaps, synchronizer.stamp) == (0, 6, HOLD_STAMP)
    assert complete(synchronizer, 21) is not None and (synchronizer.gap, synchronizer.gaps) == (0, 6)


def test_a_hold_needs_every_part_and_forgets_ticks_under_way():
    synchronizer = make()
    synchronizer.put(0, sample(5 * MS, 1.0))
    synchronizer.put(0, sample(HOLD_STAMP, 0.0))
    assert synchronizer.put(2, sample(HOLD_STAMP, 0.0)) is None
    assert synchronizer.put(1, sample(HOLD_STAMP, 0.0)) is not None
    assert not synchronizer.waiting
    assert synchronizer.put(2, sample(5 * MS, 2.0)) is None  # its other part came before the hold
    assert synchronizer.waiting


def test_a_message_that_ends_after_its_stamp_is_judged_by_its_stamp_first():
    synchronizer = make()
    complete(synchronizer, 5)
    for stamp in (7 * MS + 1, 4 * MS, 7 * MS):
        assert synchronizer.put(0, sample(stamp, 1.0)[:12]) is None
    assert synchronizer.put(0, sample(7 * MS, 1.0)[:11]) is None
    assert dict(synchronizer.rejected) == {"off_grid": 1, "late": 1, "size": 2}
    before_the_epoch = sample(5 * MS, 1.0)[:4] + (-1).to_bytes(4, "little", signed=True) + sample(5 * MS, 1.0)[8:]
    assert synchronizer.put(0, before_the_epoch) is None
    assert sum(synchronizer.rejected.values()) == 5 and not synchronizer.waiting


def own_time(old="correct", latency_ms=0, every=20):
    """Synchronizer of a run in real time whose camera (part 1) sees 0.1 of the gauge (part 2)."""
    camera = SlowSensor("camera", slice(2, 4), every * MS, latency_ms * MS, old, slice(4, 6), 0.1)
    codec = Codec(VECTOR3, 2, "f")
    parts = [TickPart(codec, slice(0, 2)), TickPart(codec, slice(2, 4), every, range(2)), TickPart(codec, slice(4, 6))]
    return StampSynchronizer(parts, 6, {1: camera}), camera


def tick(synchronizer, number, gauge=0.0, offset=0):
    synchronizer.put(0, sample(number * MS + offset, 1.0))
    return synchronizer.put(2, sample(number * MS + offset, gauge))


def test_no_tick_waits_for_a_slow_sensor_and_its_frame_is_used_when_it_comes():
    synchronizer, camera = own_time(latency_ms=7)
    for k in range(40, 47):
        assert np.isnan(tick(synchronizer, k)[2:4]).all()
    assert synchronizer.put(1, sample(40 * MS, 5.0)) is None
    assert tick(synchronizer, 47)[2:4].tolist() == [5.0, -5.0]
    assert np.isnan(tick(synchronizer, 48)[2:4]).all(), "a frame is one sample"
    statistics = camera.statistics()
    assert (statistics["frames_camera_old"], statistics["frames_camera_age_max_ms"]) == ("1", "7")
    assert "frames_camera_late" not in statistics, "its latency is known"


@pytest.mark.parametrize(("old", "seen"), [("use", 5.0), ("correct", 5.0 + 0.1 * (3.0 - 1.0)), ("drop", np.nan)])
def test_what_is_done_with_an_old_frame_is_a_choice(old, seen):
    synchronizer, camera = own_time(old)
    assert tick(synchronizer, 40, gauge=1.0) is not None
    tick(synchronizer, 41, gauge=2.0)
    synchronizer.put(1, sample(40 * MS, 5.0))
    assert tick(synchronizer, 42, gauge=3.0)[2] == pytest.approx(seen, nan_ok=True)
    assert camera.counts["late"] == 1


def test_irregular_frames_are_counted_by_name_and_said_in_words():
    synchronizer, camera = own_time()
    for k in range(20, 501):
        synchronizer.now = k * MS
        if k in (20, 40, 80, 107, 460):  # 60 is absent, 107 comes 7 ms after its phase, then nothing until 460
            synchronizer.put(1, sample(k * MS, float(k)))
        if k == 110:
            synchronizer.put(1, sample(150 * MS, 1.0))
        if k == 470:
            synchronizer.put(1, sample(440 * MS, 1.0))
        tick(synchronizer, k)
        if k == 440:
            assert synchronizer.silent() == [(1, 290 * MS)]
    (line,) = frames_in_words(camera.statistics())
    assert line == (
        "camera: 19 frames absent, 1 frame early, 2 frames off phase, 1 frame out of order, silent for 0.31 s"
    )


@pytest.mark.parametrize("offset", [-300_000, 300_000, 499_000])
def test_stamps_of_acquisition_beside_the_grid_count_for_their_tick(offset):
    synchronizer, _ = own_time()
    rng = np.random.default_rng(1)
    for k in range(40, 90):
        assert tick(synchronizer, k, offset=offset + (k > 40) * int(rng.integers(-90_000, 90_000))) is not None
        assert synchronizer.stamp == k * MS
    assert synchronizer.gaps == 0 and synchronizer.off_grid[0] == 50 and not synchronizer.rejected


def test_a_sensor_whose_values_are_not_finite_is_not_called_silent():
    synchronizer, _ = own_time()
    tick(synchronizer, 40)
    for k in range(41, 440):
        synchronizer.put(0, sample(k * MS, 1.0))
        synchronizer.put(2, sample(k * MS, np.nan))
    assert synchronizer.silent() == [] and dict(synchronizer.not_finite) == {(2, ""): 399}
    tick(synchronizer, 440)
    assert synchronizer.last == 440 * MS


def test_of_a_message_of_several_topics_the_one_with_an_odd_value_is_named_and_the_frame_in_it_is_used():
    codec = Codec(VECTOR3, 3, "f")
    topics = {"accel": slice(0, 1), "camera": slice(1, 2)}
    part = TickPart(codec, slice(0, 3), 1, (1, 2), [(1, 2)], topics)
    camera = SlowSensor("camera", slice(1, 2), 2 * MS, 10 * MS)
    synchronizer = StampSynchronizer([part], 3, {1: camera})

    def put(k, *values):
        return synchronizer.put(0, bytes(codec.encode(k * MS, np.array(values))))

    assert put(39, 1.0, np.nan, np.nan) is not None
    assert put(40, np.nan, 5.0, 0.0) is None
    assert put(41, 1.0, np.inf, 0.0) is not None and put(42, 1.0, 5.0, np.inf) is not None
    assert dict(synchronizer.not_finite) == {(0, "accel"): 1, (1, ""): 2}
    assert put(43, 1.0, np.nan, np.nan) is not None and camera.counts["came"] == 1


def test_a_frame_of_the_far_future_costs_no_other_one():
    """Not even the first of all, which comes before the time is known."""
    synchronizer, camera = own_time()
    synchronizer.put(1, sample(3_600_000 * MS, 9.0))
    used = []
    for k in range(20, 400):
        synchronizer.now = k * MS if k > 20 else NOT_KNOWN
        if k == 100:
            synchronizer.put(1, sample(7_200_000 * MS, 9.0))
        if k % 20 == 0:
            synchronizer.put(1, sample(k * MS, 5.0))
        if tick(synchronizer, k)[2] == 5.0:
            used.append(k)
    assert used == list(range(40, 400, 20)), "that of the first tick, too, comes after the false one"
    assert camera.counts["out_of_order"] == 1 and camera.counts["early"] == 1
    assert synchronizer.rejected == {"future": 1}


def test_frames_that_come_before_the_other_samples_of_a_stall_wait_for_their_ticks():
    synchronizer, camera = own_time()
    used = []

    def go_on(ticks, frames):
        for k in ticks:
            if k in frames:
                synchronizer.put(1, sample(k * MS, float(k)))
            row = tick(synchronizer, k)
            if not np.isnan(row[2]):
                used.append((k, row[2]))

    go_on(range(20, 201), range(20, 201, 20))
    synchronizer.now = 300 * MS
    for k in range(220, 301, 20):
        synchronizer.put(1, sample(k * MS, float(k)))
    go_on(range(201, 301), ())
    assert used == [(k, float(k)) for k in range(20, 301, 20)]
    assert not {"frames_camera_early", "frames_camera_absent", "frames_camera_old"} & set(camera.statistics())


@pytest.mark.parametrize("moved", [range(1), range(100, 3000)], ids=["the first frame", "the trigger, once"])
def test_a_grid_of_frames_that_goes_on_beside_the_first_one_is_the_grid(moved):
    _, camera = own_time()
    for number in range(3000):
        stamp = number * 20 * MS + (2 * MS if number in moved else 0)
        camera.note(stamp, stamp, stamp, stamp)
    assert 0 < camera.counts["off_phase"] <= 6


def test_an_old_frame_is_corrected_by_the_mirror_s_way_since_its_own_tick():
    """Also where an older one had been waiting."""
    synchronizer, _ = own_time()
    tick(synchronizer, 39, gauge=1.0)
    tick(synchronizer, 40, gauge=2.0)
    synchronizer.put(1, sample(39 * MS, 5.0))
    synchronizer.put(1, sample(40 * MS, 6.0))
    assert tick(synchronizer, 41, gauge=3.0)[2] == pytest.approx(6.0 + 0.1 * (3.0 - 2.0))
