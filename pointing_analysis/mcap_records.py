"""Records of an MCAP file, read in blocks; damaged and cut-off files are read as far as possible.

The file format is simple (https://mcap.dev/spec): a magic number, then records ``opcode (1 byte), length (8 bytes),
content``. Messages sit in compressed chunks, each followed by message-index records that say where in the chunk
each channel's messages begin. General readers turn every message into an object; a pointing analysis wants arrays, so
this module yields complete chunks with the *offsets* of their messages and leaves the decoding to numpy.

A file whose recorder was killed has no footer and perhaps half a chunk: all that can be decompressed is used and the
cut is reported as a problem.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
import zstandard
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
OP_FOOTER, OP_SCHEMA, OP_CHANNEL, OP_MESSAGE, OP_CHUNK, OP_INDEX = 2, 3, 4, 5, 6, 7
OP_ATTACHMENT, OP_METADATA, OP_DATA_END = 9, 12, 15
RECORD = struct.Struct("<BQ")
# A message record as it lies in the chunk; the payload follows.
MESSAGE_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
HEAD = MESSAGE_HEAD.itemsize  # 31
BODY = HEAD - RECORD.size  # 22: part of the length that is not payload
PLAIN_BLOCK = 4 << 20  # unchunked files are read in blocks of this size [byte]
LARGEST_RECORD = 1 << 31  # a longer one is a damaged length field


class BagError(ValueError):
    """The file is not a bag, or not one that can be read; the message says what it must be and what it is."""


@dataclass(frozen=True)
class Channel:
    """One topic in one file: its number in the file, name, message type and encoding."""

    id: int
    topic: str
    schema: str
    encoding: str


@dataclass
class FileInfo:
    """What a file says about itself beside messages; grows while the file is read."""

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, str] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    finished: bool = False
    # Whether to unpack a chunk, by the times [ns] of its first and last message; the others are skipped unread.
    unpacks: Callable[[int, int], bool] = lambda first, last: True


@dataclass(frozen=True)
class Block:
    """Bytes with messages in them: ``heads`` (MESSAGE_HEAD) and ``offsets`` (start of each record), file order."""

    data: bytes
    heads: NDArray[np.void]
    offsets: NDArray[np.int64]


def _string(data: bytes, at: int) -> tuple[str, int]:
    (n,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + n].decode(), at + 4 + n


def _string_map(data: bytes, at: int) -> dict[str, str]:
    (n,) = struct.unpack_from("<I", data, at)
    end, at, out = at + 4 + n, at + 4, {}
    while at < end:
        key, at = _string(data, at)
        out[key], at = _string(data, at)
    return out


def _read_schema(info: FileInfo, body: bytes) -> None:
    (number,) = struct.unpack_from("<H", body)
    info.schemas[number] = _string(body, 2)[0]


def _read_channel(info: FileInfo, body: bytes) -> None:
    number, schema = struct.unpack_from("<HH", body)
    topic, at = _string(body, 4)
    encoding, _ = _string(body, at)
    info.channels[number] = Channel(number, topic, info.schemas.get(schema, ""), encoding)


def _read_metadata(info: FileInfo, body: bytes) -> None:
    name, at = _string(body, 0)
    info.metadata.setdefault(name, {}).update(_string_map(body, at))


def _read_attachment(info: FileInfo, body: bytes) -> None:
    name, at = _string(body, 16)
    _, at = _string(body, at)
    (n,) = struct.unpack_from("<Q", body, at)
    info.attachments[name] = body[at + 8 : at + 8 + n]


_SIDE_RECORDS: dict[int, Callable[[FileInfo, bytes], None]] = {
    OP_SCHEMA: _read_schema,
    OP_CHANNEL: _read_channel,
    OP_METADATA: _read_metadata,
    OP_ATTACHMENT: _read_attachment,
}


def _side(info: FileInfo, op: int, body: bytes) -> None:
    """Read a record that is no message; a damaged one is noted and left out."""
    try:
        _SIDE_RECORDS[op](info, body)
    except (struct.error, UnicodeDecodeError):
        info.problems.append(f"a damaged record (type {op}) is left out")


def _scan(info: FileInfo, data: bytes, start: int, stop: int) -> list[int]:
    """Offsets of the messages between two positions, reading the other records on the way."""
    offsets, at, head = [], start, RECORD.unpack_from
    while at + RECORD.size <= stop:
        op, length = head(data, at)
        end = at + RECORD.size + length
        if end > stop:
            break
        if op == OP_MESSAGE and length >= BODY:
            offsets.append(at)
        elif op in _SIDE_RECORDS:
            _side(info, op, data[at + RECORD.size : end])
        at = end
    return offsets


def _heads(data: bytes, offsets: NDArray[np.int64]) -> NDArray[np.void]:
    rows = sliding_window_view(np.frombuffer(data, np.uint8), HEAD)[offsets]
    heads: NDArray[np.void] = rows.view(MESSAGE_HEAD)[:, 0]
    return heads


def _block(info: FileInfo, data: bytes, indexed: list[bytes]) -> Block | None:
    """Find the messages of a chunk: by its index records where they are right, by walking where they are not."""
    offsets = np.concatenate([np.frombuffer(i, "<u8")[1::2] for i in indexed] or [np.empty(0, "<u8")]).astype(np.int64)
    offsets.sort()
    if offsets.size and (offsets[0] < 0 or offsets[-1] + HEAD > len(data)):
        offsets = offsets[:0]
    heads = _heads(data, offsets) if offsets.size else np.empty(0, MESSAGE_HEAD)
    ends = offsets + RECORD.size + heads["length"].astype(np.int64)
    starts = np.append(offsets, len(data))
    ends = np.insert(ends, 0, 0)
    if np.any(heads["op"] != OP_MESSAGE) or np.any(starts < ends):
        offsets, starts, ends = offsets[:0], np.array([len(data)]), np.array([0])
    # What the index does not cover holds the schema and channel records, and messages of a writer without an index.
    extra = [o for i in np.flatnonzero(starts > ends) for o in _scan(info, data, int(ends[i]), int(starts[i]))]
    if extra or heads.size != offsets.size:
        offsets = np.sort(np.concatenate([offsets, np.array(extra, dtype=np.int64)]))
        heads = _heads(data, offsets) if offsets.size else heads[:0]
    return Block(data, heads, offsets) if offsets.size else None


def _lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]  # only for files that need it; mcap installs it

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))


def _zstd(data: bytes, size: int) -> bytes:
    return zstandard.ZstdDecompressor().decompressobj().decompress(data)


def _unpack(info: FileInfo, body: bytes, where: str, cut: bool) -> bytes:
    """Decompress a chunk record; of a damaged or cut one, as much as can be had or nothing, with a problem noted."""
    try:
        _, _, size, crc = struct.unpack_from("<QQQI", body)
        kind, at = _string(body, 28)
        packed = body[at + 8 :] if cut else body[at + 8 : at + 8 + struct.unpack_from("<Q", body, at)[0]]
    except (struct.error, UnicodeDecodeError):
        info.problems.append(f"{where}: the head of a chunk is damaged; it is left out")
        return b""
    if kind not in ("", "zstd", "lz4"):
        raise BagError(f"{where}: chunk compression must be zstd, lz4 or none, got {kind!r}")
    try:
        data = packed if not kind else _zstd(packed, size) if kind == "zstd" else _lz4(packed, size)
    except (zstandard.ZstdError, RuntimeError) as error:
        info.problems.append(f"{where}: a chunk cannot be decompressed and is left out ({error})")
        return b""
    if not cut and (len(data) != size or (crc and zlib.crc32(data) != crc)):
        info.problems.append(f"{where}: a chunk is damaged (checksum or length) and is left out")
        return b""
    return data


class _Walk:
    """State of one pass over one file."""

    def __init__(self, stream: BinaryIO, info: FileInfo, where: str, largest: int) -> None:
        self.stream, self.info, self.where, self.largest = stream, info, where, largest
        self.plain = bytearray()

    def _cut(self, what: str) -> None:
        self.info.problems.append(f"{self.where}: the file ends inside {what}: the recording was cut off")

    def record(self) -> tuple[int, bytes, bool] | None:
        """Next record as (opcode, content, whole?); None at the end of the data."""
        head = self.stream.read(RECORD.size)
        if len(head) < RECORD.size:
            # A finished file never gets here: the walk stops at its data-end or footer record.
            self._cut("the data section")
            return None
        op, length = RECORD.unpack(head)
        if op == OP_CHUNK and 16 < length < LARGEST_RECORD:
            times = self.stream.read(16)
            if len(times) == 16 and not self.info.unpacks(*struct.unpack("<QQ", times)):
                return self._skip(op, length - 16)
            body = times + self.stream.read(min(length - 16, self.largest))
            if len(body) < length:
                self._cut("a chunk")
            return op, body, len(body) == length
        if op == 0 or length > LARGEST_RECORD:
            self.info.problems.append(f"{self.where}: damaged record; the rest of the file is left out")
            return None
        body = self.stream.read(min(length, self.largest))
        if len(body) < length:
            self._cut("a record")
        return op, body, len(body) == length

    def _skip(self, op: int, length: int) -> tuple[int, bytes, bool]:
        """Skip a chunk; read its last byte so that a file that was cut off is still noticed."""
        self.stream.seek(length - 1, os.SEEK_CUR)
        whole = len(self.stream.read(1)) == 1
        if not whole:
            self._cut("a chunk")
        return op, b"", whole

    def _summary(self) -> None:
        """Channels without a message stand only in the summary after the data."""
        while len(head := self.stream.read(RECORD.size)) == RECORD.size:
            op, length = RECORD.unpack(head)
            if op in (0, OP_FOOTER) or length > self.largest or len(body := self.stream.read(length)) < length:
                return
            if op in (OP_SCHEMA, OP_CHANNEL):
                _side(self.info, op, body)

    def flush(self) -> Iterator[Block]:
        if self.plain:
            block = _block(self.info, bytes(self.plain), [])
            self.plain.clear()
            if block is not None:
                yield block

    def blocks(self) -> Iterator[Block]:
        chunk: bytes | None = None
        indexed: list[bytes] = []
        while (got := self.record()) is not None:
            op, body, whole = got
            if op == OP_INDEX and whole:
                if len(body) % 16 == 6:  # channel and length, then pairs of time and offset
                    indexed.append(body[6:])
                continue
            if chunk is not None:
                block, chunk, indexed = _block(self.info, chunk, indexed), None, []
                if block is not None:
                    yield block
            if op in (OP_DATA_END, OP_FOOTER):
                self.info.finished = True
                self._summary()
                break
            if op == OP_CHUNK and len(body) > 40:
                offset = self.stream.tell() - len(body) - RECORD.size
                chunk = _unpack(self.info, body, f"{self.where}, byte {offset}", cut=not whole)
            elif op == OP_MESSAGE and whole:
                self.plain += RECORD.pack(op, len(body)) + body
                if len(self.plain) > PLAIN_BLOCK:
                    yield from self.flush()
            elif op in _SIDE_RECORDS and whole:
                _side(self.info, op, body)
            if not whole:
                break
        if chunk:
            block = _block(self.info, chunk, indexed)
            if block is not None:
                yield block
        yield from self.flush()


def walk(path: str | os.PathLike[str], info: FileInfo) -> Iterator[Block]:
    """Yield the message blocks of an MCAP file in file order, filling `info` on the way.

    Parameters
    ----------
    path : path of a ``.mcap`` file, or of a ``.mcap.zstd`` file as ``ros2 bag record --compression-mode file`` writes
    info : collects channels, metadata records, attachments and problems

    Raises
    ------
    BagError
        The file does not begin with the MCAP magic number.
    """
    where = os.path.basename(os.fspath(path))
    with open(path, "rb") as raw:
        stream: BinaryIO = raw
        if where.endswith((".zstd", ".zst")):
            stream = zstandard.ZstdDecompressor().stream_reader(raw)  # type: ignore[assignment]
        magic = stream.read(len(MAGIC))
        if magic != MAGIC:
            raise BagError(f"{where}: an MCAP file must begin with {MAGIC!r}, got {magic!r}")
        # A damaged length must not make us ask for more memory than the file can fill.
        largest = LARGEST_RECORD if stream is not raw else os.fstat(raw.fileno()).st_size
        yield from _Walk(stream, info, where, largest).blocks()
