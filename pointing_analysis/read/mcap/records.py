"""Records of an MCAP file: their layout, and what is read from those that are no messages.

The file format is simple (https://mcap.dev/spec): a magic number, then records ``opcode (1 byte), length (8 bytes),
content``. Messages are in compressed chunks, each followed by message-index records that say where in the
chunk each channel's messages begin. `framing` finds the records, `chunks` unpacks and verifies chunks,
`walk` puts them together.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lftkit.errors import InputError
from pointing_analysis.arrays import IntArray

MAGIC = b"\x89MCAP0\r\n"
OP_HEADER, OP_FOOTER, OP_SCHEMA, OP_CHANNEL, OP_MESSAGE, OP_CHUNK, OP_INDEX = 1, 2, 3, 4, 5, 6, 7
OP_CHUNK_INDEX, OP_ATTACHMENT, OP_ATTACHMENT_INDEX, OP_STATISTICS = 8, 9, 10, 11
OP_METADATA, OP_METADATA_INDEX, OP_SUMMARY_OFFSET, OP_DATA_END = 12, 13, 14, 15
OP_MANIFEST, OP_DIGEST = 0x81, 0x82  # of the range that the format leaves to applications; `manifest`, `file_digest`
RECORD = struct.Struct("<BQ")
# A message record as it lies in the chunk; the payload follows.
MESSAGE_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
HEAD = MESSAGE_HEAD.itemsize  # 31
BODY = HEAD - RECORD.size  # 22: part of the length that is not payload
MAX_CHUNK = 64_000_000
"""Largest chunk and largest other record that are read [byte]; declared sizes are compared with it before anything is
allocated."""
_CONVERT = "to convert it: pip install rosbags; rosbags-convert --src BAG --dst NEW --dst-storage mcap"
SQLITE = f"sqlite3; {_CONVERT}"
OTHER_FORMATS = {b"SQLite f": SQLITE, b"#ROSBAG ": f"a bag of ROS 1; {_CONVERT}"}
"""Formats of other files, by their first eight bytes."""
MAX_NOTES = 10_000
"""Largest number of damaged places listed individually."""


class BagError(InputError):
    """The file is not a readable bag; the message has the requirement and the value."""


class ShortRunError(BagError):
    """The recording is whole and shorter than what can be evaluated."""


class RefutedBagError(BagError):
    """The valid part of the bag is not sufficient, as its own digests refute the rest."""

    code = 5  # exit code of the command line


@dataclass(frozen=True)
class Channel:
    """One topic in one file.

    Attributes
    ----------
    id : its number in the file
    topic : its name
    schema : message type
    encoding : of the messages, ``cdr`` in ROS 2
    definition : text of the message type; empty if the file does not have it
    metadata : further strings
    definition_encoding : language of the definition, ``ros2msg``
    """

    id: int
    topic: str
    schema: str
    encoding: str
    definition: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()
    definition_encoding: str = "ros2msg"


@dataclass(frozen=True)
class Attachment:
    """A file in the file."""

    media_type: str
    data: bytes


@dataclass(frozen=True)
class Expected:
    """Messages of a channel as manifests name them: last sequence number, first and last log time [ns]."""

    last_sequence: int
    first: int
    last: int


@dataclass
class FileInfo:
    """Records of a file besides messages; it grows while the file is read.

    Attributes
    ----------
    channels : by number
    schemas : by number: name, language and text of the definition of a message type
    metadata : the metadata records of each name, in the order of the file
    attachments : by name
    problems : defects, one sentence each
    damage : offset [byte] and description of each damaged place; those that lost nothing as well
    contradictions : records with a valid checksum that contradict the file's digests; in `problems` as well
    lost_chunks : of unreadable chunks, by channel: log times [ns] of the messages that their index lists
    expected : by channel, what the manifests of the chunks say
    manifests : whole ones
    stated : digest of the file at its end; empty without one
    agrees : whether it is that of the file; None where they were not compared
    digests : chunks whose content was compared with the digest in their manifest, and agrees
    chunks : chunks that were unpacked
    unproved : used messages without a checksum where the file is truncated
    unchecked : messages for which the file has no checksum but perhaps that of all its data
    data_checksum : whether the checksum of all data agrees; None without one
    statistics : messages of each channel as the summary counts them; None without a whole summary
    message_count : all messages as the summary counts them; None likewise
    finished : whether the file has the end of its data
    compares : whether to compare the digest of the whole file
    max_chunk : largest chunk that is unpacked [byte]
    unpacks : whether to unpack a chunk, by the times [ns] of its first and last message
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    metadata: dict[str, list[dict[str, str]]] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    damage: list[tuple[int, str]] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)
    lost_chunks: list[dict[int, IntArray]] = field(default_factory=list)
    expected: dict[int, Expected] = field(default_factory=dict)
    manifests: int = 0
    stated: bytes = b""
    agrees: bool | None = None
    digests: int = 0
    chunks: int = 0
    unproved: int = 0
    unchecked: int = 0
    data_checksum: bool | None = None
    statistics: dict[int, int] | None = None
    message_count: int | None = None
    library: str = ""
    finished: bool = False
    compares: bool = False
    max_chunk: int = MAX_CHUNK
    unpacks: Callable[[int, int], bool] = lambda first, last: True

    def expect(self, runs: NDArray[np.void]) -> None:
        """Take note of the messages that the manifest of a chunk names (`chunk_manifest.RUN`)."""
        for channel, count, _, sequence, first, last in runs[runs["channel"] != 0].tolist():
            known = self.expected.get(channel)
            self.expected[channel] = Expected(
                max(sequence + count - 1, known.last_sequence if known else 0),
                min(first, known.first if known else first),
                max(last, known.last if known else last),
            )

    def note(self, where: str, offset: int, what: str) -> None:
        """Keep a defect with its place; the same of the same place once."""
        if (self.damage and self.damage[-1] == (offset, what)) or len(self.damage) > MAX_NOTES:
            return
        if len(self.damage) == MAX_NOTES:
            what = f"more than {MAX_NOTES} places are damaged; further ones are not listed"
        self.damage.append((offset, what))
        self.problems.append(f"{where}, byte {offset}: {what}")

    def contradict(self, where: str, offset: int, what: str) -> None:
        """Keep a contradiction with its place."""
        self.note(where, offset, what)
        if len(self.contradictions) < MAX_NOTES:
            self.contradictions.append(f"{where}, byte {offset}: {what}")


