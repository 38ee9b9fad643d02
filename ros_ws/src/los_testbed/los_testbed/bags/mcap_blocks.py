"""MCAP files written in blocks: many messages of one topic at a time, one chunk per second.

The records themselves are those of the `mcap` package; only the message records and their index, which
at 8 000 a second would cost more than the control loop, are laid out with numpy. A chunk is compressed
with zstd and carries a checksum of its content.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
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

MAGIC = b"\x89MCAP0\r\n"
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


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
        self._new: list[McapRecord] = []
        self._blocks: list[NDArray[np.uint8]] = []
        self._index: dict[int, list[NDArray[np.void]]] = {}
        self._chunk_size = 0
        self._span: list[int] = []
        self.counts: dict[int, int] = {}
        self.start_time = 0
        self.end_time = 0
        self._file.write(MAGIC)
        self._write(Header(profile=profile, library="los-testbed"))

    def add_channel(
        self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Register a topic and return its channel number."""
        schema = next((s for s in self._schemas if s.name == type_name), None)
        if schema is None:
            schema = Schema(id=len(self._schemas) + 1, name=type_name, encoding="ros2msg", data=definition.encode())
            self._schemas.append(schema)
            self._new.append(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=schema.id,
            metadata=dict(metadata or {}),
        )
        self._channels.append(channel)
        self._new.append(channel)
        self.counts[channel.id] = 0
        return int(channel.id)

    def add_block(
        self,
        channel: int,
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
        messages: NDArray[np.uint8],
    ) -> None:
        """Append messages (n, length) with their times (n,) [ns]; sequence numbers count from 1."""
        n, length = messages.shape
        if n == 0:
            return
        self._begin()
        record = np.dtype([("head", _HEAD), ("data", "u1", (length,))])
        rows = np.zeros(n, record)
        head = rows["head"]
        head["opcode"] = Opcode.MESSAGE
        head["length"] = _HEAD.itemsize - 9 + length
        head["channel"] = channel
        head["sequence"] = np.arange(self.counts[channel] + 1, self.counts[channel] + n + 1)
        head["log_time"] = log_times
        head["publish_time"] = publish_times
        rows["data"] = messages
        entries = np.zeros(n, _INDEX_ENTRY)
        entries["log_time"] = log_times
        entries["offset"] = self._chunk_size + record.itemsize * np.arange(n, dtype=np.uint64)
        self._blocks.append(rows.view(np.uint8).reshape(-1))
        self._index.setdefault(channel, []).append(entries)
        self._chunk_size += n * record.itemsize
        self.counts[channel] += n
        self._span += [int(np.min(log_times)), int(np.max(log_times))]

    def _begin(self) -> None:
        """Schemas and channels go into the first chunk after they were registered."""
        if self._new:
            builder = RecordBuilder()
            for record in self._new:
                record.write(builder)
            self._new.clear()
            head = np.frombuffer(builder.end(), np.uint8)
            self._blocks.append(head)
            self._chunk_size += len(head)

    def flush_chunk(self) -> None:
        """Compress what was added since the last chunk and hand it to the operating system."""
        if not self._span:
            return
        content = np.concatenate(self._blocks).tobytes()
        start, end = min(self._span), max(self._span)
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=start,
            message_end_time=end,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
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
        self._blocks, self._index, self._chunk_size, self._span = [], {}, 0, []

    def _write_index(self, channel: int, entries: NDArray[np.void]) -> tuple[int, int]:
        """Message index record (opcode, length, channel, byte length, entries) in one piece."""
        body = channel.to_bytes(2, "little") + entries.nbytes.to_bytes(4, "little") + entries.tobytes()
        offset = self._file.tell()
        self._file.write(bytes([Opcode.MESSAGE_INDEX]) + len(body).to_bytes(8, "little") + body)
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
        self._begin()
        if not self._span and self._blocks:  # channels without a message
            self._file.write(np.concatenate(self._blocks).tobytes())
        self.flush_chunk()
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
        summary = builder.end()
        foot = int(Opcode.FOOTER).to_bytes(1, "little") + (20).to_bytes(8, "little")
        foot += start.to_bytes(8, "little") + offset_start.to_bytes(8, "little")
        self._file.write(summary)
        self._write(
            Footer(
                summary_start=start,
                summary_offset_start=offset_start,
                summary_crc=zlib.crc32(foot, zlib.crc32(summary)),
            )
        )

    def _write(self, record: McapRecord) -> tuple[int, int]:
        builder = RecordBuilder()
        record.write(builder)
        data = builder.end()
        offset = self._file.tell()
        self._file.write(data)
        return offset, len(data)
