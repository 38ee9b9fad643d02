"""Raw messages against rosbags and the ROS 2 reader of the mcap package: bytes, foreign layouts, refusals."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.cdr import Codec, CodecError, codec_for, stamp_of
from los_testbed.config.topics import TOPICS
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore

from pointing_analysis.read.messages.cdr import Encoder
from pointing_analysis.read.messages.message_types import ACCEL, DEFINITIONS, HEADER, JOINT_NAMES, JOINT_STATE, VECTOR3

STORE = get_typestore(Stores.ROS2_JAZZY)
MAX_STAMP = 2**31 * 10**9 - 1
SIZES = {ACCEL: 6, VECTOR3: 2, JOINT_STATE: 6}


def serialized(type_name, stamp, frame, values, names=JOINT_NAMES, position=(), little_endian=True):
    """Message as rosbags writes it."""
    make = {name.split("/")[-1]: kind for name, kind in STORE.types.items() if name.count("/") == 2}
    header = make["Header"](make["Time"](*divmod(stamp, 10**9)), frame)
    if type_name == HEADER:
        message = header
    elif type_name == JOINT_STATE:
        position, effort = np.array(position, float), np.array(values, float)
        message = make["JointState"](header, list(names), position, np.array([]), effort)
    elif type_name == ACCEL:
        message = make["AccelStamped"](
            header, make["Accel"](make["Vector3"](*values[:3]), make["Vector3"](*values[3:]))
        )
    else:
        message = make["Vector3Stamped"](header, make["Vector3"](*values, 0.0))
    return bytes(STORE.serialize_cdr(message, type_name, little_endian=little_endian))


def read_by_mcap(type_name, data):
    """Stamp [ns], frame and numbers of a message as the mcap package's ROS 2 reader sees them."""
    schema = Schema(id=1, name=type_name, encoding="ros2msg", data=DEFINITIONS[type_name].encode())
    message = DecoderFactory().decoder_for("cdr", schema)(data)
    if type_name == ACCEL:
        linear, angular = message.accel.linear, message.accel.angular
        numbers = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    else:
        numbers = message.effort if type_name == JOINT_STATE else [message.vector.x, message.vector.y, message.vector.z]
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    return stamp, message.header.frame_id, np.array(numbers)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.name)
@given(data=st.data())
def test_the_bytes_are_those_of_rosbags_and_the_mcap_reader_gives_the_numbers(topic, data):
    values = np.array(data.draw(st.lists(st.floats(width=64), min_size=topic.size, max_size=topic.size)))
    stamp = data.draw(st.integers(0, MAX_STAMP))
    message = bytes(codec_for(topic).encode(stamp, values))
    assert message == serialized(topic.type_name, stamp, topic.frame_id, values)
    seen = read_by_mcap(topic.type_name, message)
    assert seen[:2] == (stamp, topic.frame_id)
    assert seen[2][: topic.size].tobytes() == values.tobytes()
    assert not seen[2][topic.size :].any()


@given(stamp=st.integers(0, MAX_STAMP), frame=st.text("abc/_", max_size=9))
def test_a_header_alone_has_the_bytes_of_rosbags(stamp, frame):
    message = bytes(Encoder(HEADER, 0, frame).encode(stamp))
    assert message == serialized(HEADER, stamp, frame, ())
    assert stamp_of(message) == stamp


@pytest.mark.parametrize("type_name", SIZES)
@given(stamp=st.integers(0, MAX_STAMP), frame=st.text("abc/_", max_size=9), names=st.lists(st.text("pq", max_size=5)))
def test_messages_of_rosbags_with_other_frames_and_names_are_read(type_name, stamp, frame, names):
    size = SIZES[type_name]
    values, out = np.arange(1.0, size + 1), np.zeros(size)
    message = serialized(type_name, stamp, frame, values, names=names, position=np.zeros(len(names)))
    assert Codec(type_name, size, "mine").decode(message, out) == stamp
    assert out.tolist() == values.tolist()


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.name)
def test_bulk_encoding_gives_the_bytes_of_the_single_one(topic):
    rng = np.random.default_rng(3)
    values = rng.standard_normal((50, topic.size))
    values[7] = np.nan
    stamps = 1_999_000_000 + 1_000_000 * np.arange(50)
    codec = codec_for(topic)
    bulk = codec.encode_many(stamps, values)
    for row, stamp, value in zip(bulk, stamps, values):
        assert row.tobytes() == bytes(codec.encode(int(stamp), value))


@given(data=st.binary(max_size=120))
def test_random_bytes_raise_nothing_but_a_codec_error(data):
    """What is read is a whole message: at least header, four lengths and six numbers."""
    with contextlib.suppress(CodecError):
        Codec(JOINT_STATE, 6, "pma").decode(data, np.zeros(6))
        assert len(data) >= 4 + 8 + 4 + 16 + 48


@pytest.mark.parametrize("type_name", SIZES)
def test_every_cut_is_noticed(type_name):
    codec = Codec(type_name, SIZES[type_name], "f")
    whole = bytes(codec.encode(7_000_000, np.ones(SIZES[type_name])))
    for length in range(len(whole)):
        with pytest.raises(CodecError):
            codec.decode(whole[:length], np.zeros(SIZES[type_name]))


@pytest.mark.parametrize("type_name", SIZES)
def test_big_endian_messages_are_refused_and_not_misread(type_name):
    message = serialized(type_name, 7, "fsm", np.ones(SIZES[type_name]), little_endian=False)
    with pytest.raises(CodecError, match="little-endian") as error:
        Codec(type_name, SIZES[type_name], "fsm").decode(message, np.zeros(SIZES[type_name]))
    assert error.value.reason == "encoding"
