"""Repair of a bag whose recorder was killed or whose file is damaged: every reader opens the new bag."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard

from los_testbed.bags.mcap_blocks import MAGIC
from los_testbed.bags.writer import BagWriter, check_new_bag

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_CHANNEL, _MESSAGE_CODE, _CHUNK_CODE, _ATTACHMENT, _METADATA = 4, 5, 6, 9, 12
_LARGEST = 1 << 31


@dataclass
class RepairResult:
    """What was copied and what is damaged.

    Attributes
    ----------
    messages : messages in the new bag
    chunks : complete chunks found
    damaged : offset of each damaged chunk in the file [byte] and what is wrong with it
    cut_at : where the file ends in the middle of a record [byte]; None if it does not
    last_stamp : log time of the newest message [ns]
    """

    messages: int = 0
    chunks: int = 0
    damaged: list[tuple[int, str]] = field(default_factory=list)
    cut_at: int | None = None
    last_stamp: int = 0


def repair_bag(source: Path, target: Path) -> RepairResult:
    """Copy every complete message of `source` (folder or file) into the new bag `target`.

    Raises
    ------
    ValueError
        `source` is no bag of this testbed, or `target` exists.
    """
    check_new_bag(target)
    file = _file(source)
    data = file.read_bytes()
    if data[:8] != MAGIC:
        raise ValueError(f"{file} must be an MCAP file, got one that begins with {data[:8]!r}")
    result = RepairResult()
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, tuple[str, bytes]] = {}
    chunks: list[tuple[int, bytes]] = []
    for code, offset, body in _records(data, 8, result):
        if code == _METADATA:
            name, at = _text(body, 0)
            metadata[name] = _table(body, at)
        elif code == _ATTACHMENT:
            name, at = _text(body, 16)
            media_type, at = _text(body, at)
            size = int.from_bytes(body[at : at + 8], "little")
            attachments[name] = (media_type, body[at + 8 : at + 8 + size])
        elif code == _CHUNK_CODE:
            chunks.append((offset, body))
    metadata.pop("rosbag2", None)
    names: dict[int, str] = {}
    with BagWriter(target, metadata, attachments, diagnostics=True) as bag:
        for offset, body in chunks:
            _copy_chunk(offset, body, bag, names, result)
    return result


def _file(source: Path) -> Path:
    files = sorted(source.glob("*.mcap")) if source.is_dir() else [source]
    if len(files) != 1 or not files[0].is_file():
        raise ValueError(f"{source} must be a bag folder with one .mcap file, got {len(files)}")
    return files[0]


def _records(data: bytes, at: int, result: RepairResult | None = None) -> Iterator[tuple[int, int, bytes]]:
    """Code, offset and content of the records, up to the first that is cut off."""
    while at + _RECORD.size <= len(data) and data[at : at + 8] != MAGIC:
        code, length = _RECORD.unpack_from(data, at)
        end = at + _RECORD.size + length
        if length > _LARGEST or end > len(data):
            if result is not None:
                result.cut_at = at
            return
        yield code, at, data[at + _RECORD.size : end]
        at = end
    if result is not None and at < len(data) and data[at : at + 8] != MAGIC:
        result.cut_at = at


def _copy_chunk(offset: int, body: bytes, bag: BagWriter, names: dict[int, str], result: RepairResult) -> None:
    _, _, size, checksum = _CHUNK.unpack_from(body)
    compression, at = _text(body, _CHUNK.size)
    packed = body[at + 8 :]
    try:
        content = zstandard.decompress(packed, max_output_size=size) if compression == "zstd" else packed
    except zstandard.ZstdError as error:
        result.damaged.append((offset, f"cannot be decompressed ({error})"))
        return
    if checksum and zlib.crc32(content) != checksum:
        result.damaged.append((offset, "its checksum does not fit"))
        return
    result.chunks += 1
    collected: dict[str, list[tuple[int, int, bytes]]] = {}
    for code, _, record in _records(content, 0):
        if code == _CHANNEL:
            names[int.from_bytes(record[:2], "little")] = _text(record, 4)[0]
        elif code == _MESSAGE_CODE:
            number, _, log, publish = _MESSAGE.unpack_from(record)
            if names.get(number) in bag.topics:
                collected.setdefault(names[number], []).append((log, publish, record[_MESSAGE.size :]))
    for name, messages in collected.items():
        _copy_messages(bag, name, messages)
        result.messages += len(messages)
        result.last_stamp = max(result.last_stamp, messages[-1][0])
    bag.end_chunk()


def _copy_messages(bag: BagWriter, name: str, messages: list[tuple[int, int, bytes]]) -> None:
    """Messages of one topic in their order; those of equal length in one block."""
    start = 0
    for stop in range(1, len(messages) + 1):
        if stop < len(messages) and len(messages[stop][2]) == len(messages[start][2]):
            continue
        part = messages[start:stop]
        block = np.frombuffer(b"".join(m[2] for m in part), np.uint8).reshape(len(part), -1)
        log, publish = (np.array([m[i] for m in part], np.int64) for i in (0, 1))
        bag.write(name, log, publish, block)
        start = stop


def _text(data: bytes, at: int) -> tuple[str, int]:
    length = int.from_bytes(data[at : at + 4], "little")
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length


def _table(data: bytes, at: int) -> dict[str, str]:
    end = at + 4 + int.from_bytes(data[at : at + 4], "little")
    at += 4
    table = {}
    while at < end:
        key, at = _text(data, at)
        table[key], at = _text(data, at)
    return table
