"""Settings of the middleware: ours where the user has none, and never shared memory."""

import re
from xml.etree import ElementTree

import pytest
from los_testbed.nodes.support.transport.middleware import LOCALHOST_PROFILE, NETWORK_PROFILE, choose_middleware

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
