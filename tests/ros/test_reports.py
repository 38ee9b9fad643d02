"""Reports of the nodes: read as they are written, damaged, lost, of second publishers, late where a node hangs."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from los_testbed.bags.cdr import CodecError
from los_testbed.bags.diagnostics import HARDWARE, Status, read_diagnostics, write_diagnostics
from los_testbed.config.topics import NODES
from los_testbed.nodes.support.source_watch import SourceWatch
from los_testbed.run.loop.source_guard import Endpoint, SourceGuard
from los_testbed.run.runner import Runner
from rclpy.serialization import deserialize_message, serialize_message
from ros_runs import PLANT, config_for

from pointing_analysis.read.run import Run

VALUES = {"ticks": "5000", "mirror [µrad]": "", "": "empty name", "long": "x" * 1001}
TOPIC = "/telescope/truth/los"
OWN = Endpoint("01", "/telescope/plant")


def report(count=2):
    values = [KeyValue(key=key, value=value) for key, value in VALUES.items()]
    array = DiagnosticArray()
    array.header.frame_id = "0a1b"
    array.status = [DiagnosticStatus(name=f"telescope: {i}", message="m" * i, values=values) for i in range(count)]
    return serialize_message(array)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_reports_are_read_as_the_middleware_writes_them(count):
    frame, found = read_diagnostics(report(count))
    assert frame == "0a1b"
    assert [(status.name, status.values) for status in found] == [(f"telescope: {i}", VALUES) for i in range(count)]


@pytest.mark.parametrize("name", ["", "a", "abcd", "µ"])
def test_reports_of_the_nodes_are_read_by_the_middleware(name):
    stamp = 1_234_567_890_123_456_789
    data = write_diagnostics(stamp, name, Status(2, f"telescope: {name}", name * 3, {**VALUES, name: name * 7}))
    array = deserialize_message(data, DiagnosticArray)
    assert array.header.stamp.sec * 10**9 + array.header.stamp.nanosec == stamp and array.header.frame_id == name
    (status,) = array.status
    assert (status.level, status.name, status.message) == (b"\2", f"telescope: {name}", name * 3)
    assert status.hardware_id == HARDWARE
    assert {pair.key: pair.value for pair in status.values} == {**VALUES, name: name * 7}
    assert deserialize_message(serialize_message(array), DiagnosticArray) == array


def test_any_bytes_are_read_or_refused():
    chance, whole = random.Random(1), bytearray(report())
    refused = 0
    for _ in range(3000):
        damaged = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        try:
            read_diagnostics(bytes(damaged))
        except CodecError:
            refused += 1
    assert refused > 300


class Graph:
    """Node and subscription at once, with the publishers that a test gives it."""

    def __init__(self, *endpoints):
        self.name, self.seen = TOPIC, list(endpoints)
        self.guard = SourceGuard("/telescope/plant", node="/telescope/plant")

    def count_publishers(self, name):
        return len(self.seen)

    def endpoints(self):
        return self.seen

    def decide(self, now_ns):
        return None


def test_a_restarted_plant_is_no_second_publisher_and_interleaved_messages_of_its_name_are():
    graph: Any = Graph(OWN, Endpoint("04", "/telescope/plant"))
    watch = SourceWatch(graph, [graph])
    assert watch.look(0) == []
    for gid in (b"\1", b"\4", b"\1"):
        graph.guard.sort(gid, 0, b"")
        graph.guard.decide([OWN], 0)
    assert watch.look(0) == [(TOPIC, "of the same name")]


LOSES_REPORTS = """
import sys
from los_testbed.nodes import recorder
from los_testbed.nodes.support.track import ReportTrack
ReportTrack.drain = lambda self: 0
sys.exit(recorder.main())
"""


@pytest.mark.parametrize("mode", ["realtime", pytest.param("lockstep", marks=pytest.mark.slow)])
def test_the_bag_has_the_last_statistics_of_nodes_whose_reports_were_lost(tmp_path, mode):
    """As where the processor is taken away for seconds."""
    commands = {"plant": PLANT, "recorder": [sys.executable, "-c", LOSES_REPORTS]}
    results = Runner(config_for(tmp_path, duration=0.5, mode=mode), commands=commands).run()
    kept = Run.open(results.bag).parameters["statistics"]
    for name in NODES[:-1]:
        counts = {key: value for key, value in results.statistics[name].items() if key in kept[name]}
        assert counts and counts.items() <= kept[name].items()
    assert kept["plant"]["ticks"] == "500"
    assert kept["plant"]["missed_ticks"] == results.statistics["plant"]["missed_ticks"]


@pytest.mark.further
def test_a_run_tells_that_a_node_hung(tmp_path):
    stopped: list[Any] = []

    def progress(ticks):
        if ticks > 1500 and not stopped:
            stopped.append(runner.processes["estimator"])
            os.kill(stopped[0], signal.SIGSTOP)
            time.sleep(5.0)
            os.kill(stopped[0], signal.SIGCONT)

    runner = Runner(config_for(tmp_path, duration=9.0), progress, {"plant": PLANT})
    results = runner.run()
    (line,) = [text for text in results.warnings if text.startswith("estimator: ")]
    assert "reports missed their deadline of 3 s" in line
    assert int(results.statistics["recorder"]["late_reports_estimator"]) >= 1
    assert int(results.statistics["recorder"]["liveliness_lost_estimator"]) >= 1
    assert "late_reports_estimator" in Run.open(results.bag).parameters["statistics"]["recorder"]
