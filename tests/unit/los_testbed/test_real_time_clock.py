"""Deadlines, overruns, statistics, and what happens without the rights."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from los_testbed.loop.health import LoopHealth
from los_testbed.loop.latency_histogram import LatencyHistogram
from los_testbed.loop.real_time import TickClock

MS = 1_000_000


def test_ticks_come_at_the_deadlines_and_do_not_drift():
    clock = TickClock(2 * MS)
    start = time.monotonic_ns() + 5 * MS
    clock.begin(start)
    for _ in range(100):
        late = clock.wait()
        assert late >= 0
    elapsed = time.monotonic_ns() - start
    assert elapsed >= 198 * MS
    # the last tick's time follows from the first one's, the number of ticks and the periods that were skipped
    assert elapsed - (99 + clock.skipped) * 2 * MS - late < 1 * MS


def test_an_overrun_is_counted_and_never_caught_up():
    clock = TickClock(2 * MS)
    clock.begin(time.monotonic_ns())
    clock.wait()
    before = clock.skipped
    time.sleep(0.0151)
    late = clock.wait()
    assert late >= 13 * MS
    skipped = clock.skipped - before
    assert skipped == late // (2 * MS) >= 6
    began = time.monotonic_ns()
    clock.wait()
    clock.wait()
    assert time.monotonic_ns() - began > 2 * MS, "the next ticks are not hurried"


@pytest.mark.parametrize("probability", [0.01, 0.5, 0.9, 0.99, 0.999, 1.0])
def test_quantiles_of_durations_agree_with_numpy(probability):
    values = np.random.default_rng(2).gamma(2.0, 150_000, 5000).astype(int)
    durations = LatencyHistogram()
    for value in values:
        durations.add(int(value))
    expected = np.quantile(values, probability, method="inverted_cdf") / 1000
    assert expected - 1 <= durations.quantile_us(probability) <= expected
    assert durations.maximum_us == values.max() / 1000
    assert durations.mean_us == pytest.approx(values.mean() / 1000)


def test_durations_of_any_size_are_kept_in_bounds():
    durations = LatencyHistogram()
    assert np.isnan(durations.quantile_us(0.5))
    for value in (-5_000, 0, 10**12):
        durations.add(value)
    assert durations.quantile_us(0.3) == 0
    assert durations.quantile_us(1.0) == 10**9


def test_what_is_not_permitted_is_named_and_not_an_error():
    code = (
        "import os, sys, ctypes\n"
        "from los_testbed.loop import real_time\n"
        "def refuse(*a): raise PermissionError('no')\n"
        "os.sched_setscheduler = refuse\n"
        "class NoLock:\n"
        "    def mlockall(self, flags): return -1\n"
        "ctypes.CDLL = lambda *a, **k: NoLock()\n"
        "print(real_time.become_real_time(80, 0))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "['real-time scheduling', 'locked memory']"


def test_a_window_holds_what_came_since_the_last_one():
    durations = LatencyHistogram()
    for value in (9_000_000, 1_000_000):
        durations.add(value)
    assert durations.window("x") == {"x_mean_us": 5000.0, "x_max_us": 9000.0}
    durations.add(2_000_000)
    assert durations.window("x") == {"x_mean_us": 2000.0, "x_max_us": 2000.0}
    assert durations.maximum_us == 9000.0
    assert durations.histogram() == {1000: 1, 2000: 1, 9000: 1}


def test_the_resending_thread_stands_behind_its_siblings():
    """At the same priority and place a thread that polls would keep the others of its process from running."""
    code = (
        "import os, threading, time\n"
        "from los_testbed.loop.real_time import become_real_time\n"
        "def work():\n"
        "    open('/proc/thread-self/comm', 'w').write('dds.asyn.0.0')\n"
        "    time.sleep(30)\n"
        "thread = threading.Thread(target=work, daemon=True); thread.start(); time.sleep(0.2)\n"
        "refused = become_real_time(70)\n"
        "print(refused, os.sched_getparam(0).sched_priority, os.sched_getparam(thread.native_id).sched_priority)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    if "real-time scheduling" in done.stdout:
        pytest.skip("real time is not permitted here")
    assert done.stdout.split("]")[1].split() == ["70", "69"]


@pytest.mark.parametrize(
    ("ticks", "mean_us", "level"),
    [
        (1000, 100, 0),
        (996, 100, 0),
        (994, 100, 1),
        (1006, 100, 1),
        (989, 100, 2),
        (1000, 1500, 1),
        (1000, 2500, 2),
        (0, 100, 3),
    ],
)
def test_levels_have_the_limits_of_ros2_control(ticks, mean_us, level):
    health, execution = LoopHealth(), LatencyHistogram()
    health.assess(5, 0, execution)
    execution.add(mean_us * 1000)
    assert health.assess(5 + ticks, 10**9, execution)[0] == level


def test_in_lockstep_the_rate_is_no_fault():
    health, execution = LoopHealth(paced=False), LatencyHistogram()
    health.assess(0, 0, execution)
    assert health.assess(5000, 10**9, execution)[0] == 0


def test_a_real_time_process_that_never_pauses_is_ended_by_the_kernel():
    """Nobody of lower priority on its processor could end it."""
    script = (
        "import sys; from los_testbed.loop.real_time import become_real_time; refused = become_real_time(1)\n"
        "if 'real-time scheduling' in refused: sys.exit(77)\n"
        "while True: pass"
    )
    runaway = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=60)
    if runaway.returncode == 77:
        pytest.skip("real-time scheduling is not permitted here")
    assert runaway.returncode == -signal.SIGXCPU
