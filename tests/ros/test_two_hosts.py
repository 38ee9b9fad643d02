"""Plant and recorder on one host, estimator and controller on another: two network namespaces and a cable."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.runner import environment, node_command, parameter_file
from ros_runs import PLANT, config_for

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros
WIRE = str(Path(__file__).parents[1] / "support" / "bad_wire.py")
HOSTS = {"plant": "a", "recorder": "a", "estimator": "b", "controller": "b"}


def sh(*command):
    subprocess.run(command, check=True, capture_output=True, text=True)


@pytest.fixture
def hosts():
    """Two namespaces joined by a veth pair; names are this process's own."""
    names = {host: f"los{os.getpid() % 100000}{host}" for host in "ab"}
    a, b = names["a"], names["b"]
    try:
        for name in names.values():
            sh("ip", "netns", "add", name)
        sh("ip", "link", "add", a, "netns", a, "type", "veth", "peer", b, "netns", b)
        _address(names)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        _remove(names)
        pytest.skip(f"network namespaces are not permitted here: {getattr(error, 'stderr', error)}")
    try:
        yield names
    finally:
        _remove(names)


@pytest.fixture
def far_hosts():
    """The same, with a bad cable between: 0.2 ms each way, one packet in a thousand lost; and what it carried."""
    names = {host: f"los{os.getpid() % 100000}{host}" for host in "abw"}
    a, b, w = names["a"], names["b"], names["w"]
    try:
        for name in names.values():
            sh("ip", "netns", "add", name)
        for host in (a, b):
            sh("ip", "link", "add", host, "netns", host, "type", "veth", "peer", f"{host}w", "netns", w)
            sh("ip", "-n", w, "link", "set", f"{host}w", "up")
        _address({"a": a, "b": b})
        for host in (a, b):
            sh("ip", "netns", "exec", host, sys.executable, WIRE, "--whole-checksums", host)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        _remove(names)
        pytest.skip(f"network namespaces are not permitted here: {getattr(error, 'stderr', error)}")
    command = ["ip", "netns", "exec", w, sys.executable, WIRE, f"{a}w", f"{b}w", "2e-4", "1e-3", "1"]
    wire = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield names, wire
    finally:
        wire.kill()
        wire.wait()
        _remove(names)


def _address(names):
    for number, name in enumerate(names.values(), start=1):
        sh("ip", "-n", name, "addr", "add", f"10.99.0.{number}/24", "dev", name)
        sh("ip", "-n", name, "link", "set", name, "up")
        sh("ip", "-n", name, "link", "set", "lo", "up")
        sh("ip", "-n", name, "route", "add", "224.0.0.0/4", "dev", name)


def _remove(names):
    for name in names.values():
        with contextlib.suppress(FileNotFoundError):
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def fly(names, folder, seconds):
    """Plant and recorder on the first host, estimator and controller on the second; the bag and the statistics."""
    config = config_for(folder, duration=seconds)
    parameters = folder / "run.yaml"
    parameter_file(config, parameters)
    variables = environment(config, folder)
    variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    processes = {}
    try:
        for name, host in HOSTS.items():
            command = PLANT if name == "plant" else node_command(name)
            processes[name] = subprocess.Popen(
                ["ip", "netns", "exec", names[host], *command, "--ros-args", "--params-file", str(parameters)],
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
    run = Run.open(folder / "bag")
    return run, run.parameters["statistics"]


def test_a_loop_over_two_hosts(hosts, tmp_path):
    run, _ = fly(hosts, tmp_path, 4.0)
    assert len(run["truth/los"]) == len(run["m1/accel"]) == len(run["fsm/command"]) == 4000
    assert run["fsm/command"].integrity.missing == 0
    assert np.isfinite(run["fsm/command"].values).all()


def test_a_loop_over_two_hosts_with_a_bad_cable(far_hosts, tmp_path):
    """A lost sample costs its own tick and no other: nothing waits until it was sent again."""
    names, wire = far_hosts
    run, statistics = fly(names, tmp_path, 4.0)
    wire.terminate()
    carried, lost = map(int, wire.communicate()[0].split())
    assert lost == pytest.approx(1e-3 * (carried + lost), rel=0.5), "the cable is as bad as it is meant to be"
    assert lost > 10
    assert len(run["truth/los"]) == len(run["m1/accel"]) == 4000, "nothing is lost on the plant's own host"
    plant = statistics["plant"]
    assert float(plant["latency_median_us"]) > 400, "twice 0.2 ms"
    gaps = int(statistics["estimator"]["gap_ticks"])
    assert 0 < gaps <= 2 * lost
    commands = run["fsm/command"]
    assert len(commands) >= 4000 - int(statistics["controller"]["gap_ticks"]) - 5
    assert np.isfinite(commands.values).all()
