"""Levels of a loop: rate, execution time, silence."""

import pytest
from los_testbed.run.loop.health import LoopHealth
from los_testbed.run.loop.latency_histogram import LatencyHistogram


@pytest.mark.parametrize(
    ("ticks", "mean_us", "level"),
    [(996, 100, 0), (994, 100, 1), (989, 100, 2), (1000, 1500, 1), (1000, 2500, 2), (0, 100, 3)],
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
