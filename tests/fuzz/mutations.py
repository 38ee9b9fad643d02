"""Mutations of MCAP files at the level of bytes and of records, and what other readers get of the result."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from pointing_analysis.read.mcap.framing import Framing
from pointing_analysis.read.mcap.records import MAGIC, OP_MANIFEST, RECORD

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message's record."""

Key = tuple[str, int]
Content = tuple[int, int, bytes]
Found = tuple[Key, Content]


@dataclass(frozen=True)
class Mutation:
    """One change: its kind, a place and another one (shares of the file, or of its records), a length, bytes."""

    kind: str
    place: float
    other: float
    length: int
    data: bytes

    def __call__(self, good: bytes) -> bytes:
        """The changed file."""
        return KINDS[self.kind](good, self)


def records(data: bytes) -> list[tuple[int, int]]:
    """Begin and end of each record of a whole file."""
    frames = Framing(io.BytesIO(data), len(data), {}).frames(len(MAGIC))
    return [(frame.at, frame.end) for frame in frames if frame.whole and frame.op]


def _at(good: bytes, share: float) -> int:
    return min(int(share * len(good)), max(len(good) - 1, 0))


def _record(good: bytes, share: float) -> tuple[int, int]:
    found = records(good) or [(0, len(good))]
    return found[min(int(share * len(found)), len(found) - 1)]


def _flip(good: bytes, m: Mutation) -> bytes:
    data, at = bytearray(good), _at(good, m.place)
    if data:
        data[at] ^= 1 << (m.length % 8)
    return bytes(data)


def _flip_head(good: bytes, m: Mutation) -> bytes:
    begin, _ = _record(good, m.place)
    data, bit = bytearray(good), m.length % (8 * 60)
    if begin + bit // 8 < len(data):
        data[begin + bit // 8] ^= 1 << (bit % 8)
    return bytes(data)


def _spliced(good: bytes, m: Mutation, removed: int, data: bytes = b"") -> bytes:
    """Some bytes at the place of the mutation replaced by others."""
    at = _at(good, m.place)
    return good[:at] + data + good[at + removed :]


def _remove_record(good: bytes, m: Mutation) -> bytes:
    begin, end = _record(good, m.place)
    return good[:begin] + good[end:]


def _repeat_record(good: bytes, m: Mutation) -> bytes:
    begin, end = _record(good, m.place)
    return good[:end] + good[begin:end] + good[end:]


def _swap_records(good: bytes, m: Mutation) -> bytes:
    (a, b), (c, d) = sorted((_record(good, m.place), _record(good, m.other)))
    return good if b > c else good[:a] + good[c:d] + good[b:c] + good[a:b] + good[d:]


def _other_length(good: bytes, m: Mutation) -> bytes:
    begin, _ = _record(good, m.place)
    if begin == len(good):
        return good  # an earlier mutation has left nothing
    head = RECORD.pack(good[begin], int.from_bytes(m.data[:8].ljust(8, b"\0"), "little"))
    return good[:begin] + head + good[begin + RECORD.size :]


def _other_opcode(good: bytes, m: Mutation) -> bytes:
    begin, _ = _record(good, m.place)
    # 5 would make a message of the record: nothing tells then that nobody wrote it
    return good[:begin] + bytes([m.length % 256 if m.length % 256 != 5 else 6]) + good[begin + 1 :]


KINDS: dict[str, Callable[[bytes, Mutation], bytes]] = {
    "flip": _flip,
    "flip_head": _flip_head,
    "overwrite": lambda good, m: _spliced(good, m, len(m.data), m.data)[: len(good)],
    "insert": lambda good, m: _spliced(good, m, 0, m.data),
    "delete": lambda good, m: _spliced(good, m, m.length),
    "cut": lambda good, m: good[: _at(good, m.place)],
    "zeros": lambda good, m: _spliced(good, m, m.length, bytes(m.length))[: len(good)],
    "remove_record": _remove_record,
    "repeat_record": _repeat_record,
    "swap_records": _swap_records,
    "other_length": _other_length,
    "other_opcode": _other_opcode,
}

SHARES = st.floats(0, 1, exclude_max=True)
MUTATIONS = st.builds(
    Mutation, st.sampled_from(sorted(KINDS)), SHARES, SHARES, st.integers(1, 3000), st.binary(min_size=1, max_size=300)
)


def messages(data: bytes) -> dict[Key, Content]:
    """All messages of a whole file: topic and sequence number -> log time, publishing time, bytes."""
    found = make_reader(io.BytesIO(data)).iter_messages(log_time_order=False)
    return {(c.topic, m.sequence): (m.log_time, m.publish_time, m.data) for _, c, m in found}


def seeking(data: bytes) -> Iterator[Found]:
    """Messages that the mcap package gets by the summary."""
    # in the order of time: in that of the file this reader takes all chunks before it gives the first message
    for _, channel, m in make_reader(io.BytesIO(data)).iter_messages():
        yield (channel.topic, m.sequence), (m.log_time, m.publish_time, m.data)


def streaming(data: bytes) -> Iterator[Found]:
    """Messages that it gets from the beginning to the end."""
    topics: dict[int, str] = {}
    for record in StreamReader(io.BytesIO(data), record_size_limit=1 << 28).records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            key = topics.get(record.channel_id, ""), record.sequence
            yield key, (record.log_time, record.publish_time, record.data)


def as_far_as_it_gets(found: Iterator[Found]) -> Iterator[Found]:
    """What a reader of others gives before it fails, however it does."""
    with contextlib.suppress(Exception):
        yield from found


def others_find(data: bytes, original: dict[Key, Content]) -> tuple[set[Key], set[Key]]:
    """Messages equal to the original's that the mcap package gets: by its seeking and by its streaming reader."""
    first, second = (
        {key for key, content in as_far_as_it_gets(reader(data)) if original.get(key) == content}
        for reader in (seeking, streaming)
    )
    return first, second


def others_get(data: bytes, original: dict[Key, Content]) -> int:
    """How many messages the better of the two readers gets."""
    return max(map(len, others_find(data, original)))


def without_checksum(data: bytes, whole: bytes, keys: set[Key]) -> int:
    """How many of some messages of a whole file have no checksum in a damaged one any more: nobody can say if they are
    right where the checksum of their chunk is not, or no manifest names it."""
    count = 0
    manifests = b"".join(whole[begin:end] for begin, end in records(whole) if whole[begin] == OP_MANIFEST)
    for _, channel, m in make_reader(io.BytesIO(whole)).iter_messages(log_time_order=False):
        if (channel.topic, m.sequence) in keys:
            size = MESSAGE.size - RECORD.size + len(m.data)
            head = MESSAGE.pack(5, size, channel.id, m.sequence, m.log_time, m.publish_time)
            at = manifests.find(zlib.crc32(head + m.data).to_bytes(4, "little"))
            # with what is beside it: four bytes alone are in a file of a megabyte by chance
            count += manifests[max(at - 8, 0) : at + 4] not in data and manifests[at : at + 12] not in data
    return count
