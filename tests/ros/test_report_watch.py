"""Deadline and liveliness of the nodes' reports: a node that hangs is counted, one that reports is not."""

import os
import signal
import time
from typing import Any

import pytest

pytest.importorskip("rclpy")
from bystander import middleware
from diagnostic_msgs.msg import DiagnosticArray
from los_testbed.nodes.support.report_watch import ReportWatch, report_quality
from los_testbed.run.results import late_reports
from los_testbed.run.runner import Runner
from rclpy.context import Context
from rclpy.node import Node
from ros_runs import PLANT, config_for, private_domain

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
LIMIT_S = 1.0
PAUSE_S = 5.0


@pytest.fixture
def nodes():
    """Who reports and who watches."""
    with middleware():
        context = Context()
        context.init(domain_id=private_domain())
    made = [Node(name, namespace="/telescope", context=context) for name in ("reporting", "watching")]
    yield made
    for node in made:
        node.destroy_node()
    context.shutdown()


def until(watch, name, limit=60.0):
    """Statistics when one of them is there."""
    end = time.monotonic() + limit
    while name not in (found := watch.statistics()):
        assert time.monotonic() < end
        watch.look()
        time.sleep(0.05)
    return found


def test_a_pause_of_the_reports_is_counted(nodes):
    reporting, watching = nodes
    reports = reporting.create_publisher(DiagnosticArray, "plant/diagnostics", report_quality(10, LIMIT_S))
    watch = ReportWatch(watching, ["plant", "controller"], LIMIT_S)
    while not reports.get_subscription_count():
        time.sleep(0.02)
    watch.look()
    assert watch.statistics() == {}, "nobody has reported yet"
    reports.publish(DiagnosticArray())
    found = {**until(watch, "late_reports_plant"), **until(watch, "liveliness_lost_plant")}
    assert int(found["late_reports_plant"]) >= 1 and found["liveliness_lost_plant"] == "1"
    assert not [name for name in found if "controller" in name]
    (line,) = late_reports(found)
    assert line.startswith("plant: ") and line.endswith("its liveliness was lost 1 times")


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
