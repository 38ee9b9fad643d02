"""Bags of somebody who alters what was recorded and makes the checksums anew."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from fuzz.record_mutations import Record, chunk_with, places, put_together, taken_apart
from los_testbed.bags.writer import BagWriter
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata

from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, merged, with_hash
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.chunks import block_of, take_apart, unpack_zstd
from pointing_analysis.read.mcap.file_digest import new_digest
from pointing_analysis.read.mcap.manifest import decode_manifest, encode_manifest
from pointing_analysis.read.mcap.records import (
    HEAD,
    MAGIC,
    MAX_CHUNK,
    OP_ATTACHMENT,
    OP_ATTACHMENT_INDEX,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DIGEST,
    OP_MANIFEST,
    OP_METADATA,
    OP_METADATA_INDEX,
    RECORD,
    FileInfo,
    table_at,
    text_at,
)
from pointing_analysis.read.run import Run

TRUTH = "/telescope/truth/los"


def right_places(found: list[Record]) -> list[Record]:
    """The records with a summary that names the places where chunks, attachments and metadata records are."""
    ends = np.cumsum([len(MAGIC), *(RECORD.size + len(body) for _, body in found)]).tolist()
    pairs = {OP_CHUNK_INDEX: OP_CHUNK, OP_ATTACHMENT_INDEX: OP_ATTACHMENT, OP_METADATA_INDEX: OP_METADATA}
    left = {op: places(found, of) for op, of in pairs.items()}
    made = []
    for op, body in found:
        if op in pairs:
            if not left[op]:
                continue  # of a record that is there no more
            at = left[op].pop(0)
            place = struct.pack("<QQ", ends[at], ends[at + 1] - ends[at])
            body = body[:16] + place + body[32:] if op == OP_CHUNK_INDEX else place + body[16:]
            if op == OP_CHUNK_INDEX:
                (n,) = struct.unpack_from("<I", body, 32)
                rows = b"".join(found[at + 1 + i][1][:2] + struct.pack("<Q", ends[at + 1 + i]) for i in range(n // 10))
                body = body[:36] + rows + body[36 + n :]
        made.append((op, body))
    return made


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
    return chunk_with(body, bytes(content)), bytes(content)


def forge(bag: Path, number: int = 1, whole: bool = False) -> None:
    """Scale the true line of sight in one chunk of a bag to a hundredth."""
    file = next(bag.glob("*.mcap"))
    found = taken_apart(file.read_bytes())
    at = places(found, OP_CHUNK)[number]
    found[at] = (OP_CHUNK, scaled(found[at][1], whole=whole)[0])
    file.write_bytes(put_together(right_places(found), True))


def forge_with_manifest(bag: Path, number: int = 1, digested: bool = False) -> None:
    """Scale the true line of sight in one chunk and make its manifest anew, with `digested` that of the file, too."""
    file = next(bag.glob("*.mcap"))
    found = taken_apart(file.read_bytes())
    at, place = places(found, OP_CHUNK)[number], places(found, OP_MANIFEST)[number]
    body, content = scaled(found[at][1])
    found[at], old = (OP_CHUNK, body), decode_manifest(found[place][1])
    assert old is not None
    found[place] = (OP_MANIFEST, encode_manifest(content, old.runs.tolist()))
    found = right_places(found)
    file.write_bytes(put_together(redigested(found) if digested else found, True))


def without_digest(bag: Path) -> None:
    """Take the digest out of a file, as of an older version."""
    file = next(bag.glob("*.mcap"))
    found = [record for record in taken_apart(file.read_bytes()) if record[0] != OP_DIGEST]
    file.write_bytes(put_together(found, True))


def redigested(found: list[Record]) -> list[Record]:
    """The records with a digest of the file that agrees with them."""
    made, digest = [], new_digest()
    digest.update(MAGIC)
    for op, body in found:
        body = digest.digest() if op == OP_DIGEST else body
        digest.update(RECORD.pack(op, len(body)) + body)
        made.append((op, body))
    return made


def cut_short(bag: Path, target: Path, seconds: float) -> Path:
    """A bag of the first seconds of another one, with its metadata and files: whole, and nothing in it says more."""
    run, end = Run.open(bag), 0
    table, _ = merged([head_of(bag)])
    files = {name: ("application/json", data) for name, data in run.attachments.items()}
    with BagWriter(target, {METADATA_NAME: table}, files, namespace=run.namespace) as made:
        reading = BagPass(bag, bag_files(bag))
        for info, block in reading.blocks():
            end = end or int(block.heads["log"].min()) + round(seconds * 1e9)
            for channel, rows in block.by_channel(info.channels):
                kept = rows[block.heads["log"][rows] < end]
                log = block.heads["log"][kept].astype(np.int64)
                for same, payloads in block.payloads(kept):
                    made.write(channel.topic, log[same], log[same], payloads)
            made.end_chunk()
    return target


def head_of(bag: Path) -> FileInfo:
    """What the file of a bag says beside its messages."""
    reading = BagPass(bag, bag_files(bag), heads_only=True)
    for _ in reading.blocks():
        pass
    return reading.infos[0]


def with_metadata(bag: Path, **entries: str) -> None:
    """Change entries of the settings and results in a bag, with their hashes and the digest of the file made anew."""
    file = next(bag.glob("*.mcap"))
    found = taken_apart(file.read_bytes())
    for at in (at for at in places(found, OP_METADATA) if text_at(found[at][1], 0)[0] == METADATA_NAME):
        builder = RecordBuilder()
        table = table_at(found[at][1], 4 + len(METADATA_NAME))
        Metadata(name=METADATA_NAME, metadata=with_hash({**table, **entries})).write(builder)
        found[at] = (OP_METADATA, builder.end()[9:])
    file.write_bytes(put_together(redigested(right_places(found)), True))
