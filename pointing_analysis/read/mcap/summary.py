"""The summary at the end of an MCAP file: channels, counts, and the places of most records.

It is used only if its checksum agrees: a place from a damaged summary would lead astray.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO

from pointing_analysis.read.mcap.records import (
    MAGIC,
    OP_ATTACHMENT,
    OP_ATTACHMENT_INDEX,
    OP_CHANNEL,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DATA_END,
    OP_DIGEST,
    OP_FOOTER,
    OP_INDEX,
    OP_METADATA,
    OP_METADATA_INDEX,
    OP_SCHEMA,
    OP_STATISTICS,
    RECORD,
    FileInfo,
    read_side_record,
)

_FOOTER = struct.Struct("<QQI")
_TAIL = RECORD.size + _FOOTER.size + len(MAGIC)
MAX_SUMMARY = 64_000_000
"""Largest summary that is read [byte]: that of a recording of some weeks."""


PIECE = 1 << 20
"""Bytes that are read at once for the checksum of the data."""


def checksum_before(stream: BinaryIO, end: int) -> int:
    """CRC-32 of a file from its beginning to a place."""
    checksum, left = 0, end
    stream.seek(0)
    while left and (part := stream.read(min(left, PIECE))):
        checksum, left = zlib.crc32(part, checksum), left - len(part)
    return checksum


def _footer(stream: BinaryIO) -> tuple[int, int, bytes] | None:
    """Place of the summary, its checksum, and the footer up to that; None without a footer that is whole."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _TAIL, 0))
    tail = stream.read(_TAIL)
    if tail[: RECORD.size] != RECORD.pack(OP_FOOTER, _FOOTER.size) or tail[RECORD.size + _FOOTER.size :] != MAGIC:
        return None
    start, _, checksum = _FOOTER.unpack_from(tail, RECORD.size)
    return start, checksum, tail[: RECORD.size + 16]


def may_lack_summary(stream: BinaryIO) -> bool:
    """Whether a file has a footer that names no summary, or none with a checksum, as the format allows."""
    footer = _footer(stream)
    return footer is not None and 0 in footer[:2]


@dataclass
class SummarySection:
    """Places of records.

    Attributes
    ----------
    anchors : offset -> (type, length of the content) of chunks, their index records, attachments, metadata, the end of
        the data
    times : offset of a chunk -> log times of its first and last message [ns]
    chunks : offsets of the chunks, one for each of its chunk indexes
    at : where it begins
    digest : place of the record with the digest of the file; 0 without one
    """

    anchors: dict[int, tuple[int, int]] = field(default_factory=dict)
    times: dict[int, tuple[int, int]] = field(default_factory=dict)
    chunks: list[int] = field(default_factory=list)
    at: int = 0
    digest: int = 0


def read_summary(stream: BinaryIO, info: FileInfo, where: str) -> SummarySection | None:
    """Read the summary into `info`; None without one that is whole."""
    end, footer = stream.seek(0, os.SEEK_END) - _TAIL, _footer(stream)
    if footer is None:
        return None
    start, checksum, head = footer
    if not checksum or not 0 < start < end or end - start > MAX_SUMMARY:
        return None
    stream.seek(start)
    data = stream.read(end - start)
    if zlib.crc32(head, zlib.crc32(data)) != checksum:
        return None
    section, at = SummarySection(at=start), 0
    try:
        while at + RECORD.size <= len(data):  # also behind the place of the offsets: other readers do not stop there
            op, length = RECORD.unpack_from(data, at)
            body = data[at + RECORD.size : at + RECORD.size + length]
            if op == OP_DIGEST:
                info.stated, section.digest = body, start + at
            elif op in (OP_SCHEMA, OP_CHANNEL, OP_STATISTICS):
                read_side_record(info, op, body, where, start + at)
            elif op == OP_CHUNK_INDEX:
                first, last, chunk, size_of_chunk, n = struct.unpack_from("<QQQQI", body)
                section.anchors[chunk] = (OP_CHUNK, size_of_chunk - RECORD.size)
                section.times[chunk] = (first, last)
                section.chunks.append(chunk)
                places = sorted(place for _, place in struct.iter_unpack("<HQ", body[36 : 36 + n]))
                (total,) = struct.unpack_from("<Q", body, 36 + n)
                ends = [*places[1:], chunk + size_of_chunk + total]
                for place, end in zip(places, ends):
                    section.anchors[place] = (OP_INDEX, end - place - RECORD.size)
            elif op in (OP_ATTACHMENT_INDEX, OP_METADATA_INDEX):
                place, size_of_record = struct.unpack_from("<QQ", body)
                kind = OP_ATTACHMENT if op == OP_ATTACHMENT_INDEX else OP_METADATA
                section.anchors[place] = (kind, size_of_record - RECORD.size)
            at += RECORD.size + length
    except struct.error:
        return None
    stream.seek(start - RECORD.size - 4)
    if stream.read(RECORD.size) == RECORD.pack(OP_DATA_END, 4):
        section.anchors[start - RECORD.size - 4] = (OP_DATA_END, 4)
    inside = (length >= 0 and at + RECORD.size + length <= start for at, (_, length) in section.anchors.items())
    return section if all(inside) else None
