"""MCAP files written in blocks: many messages of one topic at a time, one chunk per second.

The records themselves are those of the `mcap` package; only the message records and their index, which
at 8 000 a second would cost more than the control loop, are laid out with numpy. A chunk is compressed
with zstd and carries a checksum of its content. It can be read alone: it begins with all schemas and channels, and
before it stands a manifest with a checksum of each of its records (`pointing_analysis.read.mcap.manifest`). At the end
of the file is a digest of all its bytes (`pointing_analysis.read.mcap.file_digest`).
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from pointing_analysis.read.mcap.file_digest import new_digest
from pointing_analysis.read.mcap.manifest import encode_manifest
from pointing_analysis.read.mcap.records import BODY, INDEX_ENTRY, MAGIC, MESSAGE_HEAD, OP_DIGEST, OP_MANIFEST, RECORD

MAX_CHUNK = 16_000_000
"""Largest content of a chunk [byte]; a larger one is split."""


def _part(values: NDArray[np.int64] | None, start: int, stop: int) -> NDArray[np.int64] | None:
    return None if values is None else values[start:stop]


class McapBlockWriter:
    """Writer of one MCAP file.

    Parameters
    ----------
    path : Path
        File to make; it must not exist.
    profile : str
        ``ros2`` for a ROS 2 bag.

    Raises
    ------
    FileExistsError
        There is such a file already.
    """

    def __init__(self, path: Path, profile: str = "ros2") -> None:
        self._file = path.open("xb")
        self._compressor = zstandard.ZstdCompressor(level=3)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._runs: list[tuple[int, ...]] = []
        self._blocks: list[NDArray[np.uint8]] = []
        self._index: dict[int, list[NDArray[np.void]]] = {}
        self._chunk_size = 0
        self._span: list[int] = []
        self.counts: dict[int, int] = {}
        self._sequences: dict[int, int] = {}
        self._digest = new_digest()
        self.start_time = 0
        self.end_time = 0
        self._put(MAGIC)
        self._write(Header(profile=profile, library="los-testbed"))

    def add_channel(
        self,
        topic: str,
        type_name: str,
        definition: str,
        metadata: Mapping[str, str] | None = None,
        language: str = "ros2msg",
    ) -> int:
        """Register a topic and return its channel number; a chunk that has begun gets the records, too."""
        known = len(self._schemas)
        schema = next((s for s in self._schemas if s.name == type_name), None)
        if schema is None:
            schema = Schema(id=len(self._schemas) + 1, name=type_name, encoding=language, data=definition.encode())
            self._schemas.append(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=schema.id,
            metadata=dict(metadata or {}),
        )
        self._channels.append(channel)
        if self._blocks:
            self._add_records([*self._schemas[known:], channel])
        self.counts[channel.id] = self._sequences[channel.id] = 0
        return int(channel.id)

    def add_block(
        self,
        channel: int,
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
        messages: NDArray[np.uint8],
        sequences: NDArray[np.int64] | None = None,
    ) -> None:
        """Append messages (n, length) with their times (n,) [ns].

        The sequence numbers of a topic count from 1 unless they are given (n,), increasing: those of a repaired bag.
        """
        n, length = messages.shape
        most = max((MAX_CHUNK - self._chunk_size) // (MESSAGE_HEAD.itemsize + length), 0)
        if n > most and (self._span or most):
            self._append(channel, log_times[:most], publish_times[:most], messages[:most], _part(sequences, 0, most))
            self.flush_chunk()
            rest = log_times[most:], publish_times[most:], messages[most:]
            self.add_block(channel, *rest, _part(sequences, most, n))
            return
        self._append(channel, log_times, publish_times, messages, sequences)

    def _append(
        self,
        channel: int,
        log_times: NDArray[np.int64] | NDArray[np.uint64],
        publish_times: NDArray[np.int64],
        messages: NDArray[np.uint8],
        sequences: NDArray[np.int64] | None,
    ) -> None:
        n, length = messages.shape
        if n == 0:
            return
        self._begin()
        record = np.dtype([("head", MESSAGE_HEAD), ("data", "u1", (length,))])
        rows = np.zeros(n, record)
        head = rows["head"]
        if sequences is None:
            sequences = np.arange(self._sequences[channel] + 1, self._sequences[channel] + n + 1)
        log_times = log_times.astype(np.uint64)  # a damaged bag has times beyond the signed ones, too
        head["op"] = Opcode.MESSAGE
        head["length"] = BODY + length
        head["channel"] = channel
        head["sequence"] = sequences
        head["log"] = log_times
        head["publish"] = publish_times
        rows["data"] = messages
        entries = np.zeros(n, INDEX_ENTRY)
        entries["log"] = log_times
        entries["offset"] = self._chunk_size + record.itemsize * np.arange(n, dtype=np.uint64)
        self._blocks.append(rows.view(np.uint8).reshape(-1))
        self._index.setdefault(channel, []).append(entries)
        self._chunk_size += n * record.itemsize
        self.counts[channel] += n
        self._sequences[channel] = int(sequences[-1])
        self._span += [int(np.min(log_times)), int(np.max(log_times))]
        edges = [0, *(np.flatnonzero(np.diff(sequences) != 1) + 1).tolist(), n]
        for begin, end in pairwise(edges):
            times = (int(log_times[begin]), int(log_times[end - 1]))
            self._runs.append((channel, end - begin, record.itemsize, int(sequences[begin]), *times))

    def _begin(self) -> None:
        """Every chunk begins with all schemas and channels."""
        if not self._blocks:
            self._add_records([*self._schemas, *self._channels])

    def _add_records(self, records: Sequence[McapRecord]) -> None:
        """Append records other than messages to the chunk."""
        for record in records:
            builder = RecordBuilder()
            record.write(builder)
            data = np.frombuffer(builder.end(), np.uint8)
            self._blocks.append(data)
            self._runs.append((0, 1, len(data), 0, 0, 0))
            self._chunk_size += len(data)

    def flush_chunk(self) -> None:
        """Compress what was added since the last chunk and hand it to the operating system."""
        if not self._span:
            return
        content = np.concatenate(self._blocks).tobytes()
        start, end, checksum = min(self._span), max(self._span), zlib.crc32(content)
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=start,
            message_end_time=end,
            uncompressed_crc=checksum,
            uncompressed_size=len(content),
        )
        body = encode_manifest(content, self._runs, checksum)
        self._put(RECORD.pack(OP_MANIFEST, len(body)) + body)
        offset, length = self._write(chunk)
        offsets, index_length = {}, 0
        for channel, entries in self._index.items():
            offsets[channel], size = self._write_index(channel, np.concatenate(entries))
            index_length += size
        self._chunks.append(
            ChunkIndex(
                message_start_time=start,
                message_end_time=end,
                chunk_start_offset=offset,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=index_length,
                compression="zstd",
                compressed_size=len(chunk.data),
                uncompressed_size=len(content),
            )
        )
        self._file.flush()
        self.start_time = start if len(self._chunks) == 1 else min(self.start_time, start)
        self.end_time = max(self.end_time, end)
        self._blocks, self._index, self._chunk_size, self._span, self._runs = [], {}, 0, [], []

    def _write_index(self, channel: int, entries: NDArray[np.void]) -> tuple[int, int]:
        """Message index record (opcode, length, channel, byte length, entries) in one piece."""
        body = channel.to_bytes(2, "little") + entries.nbytes.to_bytes(4, "little") + entries.tobytes()
        offset = self._file.tell()
        self._put(RECORD.pack(Opcode.MESSAGE_INDEX, len(body)) + body)
        return offset, 9 + len(body)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Write a named table of strings."""
        offset, length = self._write(Metadata(name=name, metadata=dict(content)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a whole file into this one."""
        record = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        offset, length = self._write(record)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def finish(self) -> None:
        """Write the summary with all indexes and close the file."""
        self.flush_chunk()
        if not self._chunks:  # channels without a message
            self._begin()
            self._put(np.concatenate(self._blocks).tobytes())
        self._write(DataEnd(data_section_crc=0))
        self._write_summary()
        self._file.write(MAGIC)
        self._file.close()

    def _write_summary(self) -> None:
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self.start_time,
            message_end_time=self.end_time,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        start = self._file.tell()
        builder, offsets = RecordBuilder(), []
        for opcode, records in groups:
            first = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(SummaryOffset(opcode, start + first, builder.count - first))
        offset_start = start + builder.count
        for entry in offsets:
            entry.write(builder)
        chunk_index = builder.end()
        self._put(chunk_index)
        digest = self._digest.digest()
        self._put(last := RECORD.pack(OP_DIGEST, len(digest)) + digest)
        summary = chunk_index + last
        foot = int(Opcode.FOOTER).to_bytes(1, "little") + (20).to_bytes(8, "little")
        foot += start.to_bytes(8, "little") + offset_start.to_bytes(8, "little")
        self._write(
            Footer(
                summary_start=start,
                summary_offset_start=offset_start,
                summary_crc=zlib.crc32(foot, zlib.crc32(summary)),
            )
        )

    def _write(self, record: McapRecord) -> tuple[int, int]:
        """Write a record; its offset and length."""
        builder = RecordBuilder()
        record.write(builder)
        data = builder.end()
        offset = self._file.tell()
        self._put(data)
        return offset, len(data)

    def _put(self, data: bytes) -> None:
        """Write bytes, which the digest of the file covers."""
        self._file.write(data)
        self._digest.update(data)
