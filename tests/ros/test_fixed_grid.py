"""In real time the stamps stay where the steady clock has them, however long the plant got no processor."""

import os
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.bags.cdr import stamp_of
from mcap.reader import make_reader
from ros_faults import run_with_fault
from ros_runs import PLANT_TOPICS, lost_samples, span_of

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent

pytestmark = pytest.mark.ros
MS = 1_000_000
STOP_S = 0.3


@pytest.fixture(scope="module")
def stopped_twice(tmp_path_factory):
    """A run whose plant was stopped twice; the statistics and the bag."""

    def stop(runner):
        for _ in range(2):
            os.kill(runner.processes["plant"], signal.SIGSTOP)
            time.sleep(STOP_S)
            os.kill(runner.processes["plant"], signal.SIGCONT)
            time.sleep(STOP_S)

    results = run_with_fault(tmp_path_factory.mktemp("stopped"), 400, stop, duration=2.5)
    assert not results.failures
    return results, Run.open(results.bag)


def test_lost_periods_make_no_later_stamp_older(stopped_twice):
    """On the old clock the run ended 0.6 s later than its stamps say."""
    _, run = stopped_twice
    with next(run.path.glob("*.mcap")).open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=["/telescope/truth/los"])
        stamp, sent = np.array([(stamp_of(message.data), message.publish_time) for _, _, message in found]).T
    slip = np.median((sent - stamp)[-200:]) - np.median((sent - stamp)[:200])
    assert abs(slip) < STOP_S / 2 * 1e9, f"stamps slipped by {slip / MS:.1f} ms"
    assert not np.any((stamp - stamp[0]) % MS)


def test_lost_periods_are_integrated_and_counted(stopped_twice):
    results, run = stopped_twice
    plant = results.statistics["plant"]
    lost = int(plant["lost_periods"])
    assert 2 * 0.8e3 * STOP_S < lost <= int(plant["missed_ticks"])
    assert int(plant["ticks"]) == round(1000 * run.parameters["duration"])
    for name in PLANT_TOPICS:
        assert lost_samples(run, name) == len(span_of(run)) - len(run[name]), name
    assert unsent(run, "truth/los") == int(plant["unsent_ticks"]) > 0
    truth = run["truth/los"]
    t, los = (truth.stamp - truth.stamp[0]) / 1e9, truth.values
    after = t > t[-1] - 0.2
    before = t < 0.4  # the disturbance is a function of the ticks that were integrated
    phase = [np.angle(np.mean((los[w, 1] + 1j * los[w, 0]) * np.exp(-6j * np.pi * t[w]))) for w in (before, after)]
    assert abs(np.angle(np.exp(1j * (phase[1] - phase[0])))) < 0.5, "3 Hz goes through 0.3 s by 5.7 rad"
