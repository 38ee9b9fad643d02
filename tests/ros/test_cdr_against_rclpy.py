"""Our bytes are those of rclpy, and our schemas those of the installed message packages."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from los_testbed.bags.cdr import Codec, codec_for
from los_testbed.bags.schemas import DEFINITIONS, TYPE_HASHES
from los_testbed.config.topics import TOPICS
from los_testbed.nodes.support.transport.raw_topics import MESSAGES
from rclpy.serialization import deserialize_message, serialize_message

from pointing_analysis.read.messages.message_types import ACCEL, JOINT_NAMES, JOINT_STATE, VECTOR3

RNG = np.random.default_rng(11)


def build(type_name, stamp, frame, values):
    message = MESSAGES[type_name]()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = frame
    values = [float(v) for v in values]
    if type_name == ACCEL:
        linear, angular = message.accel.linear, message.accel.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = values
    elif type_name == VECTOR3:
        message.vector.x, message.vector.y = values
    else:
        message.name, message.effort = list(JOINT_NAMES), values
    return message


def _written(type_name, frame, length):
    """Places of a message that are no padding."""
    at = 16 + len(frame) + 1
    places = set(range(at))
    if type_name == JOINT_STATE:
        for size in (4, *(4 + len(name) + 1 for name in JOINT_NAMES), 12):
            at += -(at - 4) % 4
            places |= set(range(at, at + size))
            at += size
    return sorted(places | set(range(at + (-(at - 4)) % 8, length)))


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.name)
def test_what_we_send_is_what_rclpy_would_send(topic):
    for _ in range(20):
        values, stamp = RNG.standard_normal(topic.size), int(RNG.integers(0, 2**60))
        ours = bytes(codec_for(topic).encode(stamp, values))
        theirs = serialize_message(build(topic.type_name, stamp, topic.frame_id, values))
        # all but the padding, which serialize_message does not write
        written = _written(topic.type_name, topic.frame_id, len(ours))
        assert [theirs[i] for i in written] == [ours[i] for i in written]
        assert sum(ours[i] for i in range(len(ours)) if i not in written) == 0
        assert len(theirs) - len(ours) in (0, 8)  # serialize_message leaves 8 bytes behind a JointState
        message = deserialize_message(ours, MESSAGES[topic.type_name])
        assert message == build(topic.type_name, stamp, topic.frame_id, values)


@pytest.mark.parametrize("type_name", [ACCEL, VECTOR3, JOINT_STATE])
@pytest.mark.parametrize("frame", ["", "x", "base_link", "a/b/c"])
def test_what_rclpy_sends_is_read(type_name, frame):
    size = 2 if type_name == VECTOR3 else 6
    values, out = RNG.standard_normal(size), np.zeros(size)
    stamp = Codec(type_name, size, "mine").decode(
        serialize_message(build(type_name, 123_456_789_012, frame, values)), out
    )
    assert stamp == 123_456_789_012
    assert out.tolist() == values.tolist()


def _share(type_name):
    package, kind, name = type_name.split("/")
    for path in sys.path:
        for root in (Path(sys.prefix), Path(path).parent, Path(path).parent.parent, Path(path).parent.parent.parent):
            file = root / "share" / package / kind / f"{name}.json"
            if file.is_file():
                return file
    pytest.skip(f"the installed {package} has no share folder")


def _fields(text):
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in text.splitlines())
    return [re.sub(r"\b(\w+)/(?:msg/)?(\w+)\b", r"\2", line).replace("std_msgs/", "") for line in lines if line]


@pytest.mark.parametrize("type_name", DEFINITIONS)
def test_schemas_and_hashes_are_those_of_the_installed_messages(type_name):
    file = _share(type_name)
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(file.read_text())["type_hashes"]}
    assert TYPE_HASHES[type_name] == hashes[type_name]
    sections = re.split(r"\n={80}\nMSG: ", DEFINITIONS[type_name])
    for number, section in enumerate(sections):
        name = type_name if number == 0 else section.splitlines()[0].replace("/", "/msg/")
        body = section if number == 0 else section.split("\n", 1)[1]
        source = _share(name).with_suffix(".msg").read_text()
        assert _fields(body) == _fields(source), name
    used = {entry for entry in hashes if entry != type_name}
    assert {s.splitlines()[0].replace("/", "/msg/") for s in sections[1:]} == used
