"""Settings of the middleware and of ROS: ours where the user has none, and one line where ROS would not start."""

import os
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from los_testbed.cli.app import main
from los_testbed.nodes.support.transport.middleware import LOCALHOST_PROFILE, NETWORK_PROFILE, choose_middleware
from los_testbed.run.processes.ros_variables import check_variables, domain_of

from pointing_analysis.command.exit_codes import ExitCode

TRANSPORT = (
    "transport_descriptors",
    "userTransports",
    "useBuiltinTransports",
    "metatrafficUnicastLocatorList",
    "initialPeersList",
)
"""Settings of the transport: the profile for this machine alone has one of its own."""


def chosen(**environment):
    choose_middleware(environment)
    return environment


@pytest.mark.parametrize(
    "environment",
    [
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"},  # unknown to ROS, which then takes LOCALHOST
        {"ROS_LOCALHOST_ONLY": "1"},
        {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},  # deprecated, which goes first
    ],
)
def test_this_machine_alone_is_made_by_a_profile_since_the_layer_would_add_shared_memory(environment):
    after = chosen(**environment)
    assert after["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(LOCALHOST_PROFILE)
    assert after["FASTDDS_DEFAULT_PROFILES_FILE"] == str(LOCALHOST_PROFILE)
    assert after["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET" and "ROS_LOCALHOST_ONLY" not in after


def test_another_middleware_keeps_its_range():
    """It does not read the profile: with the range SUBNET it would talk to the network."""
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert chosen(**environment) == environment


@pytest.mark.parametrize("variable", ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"])
def test_a_profile_of_the_user_goes_before_ours(variable):
    after = chosen(**{variable: "mine.xml", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    assert [value for name, value in after.items() if "PROFILES" in name] == ["mine.xml"]
    assert after["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_the_two_profiles_differ_only_in_where_they_look():
    def settings(profile):
        root = ElementTree.parse(profile).getroot()
        lines = {}

        def walk(element, path):
            name = re.sub("{.*}", "", element.tag)
            if name in TRANSPORT:
                return
            lines[f"{path}/{name}"] = (element.text or "").strip()
            for child in element:
                walk(child, f"{path}/{name}")

        walk(root, "")
        return lines

    assert settings(LOCALHOST_PROFILE) == settings(NETWORK_PROFILE)
    assert len(settings(NETWORK_PROFILE)) > 20


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
