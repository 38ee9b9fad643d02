"""A node without a launch file: it starts, says what it is, and ends when it is asked to."""

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")

from los_testbed.run.processes.domains import free_domain


@pytest.fixture(scope="module", autouse=True)
def domain():
    """A domain in which no other node of this machine is."""
    with free_domain("/test_node") as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield


def start(*arguments):
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    variables["LOS_TESTBED_EVENTS"] = str(os.getpid())
    command = [sys.executable, "-m", "los_testbed.nodes.controller", "--ros-args", *arguments]
    return subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_controller_starts_and_ends():
    node = start()
    try:
        assert '"event": "ready"' in iter(node.stdout.readline, "").__next__()
        node.send_signal(signal.SIGINT)
        out, errors = node.communicate(timeout=60)
    finally:
        node.kill()
    assert node.returncode == 0, errors
    assert '"event": "done"' in out


def test_a_mistake_is_one_line_and_exit_code_2():
    node = start("-p", "durtion:=3.0")
    _, errors = node.communicate(timeout=60)
    assert node.returncode == 2
    assert "did you mean duration" in errors.splitlines()[-1]
