"""The recipe for a full ROS 2 Jazzy, where Docker is missing: its instructions, shell lines and paths."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def instructions():
    """Instruction and arguments of each statement; continued lines are joined, comments left out."""
    text = (ROOT / "ros_ws" / "Dockerfile").read_text("utf-8")
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    joined = re.sub(r"\\\n", " ", lines)
    return [tuple(line.split(None, 1)) for line in joined.splitlines() if line.strip()]


def shell_lines():
    found = []
    for name, text in instructions():
        if name == "RUN":
            found.append(text)
        elif name == "CMD":
            found.append(json.loads(text)[-1])
    return found


@pytest.mark.parametrize("line", shell_lines())
def test_shell_lines_are_valid(line):
    shell = shutil.which("bash")
    assert shell is not None
    done = subprocess.run([shell, "-n", "-c", line], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_it_builds_tests_and_plays_the_reference_bag_with_the_tools_it_installs():
    text = " ".join(shell_lines())
    for part in ("colcon build", "colcon test", "colcon test-result", "ros2 bag info bags/reference"):
        assert part in text
    assert (ROOT / "bags" / "reference" / "metadata.yaml").is_file()
    readme = (ROOT / "ros_ws" / "README.md").read_text("utf-8")
    lists = re.findall(r"colcon-core [^\n]*", readme)
    assert len(lists) == 2 and all(tools in " ".join(text.split()) for tools in lists), "the recipes of the page"
    installed = set(re.findall(r"ros-jazzy-[\w-]+", text))
    assert {"ros-jazzy-rosbag2", "ros-jazzy-rosbag2-storage-mcap", "ros-jazzy-ros2launch"} <= installed
