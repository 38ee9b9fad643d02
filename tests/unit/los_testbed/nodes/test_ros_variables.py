"""Values of ROS's environment variables with which it would not start are one line, before any work."""

import os
import subprocess
import sys

import pytest
from los_testbed.cli.app import main
from los_testbed.config.exit_codes import ExitCode
from los_testbed.run.processes.ros_variables import check_variables, domain_of


@pytest.mark.parametrize("text", ["300", "-1", "abc", "٣"])
def test_a_domain_that_is_none(text):
    with pytest.raises(ValueError, match="ROS_DOMAIN_ID must be between 0 and 232, got "):
        domain_of({"ROS_DOMAIN_ID": text})


def test_a_layer_must_be_installed_where_it_is_known_what_is(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    check_variables({"RMW_IMPLEMENTATION": "rmw_any_cpp"})  # no index: not known
    index = tmp_path / "ros" / "share" / "ament_index" / "resource_index" / "rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_fastrtps_cpp", "rmw_zenoh_cpp", "rmw_implementation"):
        (index / name).touch()
    there = {"AMENT_PREFIX_PATH": f"{tmp_path}/other:{tmp_path}/ros"}
    for layer in ("rmw_fastrtps_cpp", "rmw_zenoh_cpp", ""):
        check_variables({**there, "RMW_IMPLEMENTATION": layer})
    words = "RMW_IMPLEMENTATION must be rmw_fastrtps_cpp or rmw_zenoh_cpp, which is installed, got rmw_any_cpp"
    with pytest.raises(ValueError, match=words):
        check_variables({**there, "RMW_IMPLEMENTATION": "rmw_any_cpp"})


@pytest.mark.parametrize(
    "words", [["run", "--mode=lockstep"], ["run", "--mode=realtime", "--only=plant"], ["control", "stage", "fsm"]]
)
def test_commands_end_with_one_line(words, tmp_path, monkeypatch, capsys):
    pytest.importorskip("rclpy")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == ExitCode.USER_ERROR
    assert capsys.readouterr().err == "los-testbed: ROS_DOMAIN_ID must be between 0 and 232, got 300\n"
    assert not list(tmp_path.iterdir())


def test_a_node_that_is_started_by_hand_ends_with_the_same_line():
    """rclpy would end its process where it is imported."""
    pytest.importorskip("rclpy")
    variables = {**os.environ, "RMW_IMPLEMENTATION": "rmw_other_cpp"}
    command = [sys.executable, "-m", "los_testbed.nodes.plant"]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=600)
    assert done.returncode == ExitCode.USER_ERROR
    assert done.stderr.startswith("los_testbed: RMW_IMPLEMENTATION must be ") and done.stderr.count("\n") == 1
