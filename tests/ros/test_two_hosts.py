"""Plant and recorder on one host, estimator and controller on another: two network namespaces and a cable."""

import contextlib
import os
import signal
import subprocess

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.runner import environment, node_command, parameter_file
from ros_runs import PLANT, config_for

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros
HOSTS = {"plant": "a", "recorder": "a", "estimator": "b", "controller": "b"}


def sh(*command):
    subprocess.run(command, check=True, capture_output=True, text=True)


@pytest.fixture
def hosts():
    """Two namespaces joined by a veth pair; names are this process's own."""
    names = {host: f"los{os.getpid() % 100000}{host}" for host in "ab"}
    try:
        for name in names.values():
            sh("ip", "netns", "add", name)
        sh(
            "ip",
            "link",
            "add",
            names["a"],
            "netns",
            names["a"],
            "type",
            "veth",
            "peer",
            names["b"],
            "netns",
            names["b"],
        )
        for number, name in enumerate(names.values(), start=1):
            sh("ip", "-n", name, "addr", "add", f"10.99.0.{number}/24", "dev", name)
            sh("ip", "-n", name, "link", "set", name, "up")
            sh("ip", "-n", name, "link", "set", "lo", "up")
            sh("ip", "-n", name, "route", "add", "224.0.0.0/4", "dev", name)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        _remove(names)
        pytest.skip(f"network namespaces are not permitted here: {getattr(error, 'stderr', error)}")
    yield names
    _remove(names)


def _remove(names):
    for name in names.values():
        with contextlib.suppress(FileNotFoundError):
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@pytest.mark.parametrize("impairment", [None, ("delay", "0.2ms", "loss", "0.1%")], ids=["clean", "delay and loss"])
def test_a_loop_over_two_hosts(hosts, tmp_path, impairment):
    if impairment:
        done = subprocess.run(
            ["ip", "netns", "exec", hosts["a"], "tc", "qdisc", "add", "dev", hosts["a"], "root", "netem", *impairment],
            capture_output=True,
            text=True,
        )
        if done.returncode:
            pytest.skip(f"this kernel cannot delay packets: {done.stderr.strip()}")
    config = config_for(tmp_path, duration=4.0)
    parameters = tmp_path / "run.yaml"
    parameter_file(config, parameters)
    variables = environment(config, tmp_path)
    variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    processes = {}
    try:
        for name, host in HOSTS.items():
            command = PLANT if name == "plant" else node_command(name)
            processes[name] = subprocess.Popen(
                ["ip", "netns", "exec", hosts[host], *command, "--ros-args", "--params-file", str(parameters)],
                env=variables,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
            )
        assert processes["plant"].wait(60) == 0, processes["plant"].stderr.read()
        for name in ("estimator", "controller", "recorder"):
            processes[name].send_signal(signal.SIGINT)
            assert processes[name].wait(20) == 0, processes[name].stderr.read()
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()
    run = Run.open(tmp_path / "bag")
    assert len(run["truth/los"]) == len(run["m1/accel"]) == 4000
    statistics = run.parameters["statistics"]["plant"]
    assert float(statistics["latency_median_us"]) > (200 if impairment else 0)
    commands = run["fsm/command"]
    if impairment:  # a lost packet is sent again: late, and then perhaps not used
        assert len(commands) > 3900
    else:
        assert len(commands) == 4000
        assert commands.integrity.missing == 0
    assert np.isfinite(commands.values).all()
