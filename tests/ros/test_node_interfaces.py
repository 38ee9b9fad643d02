"""What a ROS user meets: parameters that describe themselves, topics, diagnostics, security."""

import itertools
import os
import signal
import subprocess
import sys
import time
from typing import Any

import pytest
from bystander import middleware
from diagnostic_msgs.msg import DiagnosticArray
from los_testbed.config.run_config import RunConfig
from los_testbed.nodes.support import node_context
from los_testbed.run.loop.changes import NAMES as CHANGING
from los_testbed.run.processes.node_launch import environment, node_command
from los_testbed.run.runner import Runner
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_runs import PLANT, config_for, until

REFUSED = {"seed": 9, "use_sim_time": True, "noise": False}
"""None of them changes at the controller during a run."""
NODES = ("plant", "estimator", "controller", "recorder")


class Observer:
    """A user's node beside a run, in this process with a context of its own."""

    def __init__(self, domain):
        with middleware(ours=False):
            self.context = Context()
            self.context.init(domain_id=domain)
            self.node = Node("user", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.diagnostics = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._keep, 10)

    def _keep(self, message):
        self.diagnostics += message.status

    def call(self, kind, service, request):
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(30.0)
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, 30.0)
        return future.result()

    def spin_until(self, condition, seconds=60.0):
        """Take messages until `condition()` holds."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=0.05)

    def reports(self, name):
        """Diagnostics of one node so far."""
        return [status for status in self.diagnostics if status.name == f"telescope: {name}"]

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """One run during which a user looks at everything."""
    folder = tmp_path_factory.mktemp("interfaces")
    config = config_for(folder, duration=60.0)
    found: dict[str, Any] = {}

    def look(ticks):
        if ticks < 300 or found:
            return
        user = Observer(config.domain)
        try:
            names = list(RunConfig.SETTINGS)
            found["described"] = user.call(
                DescribeParameters, "/telescope/plant/describe_parameters", DescribeParameters.Request(names=names)
            ).descriptors
            found["values"] = user.call(
                GetParameters, "/telescope/estimator/get_parameters", GetParameters.Request(names=["loop", "duration"])
            ).values
            change = [Parameter(name, value=value).to_parameter_msg() for name, value in REFUSED.items()]
            found["set"] = user.call(
                SetParameters, "/telescope/controller/set_parameters", SetParameters.Request(parameters=change)
            ).results
            user.spin_until(lambda: all(len(user.reports(name)) >= 3 for name in NODES))
            found["diagnostics"] = list(user.diagnostics)
        finally:
            user.close()
        raise KeyboardInterrupt

    results = Runner(config, look, {"plant": PLANT}).run()
    return found, results


def test_every_parameter_is_described_with_unit_and_range(seen):
    descriptors = {d.name: d for d in seen[0]["described"]}
    assert set(descriptors) == set(RunConfig.SETTINGS)
    for name, own in RunConfig.SETTINGS.items():
        assert own.description in descriptors[name].description
        if own.unit:
            assert f"[{own.unit}]" in descriptors[name].description
        assert descriptors[name].read_only == (name not in CHANGING["plant"])
    assert descriptors["duration"].floating_point_range[0].from_value == 1e-3
    assert descriptors["seed"].integer_range[0].from_value == 0
    assert descriptors["domain"].integer_range[0].from_value == -1
    assert descriptors["domain"].description == "ROS domain; -1 for ROS_DOMAIN_ID or 0"
    assert "fsm+pma" in descriptors["loop"].additional_constraints


def test_parameters_are_answered_during_the_run_and_most_cannot_be_changed(seen):
    assert seen[0]["values"][0].string_value == "fsm+pma"
    assert seen[0]["values"][1].double_value == 60.0
    for name, result in zip(REFUSED, seen[0]["set"], strict=True):
        assert not result.successful and name in result.reason and "read-only" in result.reason


def test_diagnostics_come_once_a_second_from_each_node(seen):
    by_name: dict[str, Any] = {}
    for status in seen[0]["diagnostics"]:
        by_name.setdefault(status.name, []).append(status)
    assert set(by_name) == {f"telescope: {n}" for n in NODES}
    reports = [{entry.key: entry.value for entry in status.values} for status in by_name["telescope: plant"]]
    ticks = [int(values["ticks"]) for values in reports]
    faded = ["fade to zero" in status.message for status in by_name["telescope: plant"]]
    changes = sum(before != after for before, after in itertools.pairwise(faded))  # each is told at once
    assert ticks[0] > 300 and len(ticks) <= 2 + changes + 2 * (ticks[-1] - ticks[0]) / 1000
    assert float(reports[-1]["latency_median_us"]) > 0


def test_security_that_nodes_do_not_have_is_refused(tmp_path):
    variables = {**environment(config_for(tmp_path).domain, tmp_path), "ROS_SECURITY_ENABLE": "true"}
    done = subprocess.run(
        node_command("estimator"), env=variables, capture_output=True, text=True, timeout=600, cwd=tmp_path
    )
    assert done.returncode == 2
    assert "ROS_SECURITY_ENABLE must be unset" in done.stderr.splitlines()[-1]


def test_nodes_end_when_their_runner_is_killed(tmp_path):
    code = (
        "import os, sys; sys.path[:0] = [sys.argv[1], os.path.dirname(sys.argv[1])]; from pathlib import Path;"
        "from ros_runs import *; from los_testbed.run.runner import Runner;"
        "Runner(config_for(Path(sys.argv[2]), duration=60.0), lambda t: print(t, flush=True), {'plant': PLANT}).run()"
    )
    support = os.path.dirname(PLANT[1])
    runner = subprocess.Popen(
        [sys.executable, "-c", code, support, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    try:
        assert runner.stdout.readline()
        children = _children(runner.pid)
        assert len(children) == 4
    finally:
        runner.kill()
        runner.communicate()
    until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in children), "nodes are left")


def _children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as stream:
        return [int(word) for word in stream.read().split()]


def test_a_node_that_has_ended_is_not_killed_by_the_second_signal_of_a_launch(monkeypatch):
    """`ros2 launch` sends SIGINT to each node, and the terminal to the group: the first one decides the exit code."""

    class Context:
        code = 0

        def __init__(self, name, arguments):
            signal.signal(signal.SIGINT, lambda number, frame: None)

        def close(self):
            assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN, "the first one must be heard"

    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.getsignal(number) for number in numbers]
    monkeypatch.setattr(node_context, "NodeContext", Context)
    try:
        assert node_context.run_node("plant", [], lambda context: 0) == 0
        assert all(signal.getsignal(number) is signal.SIG_IGN for number in numbers)
    finally:
        for number, handler in zip(numbers, before):
            signal.signal(number, handler)
