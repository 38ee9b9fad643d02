"""The plant node as a member of the uncertain family, by ROS parameters alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.config.members import random_member
from los_testbed.run.processes.node_launch import environment
from ros_runs import config_for, lockstep_and_alone, private_domain

pytestmark = pytest.mark.ros


def start(logs: Path, *parameters: str) -> subprocess.CompletedProcess[str]:
    given = [word for p in parameters for word in ("-p", p)]
    return subprocess.run(
        [sys.executable, "-m", "los_testbed.nodes.plant", "--ros-args", *given],
        capture_output=True,
        text=True,
        timeout=600,
        env=environment(private_domain(), logs),
    )


def test_a_node_outside_the_family_says_so_and_ends(tmp_path: Path) -> None:
    """Other values that are refused: unit/los_testbed/cli/test_plant_command.py."""
    done = start(tmp_path, "wheel_speed:=[0.0, 0.0, -2000.0, 0.0]")
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2, done.stderr
    assert all(word in last for word in ("wheel_speed (wheel 3)", "-1047.2 and 1047.2", "-2000")), last


@pytest.mark.slow
def test_a_random_member_in_lockstep_is_the_one_in_one_process(tmp_path: Path) -> None:
    """Same bytes on every topic: the parameters reach the node whole."""
    lockstep_and_alone(
        config_for(tmp_path, mode="lockstep", duration=0.5, start="steady", **random_member(5)), tmp_path
    )
