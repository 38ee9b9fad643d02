"""Raw messages: round trip, bulk encoding, foreign layouts, refusals."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.cdr import Codec, CodecError, HeaderCodec, codec_for, stamp_of
from los_testbed.topics import ACCEL, JOINT_STATE, TOPICS, VECTOR3

SIZES = {ACCEL: 6, VECTOR3: 2, JOINT_STATE: 6}


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.name)
@given(data=st.data())
def test_what_is_encoded_is_decoded_bit_by_bit(topic, data):
    values = np.array(data.draw(st.lists(st.floats(width=64), min_size=topic.size, max_size=topic.size)))
    stamp = data.draw(st.integers(0, 2**31 * 10**9 - 1))
    codec, out = codec_for(topic), np.zeros(topic.size)
    assert codec.decode(bytes(codec.encode(stamp, values)), out) == stamp
    assert out.tobytes() == values.tobytes()


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


def test_encoding_uses_one_buffer_again():
    codec = Codec(VECTOR3, 2, "fsm")
    first = codec.encode(1, np.zeros(2))
    assert codec.encode(2, np.ones(2)) is first


@pytest.mark.parametrize("type_name", SIZES)
@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd", "a_rather_long_frame_name"])
def test_other_frames_are_read(type_name, frame):
    size = SIZES[type_name]
    sender, receiver, out = Codec(type_name, size, frame), Codec(type_name, size, "mine"), np.zeros(size)
    values = np.arange(1.0, size + 1)
    assert receiver.decode(bytes(sender.encode(5_000_000, values)), out) == 5_000_000
    assert out.tolist() == values.tolist()


def _joint_state(names, position, effort):
    data = bytearray(b"\x00\x01\x00\x00" + struct.pack("<iII", 1, 0, 1) + b"\x00")

    def pad(n):
        data.extend(bytes(-(len(data) - 4) % n))

    pad(4)
    data.extend(struct.pack("<I", len(names)))
    for name in names:
        pad(4)
        data.extend(struct.pack("<I", len(name) + 1) + name.encode() + b"\x00")
    for array in (position, [], effort):
        pad(4)
        data.extend(struct.pack("<I", len(array)))
        if array:
            pad(8)
            data.extend(struct.pack(f"<{len(array)}d", *array))
    return bytes(data)


def test_a_joint_state_with_names_and_positions_is_read():
    out = np.zeros(6)
    message = _joint_state([f"pma_{i}" for i in range(6)], [0.0] * 6, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    Codec(JOINT_STATE, 6, "pma").decode(message, out)
    assert out.tolist() == [1, 2, 3, 4, 5, 6]


def test_the_wrong_number_of_efforts_is_refused():
    with pytest.raises(CodecError, match="expected 6 numbers, got 5") as error:
        Codec(JOINT_STATE, 6, "pma").decode(_joint_state([], [], [0.0] * 5), np.zeros(6))
    assert error.value.reason == "size"


@given(data=st.binary(max_size=120))
def test_rubbish_never_gets_through_as_anything_but_a_codec_error(data):
    codec, reasons = Codec(JOINT_STATE, 6, "pma"), []
    with contextlib.suppress(CodecError):
        codec.decode(data, np.zeros(6))
        reasons.append("read")
    if reasons:  # then it is a whole message: at least header, four lengths and six numbers
        assert len(data) >= 4 + 8 + 4 + 16 + 48


@pytest.mark.parametrize("type_name", SIZES)
def test_every_cut_is_noticed(type_name):
    codec = Codec(type_name, SIZES[type_name], "f")
    whole = bytes(codec.encode(7_000_000, np.ones(SIZES[type_name])))
    needed = len(whole) - (8 if type_name == VECTOR3 else 0)  # z is not read
    for length in range(needed):
        with pytest.raises(CodecError):
            codec.decode(whole[:length], np.zeros(SIZES[type_name]))


def test_big_endian_messages_are_refused_and_not_misread():
    codec = Codec(VECTOR3, 2, "fsm")
    message = b"\x00\x00" + bytes(codec.encode(0, np.ones(2)))[2:]
    with pytest.raises(CodecError, match="little-endian") as error:
        codec.decode(message, np.zeros(2))
    assert error.value.reason == "encoding"


def test_a_bare_header_carries_its_stamp():
    assert stamp_of(HeaderCodec().encode(12_345_678_901)) == 12_345_678_901


def test_an_unknown_type_is_refused():
    with pytest.raises(ValueError, match="expected one of"):
        Codec("std_msgs/msg/String", 1, "")
