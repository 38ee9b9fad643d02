"""Packets of the reference driver: what is not one of the run is refused and counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from los_testbed.config.run_config import RunConfig
from los_testbed.rig.clock_map import ClockMap
from los_testbed.rig.driver import PacketRig, secret_of
from los_testbed.rig.emulator import key_of
from los_testbed.rig.serial import PacketSplitter
from los_testbed.rig.udp import address_of, other_machine
from los_testbed.rig.wire import Kind, Reader, encode, fits

KEY, OTHER = b"12345678", b"12345679"
VALUES = np.array([1e-6, -2e-6])


@given(st.binary(max_size=200))
@settings(max_examples=66, deadline=None)
def test_stray_packets_are_refused(data):
    reader = Reader(KEY)
    assert reader.read(data) is None
    assert sum(reader.refused.values()) == 1


@given(st.integers(0, 43), st.integers(0, 7))
@settings(max_examples=66, deadline=None)
def test_a_flipped_bit_is_found(place, bit):
    data = bytearray(encode(Kind.FRAME, 3, 5, VALUES, KEY))
    data[place] ^= 1 << bit
    assert Reader(KEY).read(bytes(data)) is None


@given(st.floats(-200, 200), st.integers(0, 400_000), st.integers(0, 2**40))
@settings(max_examples=8, deadline=None)
def test_the_clock_of_a_rig_is_known_to_half_of_the_way(drift_ppm, spread_ns, ahead):
    clocks, rng = ClockMap(), np.random.default_rng(1)
    for k in range(200):
        sent = k * 50_000_000
        there, back = (50_000 + int(rng.exponential(spread_ns + 1)) for _ in range(2))
        clocks.answer(sent, ahead + round((sent + there) * (1 + 1e-6 * drift_ppm)), sent + there + back)
    at = 9_900_000_000
    assert abs(clocks.to_host(ahead + round(at * (1 + 1e-6 * drift_ppm))) - at) < 20_000 + spread_ns / 2
    assert clocks.drift_ppm == pytest.approx(drift_ppm, abs=1 + spread_ns / 2e4)
    assert clocks.jumps == 0


def test_a_clock_that_is_set_is_learned_anew():
    clocks = ClockMap()
    for k in range(100):
        sent = k * 50_000_000
        clocks.answer(sent, sent + (1_000_000_000 if k >= 50 else 0) + 50_000, sent + 100_000)
    assert clocks.jumps == 1 and abs(clocks.to_host(6_000_000_000) - 5_000_000_000) < 2000


@given(
    st.lists(st.tuples(st.integers(0, 80), st.integers(0, 80)), min_size=2, max_size=30), st.integers(-(2**40), 2**40)
)
@settings(max_examples=16, deadline=None)
def test_answers_that_were_held_up_on_their_way_are_of_no_clock_that_was_set(held, ahead):
    """A host without a free processor holds a question or its answer for tens of milliseconds."""
    clocks = ClockMap()
    for k, (there, back) in enumerate(held):
        sent, other = k * 50_000_000, ahead + k * 50_000_000 + there * 1_000_000
        clocks.answer(sent, other, sent + (there + back) * 1_000_000)
    assert clocks.jumps == 0
    clocks.answer(10**10, ahead + 10**10 + 10**9, 10**10)
    assert clocks.jumps == 1


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True) | st.integers(0, 2**32 - 1).map(float), max_size=4))
@settings(max_examples=100, deadline=None)
def test_no_packet_that_anyone_can_send_ends_a_rig(values):
    """The key that opens a rig of this machine is zeros: the values of the packet may be anything."""
    data = encode(Kind.OPEN, 1, 5, np.array(values), bytes(8))
    key = key_of(Reader(bytes(8)).read(data))
    right = len(values) == 2 and all(0 <= value < 2**32 for value in values)
    assert (key is not None) == right and (key is None or len(key) == 8)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1e300])
def test_no_answer_about_the_clock_ends_the_host(value):
    rig = PacketRig()
    rig._line = Answers([encode(Kind.SYNC_REPLY, 1, 5, np.array([value, 3.0]), rig.key)])  # type: ignore[assignment]
    assert list(rig.read(0)) == [] and not rig.clock.known


class Answers:
    """A line on which these packets come."""

    name = "line"

    def __init__(self, packets):
        self.packets = packets

    def send(self, data):
        """Nobody is there."""

    def receive(self):
        return [(data, 7) for data in self.packets]


@given(st.lists(st.integers(-900, 900), min_size=1, max_size=40))
@settings(max_examples=66, deadline=None)
def test_the_counts_do_not_know_where_the_numbers_begin_anew(steps):
    """The same order of packets is counted alike near 2^32 and far from it; the numbers go on."""
    far, near = Reader(KEY), Reader(KEY)
    for step in [0, *steps]:
        plain = far.read(encode(Kind.FAST, 10_000 + step, 5, VALUES, KEY))
        found = near.read(encode(Kind.FAST, 2**32 - 1 + step, 5, VALUES, KEY))
        assert (plain is None) == (found is None)
    assert (far.lost, far.reordered, far.refused) == (near.lost, near.reordered, near.refused)


def test_a_rig_on_another_machine_needs_a_key(tmp_path):
    assert address_of("127.0.0.1:47800") == ("127.0.0.1", 47800)
    assert secret_of(RunConfig(), other_machine("127.0.0.1")) == bytes(8)
    with pytest.raises(ValueError, match=r"for a rig on another machine, got none for 10\.0\.0\.7"):
        secret_of(RunConfig(), other_machine("10.0.0.7"))
    (tmp_path / "key").write_text("a key of the rig, long enough")
    (tmp_path / "short").write_text("short")
    assert secret_of(RunConfig(device_key=str(tmp_path / "key")), "10.0.0.7") != bytes(8)
    with pytest.raises(ValueError, match="16 characters or more, got 5"):
        secret_of(RunConfig(device_key=str(tmp_path / "short")), "10.0.0.7")
    for path in ("/dev/zero", tmp_path, tmp_path / "none"):
        with pytest.raises(ValueError, match="device_key must be a file, got"):
            secret_of(RunConfig(device_key=str(path)), "10.0.0.7")
    with pytest.raises(ValueError, match="device_address must be HOST:PORT, got 'nonsense'"):
        address_of("nonsense")


PACKETS = [encode(Kind.FAST, k, 5, np.full(k % 7, 1.5), KEY) for k in range(20)]


def frames():
    return PacketSplitter(lambda packet: fits(packet, KEY))


@given(st.lists(st.one_of(st.integers(0, 19), st.binary(max_size=40)), max_size=30), st.integers(1, 200))
@settings(max_examples=66, deadline=None)
def test_a_stream_gives_its_packets_whatever_is_between_them(parts, size):
    """Bytes that are no packet, and packets, read in pieces of any size: every packet comes, in order, and no other."""
    sent = [PACKETS[part] for part in parts if isinstance(part, int)]
    stream = b"".join(PACKETS[part] if isinstance(part, int) else part for part in parts)
    ours, found = frames(), []
    for start in range(0, len(stream), size):
        found += ours.feed(stream[start : start + size])
    found += ours.feed(bytes(1000))  # a head that came by chance waits for at most 540 bytes
    assert found == sent


@given(st.integers(0, len(b"".join(PACKETS)) - 1), st.integers(1, 255), st.booleans())
@settings(max_examples=66, deadline=None)
def test_a_changed_or_lost_byte_costs_one_packet(place, change, lost):
    stream = bytearray(b"".join(PACKETS))
    if lost:
        del stream[place]
    else:
        stream[place] ^= change
    found = frames().feed(bytes(stream) + bytes(1000))
    assert len(found) == len(PACKETS) - 1 and all(packet in PACKETS for packet in found)


@pytest.mark.parametrize(
    ("numbers", "read", "counts"),
    [
        ([1, 2, 5, 4, 6, 6], [1, 2, 5, 4, 6, None], (1, 1, {"repeated": 1})),
        ([2**32 - 2, 2**32 - 1, 2**32, 2**32 + 1, 2**32 + 3], None, (1, 0, {})),  # more than 32 bits count
    ],
)
def test_lost_and_reordered_packets_are_counted(numbers, read, counts):
    reader = Reader(KEY)
    found = [reader.read(encode(Kind.FAST, n, 5, VALUES, KEY)) for n in numbers]
    assert [packet and packet.sequence for packet in found] == (read or numbers)
    assert (reader.lost, reader.reordered, dict(reader.refused)) == counts
    assert reader.read(encode(Kind.COMMAND, 1, 5, np.zeros(8), OTHER)) is None and reader.refused["check"] == 1
