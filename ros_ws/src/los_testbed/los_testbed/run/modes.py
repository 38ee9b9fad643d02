"""The mode ``auto`` of a run: real time if this machine is fast enough, else lockstep.

Before a real-time run the loop is tried (:mod:`los_testbed.nodes.support.exercise`). If more commands are late than
ticks may be missed, the run continues in lockstep, which misses none; without ROS in one process.
"""

from __future__ import annotations

import importlib.util
from dataclasses import replace

from los_testbed.config.run_config import AUTO, RunConfig
from los_testbed.run.results import Exercised

EXERCISE_S = 1.5
"""Length of the trial."""


def first_choice(config: RunConfig) -> RunConfig:
    """The run in real time, with a trial before it; in one process where ROS 2 is not installed."""
    if importlib.util.find_spec("rclpy") is None:
        return replace(config, mode="inprocess", mode_choice=f"{AUTO}: ROS 2 is not installed in this environment")
    return replace(config, mode="realtime", exercise=config.exercise or EXERCISE_S, mode_choice=AUTO)


def in_lockstep(config: RunConfig, exercised: Exercised) -> RunConfig:
    """The run in lockstep, with the reason."""
    return replace(config, mode="lockstep", exercise=0.0, mode_choice=f"{AUTO}: {late_answers(config, exercised)}")


def late_answers(config: RunConfig, exercised: Exercised) -> str:
    """Measured share of late answers, with its limit.

    Examples
    --------
    >>> late_answers(RunConfig(), Exercised(1400, 56, 3, 870.0))
    '4.0 % of 1400 ticks were answered late (limit 0.5 %)'
    """
    return f"{exercised.share:.1f} % of {exercised.ticks} ticks were answered late (limit {config.max_missed:g} %)"
