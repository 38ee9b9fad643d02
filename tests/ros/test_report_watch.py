"""Deadline and liveliness of the nodes' reports: a node that hangs is counted, one that reports is not."""

import os
import signal
import time
from typing import Any

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
PAUSE_S = 5.0


def test_a_run_tells_that_a_node_hung(tmp_path):
    stopped: list[Any] = []

    def progress(ticks):
        if ticks > 1500 and not stopped:
            stopped.append(runner.processes["estimator"])
            os.kill(stopped[0], signal.SIGSTOP)
            time.sleep(PAUSE_S)
            os.kill(stopped[0], signal.SIGCONT)

    runner = Runner(config_for(tmp_path, duration=9.0), progress, {"plant": PLANT})
    results = runner.run()
    (line,) = [text for text in results.warnings if text.startswith("estimator: ")]
    assert "reports missed their deadline of 3 s" in line
    assert int(results.statistics["recorder"]["late_reports_estimator"]) >= 1
    assert int(results.statistics["recorder"]["liveliness_lost_estimator"]) >= 1
    assert "late_reports_estimator" in Run.open(results.bag).parameters["statistics"]["recorder"]
