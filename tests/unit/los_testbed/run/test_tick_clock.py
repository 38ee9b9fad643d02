"""Deadlines and overruns of the loop's clock, on a simulated steady clock."""

import pytest
from los_testbed.run.loop import tick_clock
from los_testbed.run.loop.tick_clock import TickClock, wait_until

MS = 1_000_000


class SteadyClock:
    """Steady clock of a machine that reads it in 1 us and sleeps `oversleep` ns too long."""

    def __init__(self, oversleep):
        self.now, self.oversleep, self.slept = 7 * MS, oversleep, 0

    def monotonic_ns(self):
        self.now += 1000
        return self.now

    def sleep(self, seconds):
        self.slept += 1
        self.now += round(seconds * 1e9) + self.oversleep


@pytest.fixture
def steady(monkeypatch):
    clock = SteadyClock(oversleep=40_000)
    monkeypatch.setattr(tick_clock, "time", clock)
    return clock


def test_a_deadline_that_has_passed_is_reported_and_not_waited_for(steady):
    assert wait_until(steady.now - 5 * MS) == 5 * MS + 1000
    assert steady.slept == 0


def test_a_sleep_ends_ahead_of_the_deadline_and_leaves_it_where_it_is(steady):
    clock, start = TickClock(2 * MS), steady.now + 5 * MS
    clock.begin(start)
    clock.sleep(150_000)
    assert start - 150_000 <= steady.now <= start - 150_000 + steady.oversleep + 2000
    clock.sleep(1 * MS)  # already nearer than that
    assert steady.slept == 1
    late = clock.wait()
    assert steady.now == start + late
    assert clock.skipped == 0


def test_deadlines_do_not_drift(steady):
    clock, start = TickClock(2 * MS), steady.now + 5 * MS
    clock.begin(start)
    for k in range(100):
        late = clock.wait()
        assert 0 <= late <= 1000
        assert steady.now == start + 2 * MS * k + late
        steady.now += 700_000  # work of the tick
    assert clock.skipped == 0


@pytest.mark.parametrize(("work", "skipped"), [(1.99, 0), (3.5, 0), (4.0, 1), (15.1, 6)])
def test_whole_periods_lost_are_counted_and_later_ones_are_not_shortened(steady, work, skipped):
    clock, start = TickClock(2 * MS), steady.now + 1 * MS
    clock.begin(start)
    clock.wait()
    steady.now = start + round(work * MS)
    late = clock.wait()
    assert late == pytest.approx(max(0.0, work - 2) * MS, abs=1001)
    assert clock.skipped == skipped
    first = steady.now - late
    clock.wait()
    second = steady.now
    assert (second - start) // (2 * MS) == 2 + skipped, "the schedule stays on the grid of the periods"
    assert second - first >= 2 * MS * (1 + skipped)


def test_periods_given_up_leave_the_grid_where_it_is(steady):
    clock, start = TickClock(2 * MS), steady.now + 1 * MS
    clock.begin(start)
    clock.wait()
    assert clock.present() == 0
    steady.now = start + 9 * MS  # period 4 is under way; the deadline of period 1 was next
    assert clock.present() == 4
    clock.resume_at(5)
    assert clock.skipped == 4
    assert 0 <= clock.wait() <= 1000
    assert start + 10 * MS <= steady.now <= start + 10 * MS + 2000
    assert clock.present() == 5
