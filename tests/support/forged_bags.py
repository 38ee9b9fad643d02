"""Bags of somebody who alters what was recorded and makes the checksums anew."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import zstandard
from fuzz.record_mutations import Record, put_together, taken_apart

from pointing_analysis.read.mcap.chunks import block_of, take_apart, unpack_zstd
from pointing_analysis.read.mcap.records import HEAD, MAX_CHUNK, OP_CHUNK, FileInfo

TRUTH = "/telescope/truth/los"


def places(found: list[Record], op: int) -> list[int]:
    """Where the records of one type are."""
    return [at for at, (kind, _) in enumerate(found) if kind == op]


def scaled(body: bytes, topic: str = TRUTH, factor: float = 0.01, whole: bool = False) -> tuple[bytes, bytes]:
    """Record of a chunk, and its content, with the vectors of a topic scaled and a checksum that agrees.

    With `whole` a byte of each other message is changed as well.
    """
    packed = take_apart(body, False)
    assert packed is not None
    content = bytearray(unpack_zstd(packed.data, MAX_CHUNK)[0])
    info = FileInfo()
    block = block_of(info, bytes(content), [])
    assert block is not None
    for channel, rows in block.by_channel(info.channels):
        for row in rows.tolist():
            start, length = int(block.offsets[row]), int(block.heads["length"][row]) + 9
            if channel.topic == topic:
                values = np.frombuffer(content, "<f8", 3, start + length - 24)
                values *= factor
            elif whole:
                content[start + HEAD + 16] ^= 1
    data = zstandard.compress(bytes(content))
    head = struct.pack("<QQQI", *struct.unpack_from("<QQ", body), len(content), zlib.crc32(content))
    return head + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(data)) + data, bytes(content)


def forge(bag: Path, number: int = 1, whole: bool = False) -> None:
    """Scale the true line of sight in one chunk of a bag to a hundredth."""
    file = next(bag.glob("*.mcap"))
    found = taken_apart(file.read_bytes())
    at = places(found, OP_CHUNK)[number]
    found[at] = (OP_CHUNK, scaled(found[at][1], whole=whole)[0])
    file.write_bytes(put_together(found, True))