@dataclass(frozen=True)
class Block:
    """Bytes with messages in them: ``heads`` (MESSAGE_HEAD) and ``offsets`` (start of each record), file order."""

    data: bytes
    heads: NDArray[np.void]
    offsets: IntArray

    def by_channel(self, channels: Mapping[int, Channel]) -> Iterator[tuple[Channel, IntArray]]:
        """Channels of the messages, and the rows of each; messages of an unknown channel are left out."""
        numbers = self.heads["channel"]
        for number in np.unique(numbers).tolist():
            if number in channels:
                yield channels[number], np.flatnonzero(numbers == number)

    def payload(self, row: int) -> bytes:
        """Payload of one message."""
        start = int(self.offsets[row]) + HEAD
        return self.data[start : start + int(self.heads["length"][row]) - BODY]

    def payloads(self, rows: IntArray) -> Iterator[tuple[IntArray, NDArray[np.uint8]]]:
        """Payloads (m, size) of messages, those of equal size together, and their places (m,) in `rows`."""
        data = np.frombuffer(self.data, np.uint8)
        sizes = self.heads["length"][rows].astype(np.int64) - BODY
        starts = self.offsets[rows] + HEAD
        for size in np.unique(sizes).tolist():
            same = np.flatnonzero(sizes == size)
            empty = np.zeros((same.size, 0), np.uint8)
            yield same, sliding_window_view(data, size)[starts[same]] if size else empty


def text_at(data: bytes, at: int) -> tuple[str, int]:
    """Text with its length before it, and the offset behind it.

    Raises
    ------
    struct.error, UnicodeDecodeError
        The data end before it does, or it is not UTF-8.
    """
    (n,) = struct.unpack_from("<I", data, at)
    if at + 4 + n > len(data):
        raise struct.error("text beyond the end of the record")
    return data[at + 4 : at + 4 + n].decode(), at + 4 + n


