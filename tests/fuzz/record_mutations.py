"""Mutations of MCAP files whose records and checksums stay right: what a mistaken or hostile writer would make.

The records are taken apart, some are changed, and the file is put together again with the summary's checksum made
anew, so that a reader has reason to believe a summary that tells wrong places.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from fuzz.mutations import records
from hypothesis import strategies as st

from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, REPAIR_NAME
from pointing_analysis.read.mcap.records import (
    INDEX_ENTRY,
    MAGIC,
    OP_ATTACHMENT,
    OP_ATTACHMENT_INDEX,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DATA_END,
    OP_DIGEST,
    OP_FOOTER,
    OP_HEADER,
    OP_INDEX,
    OP_MANIFEST,
    OP_METADATA,
    OP_METADATA_INDEX,
    RECORD,
)

Record = tuple[int, bytes]
KINDS_OF_RECORDS = (*range(OP_HEADER, OP_METADATA_INDEX + 1), OP_DATA_END, OP_MANIFEST, OP_DIGEST, 14, 0, 0x10, 0xFF)
"""Those of MCAP, the testbed's own, and some that are none."""
ODD_NUMBERS = (0, 1, 30, 31, 1000, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
_CHUNK = struct.Struct("<QQQI")


@dataclass(frozen=True)
class RecordMutation:
    """One change: its kind, which record and which other one, a number, a text, bytes."""

    kind: str
    which: int
    other: int
    number: int
    text: str
    data: bytes

    def __call__(self, found: list[Record], foreign: list[Record]) -> list[Record]:
        """The changed records; `foreign` are those of another bag."""
        return KINDS[self.kind](list(found), self, foreign)


def taken_apart(data: bytes) -> list[Record]:
    """Type and content of each record of a whole file."""
    return [(data[begin], data[begin + RECORD.size : end]) for begin, end in records(data)]


def put_together(found: list[Record], trusted: bool) -> bytes:
    """A file of these records; with `trusted` the footer has the place and the checksum of the summary as it is now."""
    parts = [RECORD.pack(op, len(body)) + body for op, body in found]
    last = max((i for i, (op, _) in enumerate(found) if op == OP_DATA_END), default=None)
    if trusted and last is not None and found[-1][0] == OP_FOOTER and len(found[-1][1]) == 20:
        start = len(MAGIC) + sum(map(len, parts[: last + 1]))
        summary, before = b"".join(parts[last + 1 : -1]), struct.unpack("<QQI", found[-1][1])
        old_offsets = before[1] - before[0] if before[1] else 0
        offsets = start + old_offsets if 0 <= old_offsets <= len(summary) else 0
        head = RECORD.pack(OP_FOOTER, 20) + struct.pack("<QQ", start, offsets)
        parts[-1] = head + struct.pack("<I", zlib.crc32(head, zlib.crc32(summary)))
    return MAGIC + b"".join(parts) + MAGIC


def as_text(text: str) -> bytes:
    """A text as MCAP writes it, with its length."""
    data = text.encode(errors="replace")
    return struct.pack("<I", len(data)) + data


def places(found: list[Record], *ops: int) -> list[int]:
    """Where the records of some types are."""
    return [i for i, (op, _) in enumerate(found) if op in ops]


def _choose(found: list[Record], number: int, *ops: int) -> int | None:
    own = places(found, *ops)
    return own[number % len(own)] if own else None


def _choose_chunk(found: list[Record], number: int) -> int | None:
    """One of the chunks that an earlier change has left long enough to be taken apart."""
    own = [i for i in places(found, OP_CHUNK) if _is_chunk(found[i][1])]
    return own[number % len(own)] if own else None


def _is_chunk(body: bytes) -> bool:
    begin = _CHUNK.size + 4
    return len(body) >= begin and len(body) >= begin + struct.unpack_from("<I", body, _CHUNK.size)[0] + 8


def chunk_of(body: bytes) -> tuple[tuple[int, ...], str, bytes]:
    """Head, compression and data of a chunk."""
    (length,) = struct.unpack_from("<I", body, _CHUNK.size)
    at = _CHUNK.size + 4 + length
    return _CHUNK.unpack_from(body), body[_CHUNK.size + 4 : at].decode(errors="replace"), body[at + 8 :]


def _packed(head: tuple[int, ...], kind: str, data: bytes) -> bytes:
    return _CHUNK.pack(*head) + as_text(kind) + struct.pack("<Q", len(data)) + data


def chunk_with(body: bytes, content: bytes) -> bytes:
    """The chunk with another content and a checksum that agrees."""
    head = (*_CHUNK.unpack_from(body)[:2], len(content), zlib.crc32(content))
    return _packed(head, "zstd", zstandard.compress(content))


def inside(body: bytes) -> list[Record]:
    """Type and content of each record in a whole chunk."""
    _, kind, data = chunk_of(body)
    content, found, at = unpacked(kind, data) or b"", [], 0
    while at + RECORD.size <= len(content):
        op, length = RECORD.unpack_from(content, at)
        found.append((op, content[at + RECORD.size : at + RECORD.size + length]))
        at += RECORD.size + length
    return found


def without_summary(found: list[Record]) -> list[Record]:
    """The records up to the end of the data, and a footer that names no summary: nothing counts the messages then."""
    end = max(places(found, OP_DATA_END), default=len(found) - 1)
    return [*found[: end + 1], (OP_FOOTER, bytes(20))]


def _compression(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Another name of the compression over the same data."""
    at = _choose_chunk(found, m.which)
    if at is not None:
        head, _old, data = chunk_of(found[at][1])
        names = ("", "lz4", "zstd", "zst", "brotli", "ZSTD", m.text)
        found[at] = (OP_CHUNK, _packed(head, names[m.other % len(names)], data))
    return found


def _repacked(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """The same content, where it can be unpacked, under another compression: nothing is lost."""
    at = _choose_chunk(found, m.which)
    if at is not None:
        head, kind, data = chunk_of(found[at][1])
        content = unpacked(kind, data)
        if content is None:
            return found
        kind, pack = (("", bytes), ("lz4", lz4.frame.compress), ("zstd", zstandard.ZstdCompressor().compress))[
            m.other % 3
        ]
        found[at] = (OP_CHUNK, _packed(head, kind, pack(content)))
    return found


def unpacked(kind: str, data: bytes) -> bytes | None:
    """The data unpacked; None where an earlier change has given them the name of another compression."""
    try:
        if kind == "lz4":
            return bytes(lz4.frame.decompress(data))
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 26) if kind == "zstd" else data
    except (RuntimeError, zstandard.ZstdError):
        return None


def _chunk_head(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Another time, size or checksum in the head of a chunk."""
    at = _choose_chunk(found, m.which)
    if at is not None:
        head, kind, data = chunk_of(found[at][1])
        fields, i = list(head), m.other % 4
        fields[i] = m.number % 2**32 if i == 3 else m.number
        found[at] = (OP_CHUNK, _packed(tuple(fields), kind, data))
    return found


def _index(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Offsets or times of a message index that lead elsewhere."""
    at = _choose(found, m.which, OP_INDEX)
    if at is not None and len(found[at][1]) > 6:
        body = bytearray(found[at][1])
        rows = np.frombuffer(body, INDEX_ENTRY, (len(body) - 6) // 16, 6)
        rows["offset" if m.other % 3 else "log"][m.other % rows.size :: 1 + m.which] = m.number
        found[at] = (OP_INDEX, bytes(body))
    return found


def _exchange(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Two records of one type change places: indexes and manifests then belong to other chunks."""
    op = (OP_INDEX, OP_MANIFEST, OP_CHUNK, OP_CHUNK_INDEX, OP_METADATA)[m.number % 5]
    first, second = _choose(found, m.which, op), _choose(found, m.other, op)
    if first is not None and second is not None:
        found[first], found[second] = found[second], found[first]
    return found


def _repeat(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """A record stands twice, the second time anywhere."""
    op = KINDS_OF_RECORDS[m.number % len(KINDS_OF_RECORDS)]
    at = _choose(found, m.which, op)
    if at is not None:
        found.insert(m.other % (len(found) + 1), found[at])
    return found


def _remove(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """All records of one type are missing."""
    op = KINDS_OF_RECORDS[m.number % len(KINDS_OF_RECORDS)]
    return [record for record in found if record[0] != op]


def _summary_number(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """A place or a length in a record of the summary is another number, and the checksum agrees with it."""
    at = _choose(found, m.which, OP_CHUNK_INDEX, OP_ATTACHMENT_INDEX, OP_METADATA_INDEX)
    if at is not None:
        op, body = found[at]
        place = 8 * (m.other % (len(body) // 8))
        found[at] = (op, body[:place] + struct.pack("<Q", m.number) + body[place + 8 :])
    return found


def _foreign_summary(found: list[Record], m: RecordMutation, foreign: list[Record]) -> list[Record]:
    """The summary of another bag."""
    mine, its = places(found, OP_DATA_END), places(foreign, OP_DATA_END)
    return found[: mine[-1] + 1] + foreign[its[-1] + 1 :] if mine and its else found


def _random(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """A record of any type and any content, anywhere."""
    op = KINDS_OF_RECORDS[m.which % len(KINDS_OF_RECORDS)]
    found.insert(m.other % (len(found) + 1), (op, m.data))
    return found


def _beside(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """An attachment or a metadata record with any name, perhaps a large one, or that of another."""
    names = (METADATA_NAME, REPAIR_NAME, "k_fsm.json", "start.json", "../../outside", "a\nb", "")
    name = names[m.which % len(names)] or m.text
    if m.other % 2:
        data = m.data * (20_000 if m.number % 3 == 0 else 1)
        body = bytes(16) + as_text(name) + as_text(m.text) + struct.pack("<Q", len(data)) + data
        record = (OP_ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))
    else:
        table = as_text(m.text) + as_text(m.data.hex())
        record = (OP_METADATA, as_text(name) + struct.pack("<I", len(table)) + table)
    found.insert(1 + m.other % len(found), record)
    return found


def _forged_content(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Other bytes in a chunk, with right checksum and without its manifest."""
    at = _choose_chunk(found, m.which)
    if at is None:
        return found
    kind, data = chunk_of(found[at][1])[1:]
    before = unpacked(kind, data)
    if before is None:
        return found
    content = bytearray(before)
    place = m.number % (len(content) + 1) if m.other % 2 else m.other % 200
    if m.other % 3:
        content[place : place + len(m.data)] = m.data
    else:
        content[place:place] = RECORD.pack(KINDS_OF_RECORDS[m.which % len(KINDS_OF_RECORDS)], len(m.data)) + m.data
    found[at] = (OP_CHUNK, chunk_with(found[at][1], bytes(content)))
    if at and found[at - 1][0] == OP_MANIFEST:
        del found[at - 1]
    return found


def _forged_record(found: list[Record], m: RecordMutation, _: list[Record]) -> list[Record]:
    """Other bytes in the content of any record but a chunk."""
    at = m.which % len(found)
    op, body = found[at]
    if op != OP_CHUNK and body:
        place = m.other % min(len(body), 300)
        found[at] = (op, (body[:place] + m.data + body[place + len(m.data) :])[: len(body) + m.number % 2])
    return found


FORGERIES = frozenset({"forged_content", "forged_record", "foreign_summary", "random", "summary_number", "beside"})
"""Kinds after which the file may say, with right checksums, what nobody recorded."""
KINDS: dict[str, Callable[[list[Record], RecordMutation, list[Record]], list[Record]]] = {
    "compression": _compression,
    "repacked": _repacked,
    "chunk_head": _chunk_head,
    "index": _index,
    "exchange": _exchange,
    "repeat": _repeat,
    "remove": _remove,
    "summary_number": _summary_number,
    "foreign_summary": _foreign_summary,
    "random": _random,
    "beside": _beside,
    "forged_content": _forged_content,
    "forged_record": _forged_record,
}

INTEGERS = st.integers(0, 10_000)
RECORD_MUTATIONS = st.builds(
    RecordMutation,
    st.sampled_from(sorted(KINDS)),
    INTEGERS,
    INTEGERS,
    st.sampled_from(ODD_NUMBERS) | st.integers(0, 2**64 - 1),
    st.text(max_size=20),
    st.binary(min_size=1, max_size=200),
)
