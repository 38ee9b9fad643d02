"""A plant in plain rclpy, with stamps of acquisition and a camera with read-out: every tick gets its command."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.processes.node_launch import node_command, parameter_file, ros_arguments
from ros_runs import config_for

pytestmark = pytest.mark.ros
PLAIN = Path(__file__).parents[1] / "support" / "plain_plant.py"
TICKS = 600


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What the plant of the user has seen."""
    folder = tmp_path_factory.mktemp("plain")
    config = config_for(folder, camera_latency=7.0, loop="fsm", priority=False)
    parameter_file(config, folder / "run.yaml")
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(config.domain)}
    nodes = [
        subprocess.Popen(
            [*node_command(name), *ros_arguments(config.namespace, folder / "run.yaml", name)], env=variables
        )
        for name in ("estimator", "controller")
    ]
    try:
        done = subprocess.run(
            [sys.executable, str(PLAIN), str(config.domain), str(TICKS)],
            capture_output=True,
            text=True,
            env=variables,
            timeout=300,
        )
    finally:
        for node in nodes:
            node.terminate()
        for node in nodes:
            node.wait(30)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_every_tick_gets_its_command(told):
    """Frames that are late and absent, and stamps beside the grid, made ticks incomplete before."""
    assert told["answered"] == TICKS
    assert told["reports"]["gap_ticks"] == "0"
    assert told["angle"] != 0.0, "the mirror follows the camera"


def test_frames_are_used_with_their_age_and_counted_by_name(told):
    """A frame is published 7 ticks late; DDS orders no topic before another, so it may be used some ticks later."""
    reports = told["reports"]
    assert 7.0 <= float(reports["frames_camera/los_age_max_ms"]) < 20.0, "used before the next frame is taken"
    assert int(reports["frames_camera/los_old"]) >= 24
    assert 2 <= int(reports["frames_camera/los_absent"]) <= 4
    assert not {"frames_camera/los_late", "frames_camera/los_off_phase", "frames_camera/los_early"} & set(reports)
    assert int(reports["off_grid_m1/accel"]) >= TICKS
