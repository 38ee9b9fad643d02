"""Chunks of an MCAP file: unpacked within a limit, verified, and searched for their messages.

A chunk is used if its checksum agrees. If not, its manifest (`manifest`) tells which of its records are whole;
without one the chunk is excluded, because its valid values cannot be identified.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import zstandard
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pointing_analysis.arrays import BoolArray, IntArray
from pointing_analysis.read.mcap.manifest import Manifest, content_digest, salvage
from pointing_analysis.read.mcap.records import (
    BODY,
    HEAD,
    INDEX_ENTRY,
    MESSAGE_HEAD,
    OP_CHANNEL,
    OP_MESSAGE,
    OP_SCHEMA,
    RECORD,
    SIDE_RECORDS,
    BagError,
    Block,
    FileInfo,
    read_side_record,
    text_at,
)

_HEAD = struct.Struct("<QQQI")
ZSTD = b"\x28\xb5\x2f\xfd"
_ZSTD_BYTES = np.frombuffer(ZSTD, np.uint8)
_MAGIC = {ZSTD: "zstd", b"\x04\x22\x4d\x18": "lz4"}
_PIECE = 1 << 17  # unpacked at a time where the size is not believed [byte]; a block of zstd
_HEAD_BITS = 8 * 18  # longest head of a zstd frame, and of its first block [bit]
KINDS = ("", "zstd", "lz4")
MAX_OTHERS = 1000
"""Records of a chunk that are no messages: so many, and one more for each byte of the packed chunk."""


@dataclass(frozen=True)
class Packed:
    """A chunk record taken apart: compression, data, size and CRC-32 of what they unpack to."""

    kind: str
    data: bytes
    size: int
    checksum: int


@dataclass(frozen=True)
class Unpacked:
    """Content of a chunk as far as it can be had.

    Attributes
    ----------
    content : bytes
    whole : (n,) which records of the manifest are whole; None where all of the content is
    reason : what is wrong with the chunk; empty if nothing is lost
    proved : whether the content has the size and, if there is one, the checksum stated in the chunk or its manifest
    corrected : whether what the chunk holds is damaged, and the content was found by checksums all the same
    """

    content: bytes
    whole: BoolArray | None = None
    reason: str = ""
    proved: bool = True
    corrected: bool = False

    @cached_property
    def digest(self) -> bytes:
        """Digest of the content."""
        return content_digest(self.content)


def take_apart(body: bytes, cut: bool) -> Packed | None:
    """Fields of a chunk record; where the head is damaged, the packed data are found by their magic number."""
    try:
        _, _, size, checksum = _HEAD.unpack_from(body)
        kind, at = text_at(body, _HEAD.size)
        (length,) = struct.unpack_from("<Q", body, at)
        agrees = cut or at + 8 + length == len(body)
        if kind in KINDS and agrees:
            return Packed(kind, body[at + 8 :], size, checksum)
    except (struct.error, UnicodeDecodeError):
        kind, agrees = "", False
    places = [(body.find(magic, _HEAD.size, _HEAD.size + 64), name) for magic, name in _MAGIC.items()]
    marks = [(at, name) for at, name in places if at >= 0]
    if marks:
        at, name = min(marks)
        return Packed(name, body[at:], size, checksum)
    if kind not in KINDS and agrees:
        data = body[at + 8 :]
        if checksum and len(data) == size and zlib.crc32(data) == checksum:  # not compressed, despite its name
            return Packed("", data, size, checksum)
        raise BagError(f"chunk compression must be zstd, lz4 or none, got {kind!r}")
    return None


def unpack_zstd(data: bytes, limit: int) -> tuple[bytes, bool]:
    """The unpacked part, and whether it is complete; at most `limit` + 1 bytes."""
    try:
        size = zstandard.frame_content_size(data)
        if 0 <= size <= limit:
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=limit), True
    except zstandard.ZstdError:
        pass
    pieces, total = [], 0
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(io.BytesIO(data)) as reader:
            while total <= limit and (piece := reader.read(_PIECE)):
                pieces.append(piece)
                total += len(piece)
    except zstandard.ZstdError:
        return b"".join(pieces), False
    return b"".join(pieces), True


def _lz4(data: bytes, limit: int) -> tuple[bytes, bool]:
    import lz4.frame  # type: ignore[import-untyped]  # only for files that need it; mcap installs it

    unpack, pieces, total, rest = lz4.frame.LZ4FrameDecompressor(), [], 0, data
    try:
        while not unpack.eof and total <= limit:
            piece = unpack.decompress(rest, max_length=_PIECE)
            rest = b""
            if not piece and unpack.needs_input:
                break
            pieces.append(piece)
            total += len(piece)
    except RuntimeError:
        return b"".join(pieces), False
    return b"".join(pieces), True


def _expand(packed: Packed, limit: int) -> tuple[bytes, bool]:
    if not packed.kind:
        return packed.data, len(packed.data) >= packed.size
    return unpack_zstd(packed.data, limit) if packed.kind == "zstd" else _lz4(packed.data, limit)


def unpack(
    packed: Packed, manifest: Manifest | None, limit: int, cut: bool, named: Callable[[bytes], bool]
) -> Unpacked:
    """Unpack and verify a chunk.

    Parameters
    ----------
    packed : the chunk
    manifest : of the same chunk; None if there is none
    limit : largest content that is unpacked [byte]
    cut : whether the file ends inside the chunk
    named : whether any manifest of the file names a content with this digest
    """
    content, all_of_it = _expand(packed, limit)
    if len(content) > limit:
        return Unpacked(b"", None, f"a chunk unpacks to more than the limit of {limit / 1e6:g} MB (--max-chunk)")
    other_head = not all_of_it and not content and packed.kind == "zstd" and not cut
    if other_head:
        content, all_of_it = _other_head(packed, manifest, limit)
    if all_of_it and _verified(content, packed, manifest):
        stated = (packed.size, packed.checksum or zlib.crc32(content))
        return Unpacked(content, corrected=other_head or (len(content), zlib.crc32(content)) != stated)
    if all_of_it and content and named(content_digest(content)):  # its head is damaged, and its manifest elsewhere
        return Unpacked(content, corrected=True)
    reason = "a chunk is damaged (checksum)" if all_of_it else "a chunk is damaged (it cannot be decompressed)"
    if manifest is None:
        return Unpacked(content if cut and not all_of_it else b"", None, reason, False)
    content, whole = salvage(content, manifest)
    return Unpacked(content, whole, "" if whole.all() else reason, corrected=bool(whole.all()))


def _verified(content: bytes, packed: Packed, manifest: Manifest | None) -> bool:
    checksum = zlib.crc32(content)
    if packed.checksum and checksum == packed.checksum and len(content) == packed.size:
        return True  # also beside a manifest of another chunk
    if manifest is not None:
        return checksum == manifest.checksum and len(content) == manifest.size
    if not packed.checksum:
        return len(content) == packed.size
    # One wrong bit of 32 in the field itself and all the content right: chance gives that once in 10^8.
    return (checksum ^ packed.checksum).bit_count() <= 1


def _other_head(packed: Packed, manifest: Manifest | None, limit: int) -> tuple[bytes, bool]:
    """Undo one wrong bit in the head of the compressed data, where the content then has the right checksum."""
    for bit in range(min(_HEAD_BITS, 8 * len(packed.data))):
        data = bytearray(packed.data)
        data[bit // 8] ^= 1 << (bit % 8)
        content, all_of_it = unpack_zstd(bytes(data), limit)
        if all_of_it and content and _verified(content, packed, manifest):
            return content, True
    return b"", False


def index_offsets(indexed: list[bytes]) -> IntArray:
    """Offsets of the messages from the index records of a chunk, sorted."""
    parts = [np.frombuffer(body[6:], INDEX_ENTRY)["offset"] for body in indexed if len(body) % 16 == 6]
    offsets = np.concatenate([*parts, np.empty(0, "<u8")]).astype(np.int64)
    return np.sort(offsets)


def index_times(indexed: list[bytes]) -> dict[int, IntArray]:
    """Log times [ns] of the messages of each channel, from the index records of a chunk."""
    times = {}
    for body in indexed:
        if len(body) % 16 == 6 and len(body) > 6:
            number = int.from_bytes(body[:2], "little")
            times[number] = np.sort(np.frombuffer(body[6:], INDEX_ENTRY)["log"].astype(np.int64))
    return times


def index_agrees(block: Block, indexed: list[bytes]) -> bool:
    """Whether index records say of each message of a chunk its channel, its log time and where it begins."""
    if any(len(body) % 16 != 6 for body in indexed):
        return False
    rows = [np.frombuffer(body[6:], INDEX_ENTRY) for body in indexed]
    numbers = np.repeat([int.from_bytes(body[:2], "little") for body in indexed], [len(entries) for entries in rows])
    entries = np.concatenate(rows)
    order = np.argsort(entries["offset"], kind="stable")
    return (
        np.array_equal(entries["offset"][order], block.offsets.astype(np.uint64))
        and np.array_equal(entries["log"][order], block.heads["log"])
        and np.array_equal(numbers[order], block.heads["channel"])
    )


def _heads(data: bytes, offsets: IntArray) -> NDArray[np.void]:
    rows = sliding_window_view(np.frombuffer(data, np.uint8), HEAD)[offsets]
    heads: NDArray[np.void] = rows.view(MESSAGE_HEAD)[:, 0]
    return heads


def whole_records(info: FileInfo, chunk: Unpacked, manifest: Manifest, where: str, offset: int) -> Block | None:
    """Messages of a chunk at the offsets of its manifest; of a damaged one those among its complete records.

    Schemas and channels are read on the way. The index records of the chunk are not used: nothing binds them.
    """
    content = np.frombuffer(chunk.content, np.uint8)
    lengths = np.diff(manifest.offsets)
    usable = lengths >= RECORD.size
    if chunk.whole is not None:
        usable &= chunk.whole
    begins, lengths = manifest.offsets[:-1][usable], lengths[usable]
    is_message = content[begins] == OP_MESSAGE  # the record is whole, the manifest need not be
    for begin in begins[~is_message].tolist():
        op, length = RECORD.unpack_from(chunk.content, begin)
        if op in SIDE_RECORDS:
            read_side_record(info, op, chunk.content[begin + RECORD.size : begin + RECORD.size + length], where, offset)
    is_message &= lengths >= HEAD
    offsets = begins[is_message]
    if not offsets.size:
        return None
    heads = _heads(chunk.content, offsets)
    right = heads["length"] == lengths[is_message] - RECORD.size
    return Block(chunk.content, heads[right], offsets[right])


def block_of(
    info: FileInfo, data: bytes, indexed: list[bytes], where: str = "", offset: int = 0, packed: int | None = None
) -> Block | None:
    """Find the messages of a chunk: by its index records where they are right, by walking where they are not.

    `packed` is the size of the chunk in the file [byte]: a few bytes may not stand for millions of records.
    """
    most = MAX_OTHERS + (len(data) if packed is None else packed)
    offsets = index_offsets(indexed)
    if offsets.size and (offsets[0] < 0 or offsets[-1] > len(data) - HEAD):  # the sum may be beyond 64 bit
        offsets = offsets[:0]
    heads = _heads(data, offsets) if offsets.size else np.empty(0, MESSAGE_HEAD)
    ends = offsets + RECORD.size + heads["length"].astype(np.int64)
    starts = np.append(offsets, len(data))
    ends = np.insert(ends, 0, 0)
    if np.any(heads["op"] != OP_MESSAGE) or np.any(starts < ends):
        offsets, starts, ends = offsets[:0], np.array([len(data)]), np.array([0])
    # What the index does not cover holds the schema and channel records, and messages of a writer without an index.
    extra = [
        o
        for i in np.flatnonzero(starts > ends)
        for o in _scan(info, data, (int(ends[i]), int(starts[i])), (where, offset), most)
    ]
    if extra or heads.size != offsets.size:
        offsets = np.sort(np.concatenate([offsets, np.array(extra, dtype=np.int64)]))
        heads = _heads(data, offsets) if offsets.size else heads[:0]
    return Block(data, heads, offsets) if offsets.size else None


def followed_by_records(block: Block) -> Block:
    """The messages behind which another record begins.

    After a loss of power the tail of the file is zeros or junk: a message that ends in it has a valid header.
    """
    ends = block.offsets + RECORD.size + block.heads["length"].astype(np.int64)
    inside = ends + RECORD.size <= len(block.data)
    rows = sliding_window_view(np.frombuffer(block.data, np.uint8), RECORD.size)[np.where(inside, ends, 0)]
    is_record = np.isin(rows[:, 0], (OP_MESSAGE, OP_SCHEMA, OP_CHANNEL)) & ~rows[:, 5:].any(axis=1)  # below 4 GB
    kept = inside & is_record
    return Block(block.data, block.heads[kept], block.offsets[kept])


def _scan(info: FileInfo, data: bytes, part: tuple[int, int], place: tuple[str, int], most: int) -> list[int]:
    """Offsets of the messages between two positions, reading the other records on the way, `most` of them."""
    offsets, head, (at, stop) = [], RECORD.unpack_from, part
    while at + RECORD.size <= stop:
        op, length = head(data, at)
        end = at + RECORD.size + length
        if end > stop:
            break
        if op == OP_MESSAGE and length >= HEAD - RECORD.size:
            offsets.append(at)
        elif not op or not most:
            info.note(*place, "a chunk holds invalid records: the rest of it is excluded")
            break
        else:
            most -= 1
            if op in SIDE_RECORDS:
                read_side_record(info, op, data[at + RECORD.size : end], *place)
        at = end
    return offsets


def unpack_messages(block: Block, limit: int) -> tuple[Block, int]:
    """Unpack the payloads that are compressed one by one (``compression_mode: MESSAGE`` of rosbag2); others stay.

    Plain CDR begins with a zero, so the magic number of zstd decides.

    Parameters
    ----------
    block : messages as they are in the file
    limit : most that the payloads may take together [byte]

    Returns
    -------
    block : messages with plain payloads
    left_out : messages that cannot be unpacked, or not within the limit
    """
    starts, sizes = block.offsets + HEAD, block.heads["length"].astype(np.int64) - BODY
    # Of a payload of less than four bytes, the last four of head and payload.
    marks = sliding_window_view(np.frombuffer(block.data, np.uint8), 4)[starts - np.maximum(4 - sizes, 0)]
    packed = (sizes > 4) & (marks == _ZSTD_BYTES).all(axis=1)
    if not packed.any():
        return block, 0
    payloads, kept, left = [], [], limit
    for i, (start, size, zipped) in enumerate(zip(starts.tolist(), sizes.tolist(), packed.tolist())):
        payload, whole = block.data[start : start + size], True
        if zipped:
            payload, whole = unpack_zstd(payload, left)
        if len(payload) > left:
            break
        if whole:
            left -= len(payload)
            kept.append(i)
            payloads.append(payload)
    heads = block.heads[kept]
    heads["length"] = BODY + np.array([len(payload) for payload in payloads], np.uint64)
    sizes = heads["length"].astype(np.int64) + RECORD.size
    ends = np.cumsum(sizes)
    data = b"".join(head.tobytes() + payload for head, payload in zip(heads, payloads))
    return Block(data, heads, ends - sizes), len(block.heads) - len(kept)
