"""The telescope in four processes has the bytes of one process: cameras, devices, ramps, members, other mirrors."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.bags.cdr import codec_for
from los_testbed.config.members import random_member
from los_testbed.config.topics import image_topic
from los_testbed.nodes.support.transport.raw_topics import MESSAGES
from los_testbed.run.processes.node_launch import environment, node_command
from los_testbed.run.runner import Runner
from rclpy.serialization import deserialize_message
from ros_runs import config_for, lockstep_and_alone, private_domain

from pointing_analysis.read.messages.message_types import IMAGE
from pointing_analysis.read.run import Run


def user_file(folder: Path, text: str) -> str:
    """A parameter file with this text."""
    (folder / "user.toml").write_text('base = "reference"\n' + text, "utf-8")
    return str(folder / "user.toml")


@pytest.mark.further
def test_ros_reads_an_image_as_it_was_written() -> None:
    topic, pixels = image_topic(15), np.arange(225.0)
    data = bytes(codec_for(topic).encode(1_002_000_000, pixels))
    message = deserialize_message(data, MESSAGES[IMAGE])
    assert (message.height, message.width, message.step) == (15, 15, 30)
    assert (message.encoding, message.is_bigendian, message.header.frame_id) == ("mono16", 0, "guide_camera")
    assert np.array_equal(np.frombuffer(bytes(message.data), "<u2"), pixels)
    assert len(data) % 4 == 0  # the middleware would fill it up, and the bag would differ from one without it
    many = codec_for(topic).encode_many(np.array([1_002_000_000]), pixels[None])
    assert many[0].tobytes() == data


@pytest.mark.further
def test_images_have_the_bytes_of_one_process(tmp_path: Path) -> None:
    image = user_file(tmp_path, '[sensors]\ncamera = "image"\n')
    config = config_for(tmp_path, mode="lockstep", duration=0.5, start="steady", seed=5, parameters=image)
    hashes, *runs = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/camera/image"][0] == 25
    counts = [run.parameters["statistics"]["plant"] for run in runs]
    ours, theirs = ({key: c[key] for key in c if key.startswith("frames")} for c in counts)
    assert ours == theirs and ours["frames"] == "25" and ours["frames_before_start"] == "2"


THROUGH_REST: dict[str, Any] = {
    "wheel_speed": [1.0, -397.0, 60.0, -100.0],
    "wheel_acceleration": [-8.0, -16.0, 40.0, 0.0],
    "theta": 0.3,
    "theta_rate": 0.2,
    "ramp_duration": 0.3,
}
"""A wheel through rest, one across the mode near 400 rad/s, the arrays turning; constant in the end."""

TABLE = """time,theta,wheel_speed_1,wheel_speed_2,wheel_speed_3,wheel_speed_4
0,0.1,300,-300,80,-80
0.1,0.1,302,-310,60,-80
0.3,0.2,302,-330,-20,-79
"""


@pytest.mark.parametrize(
    "profile",
    ["trapezoidal", pytest.param("linear", marks=pytest.mark.slow), pytest.param("file", marks=pytest.mark.slow)],
)
def test_a_ramp_in_lockstep_has_the_bytes_of_the_ramp_in_one_process(profile: str, tmp_path: Path) -> None:
    moves = {**THROUGH_REST, "profile": profile}
    if profile == "file":
        (tmp_path / "profile.csv").write_text(TABLE, "utf-8")
        moves = {"profile": str(tmp_path / "profile.csv")}
    config = config_for(tmp_path, mode="lockstep", scenario="ramp", duration=0.4, start="steady", seed=5, **moves)
    hashes, ours, theirs = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/truth/los"][0] == 400 and ours.parameters["motion"] == theirs.parameters["motion"]


EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_placed_devices_have_the_bytes_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    config = config_for(
        tmp_path,
        mode="lockstep",
        duration=0.3,
        seed=5,
        loop="fsm+pma",
        parameters=str(EXAMPLES / "spacecraft/damper_at_an_array.toml"),
        k_pma="classes_for_a_run:DampedRoot",
    )
    hashes, *_ = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/actuator/damper/command"][0] == hashes["/telescope/sensor/root"][0] == 300


def started(folder: Path, name: str, *parameters: str) -> subprocess.CompletedProcess[str]:
    """A node with these parameters, which it refuses."""
    given = [word for parameter in parameters for word in ("-p", parameter)]
    variables = {k: v for k, v in environment(private_domain(), folder).items() if k != "LOS_TESTBED_EVENTS"}
    command = [*node_command(name), "--ros-args", *given]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, env={**os.environ, **variables})


def test_a_node_outside_the_family_says_so_and_ends(tmp_path: Path) -> None:
    """Other values that are refused: unit/los_testbed/cli/test_plant_command.py."""
    done = started(tmp_path, "plant", "wheel_speed:=[0.0, 0.0, -2000.0, 0.0]")
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2, done.stderr
    assert all(word in last for word in ("wheel_speed (wheel 3)", "-1047.2 and 1047.2", "-2000")), last


@pytest.mark.slow
def test_a_random_member_in_lockstep_is_the_one_in_one_process(tmp_path: Path) -> None:
    """Same bytes on every topic: the parameters reach the node whole."""
    lockstep_and_alone(
        config_for(tmp_path, mode="lockstep", duration=0.5, start="steady", **random_member(5)), tmp_path
    )


@pytest.mark.further
@pytest.mark.parametrize("name", [pytest.param("estimator", marks=pytest.mark.slow), "controller"])
def test_a_node_refuses_a_controller_for_another_mirror(name: str, tmp_path: Path) -> None:
    user = user_file(tmp_path, "[fsm]\nlos_sensitivity = 0.2\n")
    done = started(tmp_path, name, f"parameters:={user}", "priority:=false")
    assert done.returncode == 2
    assert f"los_testbed {name}: K_FSM, implemented: fsm.los_sensitivity of its design must be 0.2, got 0.1" in (
        done.stderr
    )


@pytest.mark.further
def test_a_telescope_with_less_authority_is_run_with_its_own(tmp_path: Path) -> None:
    """Gates and laws have the limit of the telescope; the warning is in the results and in the bag, once each."""
    user = user_file(tmp_path, "[fsm]\nauthority = 1e-5\n")
    config = replace(
        config_for(tmp_path), parameters=user, k_fsm="", k_pma="", mode="lockstep", duration=1.2, loop="fsm"
    )
    results = Runner(config).run()
    (warning,) = [line for line in results.warnings if "was designed for" in line]
    assert "fsm_authority 0.0053" in warning and "fsm_authority 1e-05" in warning
    assert results.bag is not None
    run = Run.open(results.bag)
    assert run.parameters["controller_warnings"] == warning
    assert abs(run["fsm/command"].values).max() == 1e-5
    assert not any(int(n) for key, n in results.statistics["plant"].items() if key.startswith("rejected_fsm"))
