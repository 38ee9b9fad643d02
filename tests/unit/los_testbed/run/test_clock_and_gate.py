"""Clock, durations, health and the gate for commands of the loop, on a simulated steady clock."""

import numpy as np
import pytest
from los_testbed.bags.cdr import Codec
from los_testbed.run.loop import tick_clock
from los_testbed.run.loop.command_gate import CommandGate
from los_testbed.run.loop.health import LoopHealth
from los_testbed.run.loop.latency_histogram import LatencyHistogram
from los_testbed.run.loop.tick_clock import TickClock, wait_until

from pointing_analysis.read.messages.message_types import VECTOR3

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


def test_quantiles_of_durations_agree_with_numpy():
    values = np.random.default_rng(2).gamma(2.0, 150_000, 5000).astype(int)
    durations, probabilities = LatencyHistogram(), (0.01, 0.5, 0.9, 0.99, 0.999, 1.0)
    for value in values:
        durations.add(int(value))
    expected = np.quantile(values, probabilities, method="inverted_cdf") / 1000
    found = np.array(durations.quantiles_us(probabilities))
    assert np.all((expected - 1 <= found) & (found <= expected))
    assert durations.maximum_us == values.max() / 1000
    assert durations.mean_us == pytest.approx(values.mean() / 1000)


def test_durations_of_any_size_are_kept_in_bounds():
    durations = LatencyHistogram()
    assert np.isnan(durations.quantiles_us((0.5,))[0])
    for value in (-5_000, 0, 10**12):
        durations.add(value)
    assert list(durations.quantiles_us((0.3, 1.0))) == [0, 10**9]


def test_a_window_holds_what_came_since_the_last_one():
    durations = LatencyHistogram()
    for values, mean, largest in (((9_000_000, 1_000_000), 5000.0, 9000.0), ((2_000_000,), 2000.0, 2000.0)):
        for value in values:
            durations.add(value)
        assert durations.window("x") == {"x_mean_us": mean, "x_max_us": largest}
    assert durations.maximum_us == 9000.0 and durations.histogram() == {1000: 1, 2000: 1, 9000: 1}


@pytest.mark.parametrize(
    ("ticks", "mean_us", "paced", "level"),
    [
        (996, 100, True, 0),
        (994, 100, True, 1),
        (989, 100, True, 2),
        (1000, 1500, True, 1),
        (1000, 2500, True, 2),
        (0, 100, True, 3),
        (5000, 100, False, 0),
    ],
)
def test_levels_have_the_limits_of_ros2_control(ticks, mean_us, paced, level):
    """In lockstep the rate is no fault."""
    health, execution = LoopHealth(paced=paced), LatencyHistogram()
    health.assess(5, 0, execution)
    execution.add(mean_us * 1000)
    assert health.assess(5 + ticks, 10**9, execution)[0] == level


LIMIT = 5.3e-3

START = 1_000 * MS


@pytest.fixture
def gate():
    gate = CommandGate(Codec(VECTOR3, 2, "fsm"), LIMIT, hold_ticks=5, fade_ticks=20)
    gate.begin(START)
    return gate


def message(stamp, x=1e-3, y=-2e-3):
    return bytes(Codec(VECTOR3, 2, "fsm").encode(stamp, np.array([x, y])))


def output(gate, now):
    out = np.zeros(2)
    gate.apply(now, out)
    return out


def test_the_command_of_the_tick_before_passes_unchanged(gate):
    assert gate.fresh(START) and output(gate, START).tolist() == [0, 0], "nothing is missed before the first command"
    assert gate.offer(message(START), START + MS) and gate.fresh(START + MS)
    assert output(gate, START + MS).tolist() == [1e-3, -2e-3]
    assert not gate.rejected


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (message(START, np.nan), "not_finite"),
        (message(START, np.inf), "not_finite"),
        (message(START, -np.inf), "not_finite"),
        (message(START - 2 * MS, np.nan), "not_finite"),  # values are judged before stamps
        (message(START + 50 * MS, 10 * LIMIT), "limit"),
        (message(START + 1, np.nan), "not_finite"),
        (message(START, 10 * LIMIT), "limit"),
        (message(START, 0.0, -1.0001 * LIMIT), "limit"),
        (message(START + 1), "off_grid"),
        (message(START + MS), "future"),
        (message(START + 50 * MS), "future"),
        (message(START - MS), "duplicate"),
        (message(START - 2 * MS), "late"),
        (message(0), "late"),
        (message(START)[:30], "size"),
        (b"", "encoding"),
        (b"\x00\x00" + message(START)[2:], "encoding"),
    ],
)
def test_an_invalid_command_is_counted_by_reason_and_changes_nothing(gate, data, reason):
    now = START + MS
    assert not gate.offer(data, now)
    assert dict(gate.rejected) == {reason: 1}
    assert not gate.fresh(now)
    assert output(gate, now).tolist() == [0, 0]


def test_a_late_command_is_used_within_the_hold_time_and_is_not_fresh(gate):
    assert gate.offer(message(START), START + 3 * MS) and not gate.fresh(START + 3 * MS)
    assert output(gate, START + 3 * MS)[0] == 1e-3
    assert not gate.offer(message(START + MS), START + 8 * MS) and gate.rejected == {"late": 1}


def test_silence_is_held_then_faded_smoothly_to_zero_and_back(gate):
    gate.offer(message(START), START + MS)
    held = [output(gate, START + k * MS)[0] for k in range(1, 7)]
    assert held == [1e-3] * 6  # fresh, then five ticks of holding
    fading = np.array([output(gate, START + k * MS)[0] for k in range(7, 40)])
    assert gate.fading
    assert np.all(np.diff(fading) <= 0)
    assert fading[-1] == 0
    # raised cosine over 20 ticks: no step larger than pi / 2 / 20 of the command
    steps = np.abs(np.diff(np.concatenate([[1e-3], fading])))
    assert steps.max() <= 1e-3 * np.pi / 40 * 1.001
    back = []
    for k in range(40, 70):
        assert gate.offer(message(START + (k - 1) * MS), START + k * MS)
        back.append(output(gate, START + k * MS)[0])
    assert back[-1] == 1e-3
    assert not gate.fading
    assert np.abs(np.diff([0.0, *back])).max() <= 1e-3 * np.pi / 40 * 1.001
