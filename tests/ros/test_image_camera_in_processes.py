"""A camera that takes images, with the telescope and four processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.bags.cdr import codec_for
from los_testbed.config.topics import image_topic
from los_testbed.nodes.support.transport.raw_topics import MESSAGES
from rclpy.serialization import deserialize_message
from ros_runs import config_for, lockstep_and_alone

from pointing_analysis.read.messages.message_types import IMAGE

pytestmark = pytest.mark.ros


def parameters(folder: Path) -> str:
    file = folder / "image.toml"
    file.write_text('[sensors]\ncamera = "image"\n', "utf-8")
    return str(file)


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


def test_lockstep_has_the_bytes_of_one_process(tmp_path: Path) -> None:
    config = config_for(
        tmp_path, mode="lockstep", duration=0.5, start="steady", seed=5, parameters=parameters(tmp_path)
    )
    hashes, *runs = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/camera/image"][0] == 25
    counts = [run.parameters["statistics"]["plant"] for run in runs]
    ours, theirs = ({key: c[key] for key in c if key.startswith("frames")} for c in counts)
    assert ours == theirs and ours["frames"] == "25" and ours["frames_before_start"] == "2"