def table_at(data: bytes, at: int) -> dict[str, str]:
    """Table of texts; raises as `text_at`."""
    (n,) = struct.unpack_from("<I", data, at)
    end, at, out = at + 4 + n, at + 4, {}
    if end > len(data):
        raise struct.error("table beyond the end of the record")
    while at < end:
        key, at = text_at(data, at)
        out[key], at = text_at(data, at)
    return out


def _read_header(info: FileInfo, body: bytes) -> None:
    _, at = text_at(body, 0)
    info.library, _ = text_at(body, at)


def _read_schema(info: FileInfo, body: bytes) -> None:
    (number,) = struct.unpack_from("<H", body)
    name, at = text_at(body, 2)
    language, at = text_at(body, at)
    (n,) = struct.unpack_from("<I", body, at)
    info.schemas[number] = name, language, body[at + 4 : at + 4 + n]


def _read_channel(info: FileInfo, body: bytes) -> None:
    number, schema = struct.unpack_from("<HH", body)
    topic, at = text_at(body, 4)
    encoding, at = text_at(body, at)
    name, language, definition = info.schemas.get(schema, ("", "", b""))
    metadata = tuple(table_at(body, at).items())
    info.channels[number] = Channel(number, topic, name, encoding, definition, metadata, language)


def _read_metadata(info: FileInfo, body: bytes) -> None:
    name, at = text_at(body, 0)
    info.metadata.setdefault(name, []).append(table_at(body, at))


def _read_attachment(info: FileInfo, body: bytes) -> None:
    name, at = text_at(body, 16)
    media_type, at = text_at(body, at)
    (n,) = struct.unpack_from("<Q", body, at)
    end = at + 8 + n
    if end > len(body):
        raise struct.error("attachment beyond the end of the record")
    checksum = struct.unpack_from("<I", body, end)[0] if len(body) >= end + 4 else 0
    if checksum and zlib.crc32(body[:end]) != checksum:
        raise struct.error("checksum")
    info.attachments[name] = Attachment(media_type, body[at + 8 : end])


SEQUENCES = 1 << 32
"""Numbers that messages of a channel can have."""


def _read_statistics(info: FileInfo, body: bytes) -> None:
    (n,) = struct.unpack_from("<I", body, 42)
    if n % 10 or 46 + n > len(body):
        raise struct.error("counts beyond the end of the record")
    counts = dict(struct.iter_unpack("<HQ", body[46 : 46 + n]))
    if max(counts.values(), default=0) > SEQUENCES:
        raise struct.error("more messages than sequence numbers")
    (info.message_count,) = struct.unpack_from("<Q", body)
    info.statistics = counts


SIDE_RECORDS: dict[int, Callable[[FileInfo, bytes], None]] = {
    OP_HEADER: _read_header,
    OP_SCHEMA: _read_schema,
    OP_CHANNEL: _read_channel,
    OP_METADATA: _read_metadata,
    OP_ATTACHMENT: _read_attachment,
    OP_STATISTICS: _read_statistics,
}
"""Readers of the records that are no messages."""

NAMES = {
    OP_HEADER: "header",
    OP_SCHEMA: "schema",
    OP_CHANNEL: "channel",
    OP_CHUNK: "chunk",
    OP_METADATA: "metadata record",
    OP_ATTACHMENT: "attachment",
    OP_INDEX: "message index",
    OP_DATA_END: "end of the data",
    OP_MANIFEST: "manifest",
    OP_MESSAGE: "message",
    OP_STATISTICS: "statistics",
}
"""Names of the records for messages."""


def with_article(op: int) -> str:
    """Name of a record with its article, for sentences."""
    name = NAMES.get(op, "record")
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"


def read_side_record(info: FileInfo, op: int, body: bytes, where: str, offset: int) -> None:
    """Read a record that is no message; a damaged one is noted and left out."""
    try:
        SIDE_RECORDS[op](info, body)
    except (struct.error, UnicodeDecodeError):
        info.note(where, offset, f"{with_article(op)} is damaged and excluded")
