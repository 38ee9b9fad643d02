"""One pass over an MCAP file: the one way in which reader, analysis, report, replay and repair get its messages.

Complete, truncated and damaged files: `framing` finds the records, `chunks` decides by
checksums what of a chunk is right, and every defect is noted in `FileInfo`.
"""

from __future__ import annotations

import os
import struct
import tempfile
from collections.abc import Iterator
from typing import BinaryIO

import zstandard

from pointing_analysis.read.mcap.bag_metadata import HASH, has_right_hash
from pointing_analysis.read.mcap.chunk_copies import ChunkCopies, is_refuted
from pointing_analysis.read.mcap.chunks import (
    ZSTD,
    Unpacked,
    block_of,
    followed_by_records,
    index_agrees,
    index_times,
    take_apart,
    unpack,
    unpack_messages,
    whole_records,
)
from pointing_analysis.read.mcap.file_digest import OTHER_DIGEST, digest_before
from pointing_analysis.read.mcap.framing import Frame, Framing
from pointing_analysis.read.mcap.manifest import Manifest, decode_manifest, salvage
from pointing_analysis.read.mcap.records import (
    MAGIC,
    OP_ATTACHMENT,
    OP_CHANNEL,
    OP_CHUNK,
    OP_DATA_END,
    OP_FOOTER,
    OP_INDEX,
    OP_MANIFEST,
    OP_MESSAGE,
    OP_METADATA,
    OP_SCHEMA,
    OP_STATISTICS,
    OTHER_FORMATS,
    RECORD,
    SIDE_RECORDS,
    BagError,
    Block,
    FileInfo,
    read_side_record,
    with_article,
)
from pointing_analysis.read.mcap.summary import SummarySection, checksum_before, may_lack_summary, read_summary
from pointing_analysis.read.mcap.unbound import Unbound

MAX_RATIO, MAX_SPARE = 100, 1 << 30
"""A file compressed as a whole, or all chunks of one, may unpack to so many times its size, and so many bytes more."""


class _Walk:
    """State of one pass over one file."""

    def __init__(self, stream: BinaryIO, info: FileInfo, where: str) -> None:
        self.stream, self.info, self.where = stream, info, where
        self.manifest: Manifest | None = None
        self.chunk: tuple[Frame, bytes] | None = None
        self.indexed: list[bytes] = []
        self.copies = ChunkCopies()
        self.manifests: dict[bytes, Frame] | None = None
        self.damaged = False  # since the last whole manifest: that of the next chunk may be gone
        size = stream.seek(0, os.SEEK_END)
        self.left = MAX_RATIO * size + MAX_SPARE  # bytes that chunks may still unpack to
        summary = read_summary(stream, info, where)
        self.summary = summary or SummarySection()
        self.unbound = Unbound(summary, dict(info.channels))
        self.framing = Framing(stream, size, self.summary.anchors)

    def blocks(self) -> Iterator[Block]:
        """The messages of the file, in its order."""
        cut = False
        for frame in self.framing.frames(len(MAGIC)):
            if frame.op == OP_INDEX and self.chunk is not None:
                if frame.whole and frame.length <= self.info.max_chunk:
                    self.indexed.append(self._body(frame))
                self._defect(frame)
                continue
            yield from self._flush_chunk(followed=bool(frame.op) and not frame.defect)
            if not frame.whole and not frame.op and not frame.defect:
                cut = True  # the magic number at the end, or fewer bytes than a record has
                break
            if frame.op == OP_DATA_END and frame.defect and frame.end >= self.framing.stop:
                cut = True  # a few bytes of another record at the end of the file
                break
            if frame.op == OP_DATA_END or (frame.op == OP_FOOTER and frame.whole):
                if self._data_after(frame):
                    self.info.note(self.where, frame.at, "the end-of-data record precedes data")
                    continue
                self.info.finished = True
                self._check_data(frame)
                self._side_records_after(frame.end)
                self._data_records_after(frame.end)
                break
            self._defect(frame)
            if not frame.whole:
                what = f"{self.where}: the file ends inside {with_article(frame.op)}"
                self.info.problems.append(f"{what}: the recording is truncated")
                if frame.op == OP_CHUNK and 40 < frame.length <= self.info.max_chunk:
                    self.chunk = (frame, self._body(frame))
                    yield from self._flush_chunk()
                break
            self.damaged |= frame.op != OP_CHUNK and (bool(frame.defect) or frame.length > self.info.max_chunk)
            self._record(frame)
        else:
            cut = True
        if cut:
            self.info.problems.append(f"{self.where}: the file has no end-of-data record: the recording is truncated")
        yield from self._flush_chunk()
        # Messages outside of chunks; in a file with manifests a contradiction, as all that nothing there binds
        for at, what in self.unbound.contradictions(self.info):
            self.info.contradict(self.where, at, what)
        for begin, end in self.unbound.pieces():
            block = block_of(self.info, self.framing.peek(begin, end - begin), [], self.where)
            if block is not None:
                self.info.unchecked += len(block.heads)
                yield block
        self._compare_digest()

    def _body(self, frame: Frame) -> bytes:
        self.stream.seek(frame.at + RECORD.size)
        return self.stream.read(max(frame.length, 0))  # fewer bytes than a head, in front of a record: below zero

    def _defect(self, frame: Frame) -> None:
        if frame.defect and frame.whole:
            self.info.note(self.where, frame.at, f"{with_article(frame.op)}: {frame.defect}")

    def _record(self, frame: Frame) -> None:
        op = frame.op
        if not op and ZSTD in self.framing.peek(frame.at, min(96, frame.end - frame.at)):
            op = OP_CHUNK  # compressed data under a head that is not readable
        if op != OP_MESSAGE or frame.length <= self.info.max_chunk:
            self.unbound.add(frame)
        if op == OP_CHUNK:
            first, last = self._times(frame)
            if self.info.unpacks(first, last):
                if frame.length > self.info.max_chunk:
                    reason = f"a chunk of {frame.length / 1e6:.0f} MB is larger than the limit of "
                    self._lost(frame, f"{reason}{self.info.max_chunk / 1e6:g} MB (--max-chunk)")
                self.chunk = (frame, self._body(frame) if frame.length <= self.info.max_chunk else b"")
            self.manifest = None if self.chunk is None else self.manifest
        elif op == OP_MANIFEST:
            self.manifest = self._manifest_at(frame)
            self.unbound.bound |= self.manifest is not None
            self.damaged = self.manifest is None or not self.manifest.verified
            if self.manifest is not None and self.manifest.verified:
                self.info.expect(self.manifest.runs)
                self.info.manifests += 1
            if (self.manifest is None or self.manifest.damaged) and not frame.defect:
                self.info.note(self.where, frame.at, "the manifest of a chunk is damaged")
        elif op in SIDE_RECORDS and op != OP_STATISTICS and frame.length <= self.info.max_chunk:
            read_side_record(self.info, op, self._body(frame), self.where, frame.at)

    def _times(self, frame: Frame) -> tuple[int, int]:
        if frame.at in self.summary.times:
            return self.summary.times[frame.at]
        head = self.framing.peek(frame.at + RECORD.size, 16)
        return struct.unpack("<QQ", head) if len(head) == 16 else (0, 0)  # type: ignore[return-value]

    def _lost(self, frame: Frame, reason: str) -> None:
        self.info.note(self.where, frame.at, reason)
        self.info.lost_chunks.append(index_times(self.indexed))

    def _flush_chunk(self, followed: bool = False) -> Iterator[Block]:
        """Messages of the chunk whose index records have been read by now; `followed`: another record is behind it."""
        if self.chunk is None:
            return
        (frame, body), indexed, manifest = self.chunk, self.indexed, self.manifest
        if body:
            block = self._content(frame, body, indexed, manifest, followed or bool(indexed))
            if block is not None:
                yield block
        self.chunk, self.manifest, self.indexed = None, None, []

    def _content(
        self, frame: Frame, body: bytes, indexed: list[bytes], manifest: Manifest | None, followed: bool
    ) -> Block | None:
        cut = not frame.whole and frame.defect == "cut"
        try:
            packed = take_apart(body, cut)
        except BagError as error:
            raise BagError(f"{self.where}, byte {frame.at}: {error}") from None
        if packed is None:
            self._lost(frame, "the header of a chunk is damaged; it is excluded")
            return None
        limit = min(self.info.max_chunk, self.left)
        chunk = unpack(packed, manifest, limit, cut, lambda digest: digest in self._named())
        self.left -= len(chunk.content)
        if chunk.corrected and not cut:
            self.info.note(self.where, frame.at, "a chunk is damaged, and corrected by its checksums")
        if self.left < self.info.max_chunk and "(--max-chunk)" in chunk.reason:
            self.left = 0
            chunk = Unpacked(b"", None, f"the chunks of the file unpack to more than {MAX_RATIO} times its size")
        checked = chunk.content and chunk.whole is None and not chunk.reason
        self.info.chunks += 1
        if checked:
            named_by = self._manifest_of(chunk, manifest)
            self.info.digests += named_by is not None and named_by is manifest
            if named_by is None and manifest is not None and is_refuted(chunk, manifest, indexed):
                what = "a chunk does not match the digest in its manifest: only matching parts are used"
                self.info.contradict(self.where, frame.at, what)
                chunk = Unpacked(*salvage(chunk.content, manifest))
            elif named_by is None and self._named() and not self.damaged:
                what = "no manifest lists the content of this chunk: it is excluded"
                self.info.contradict(self.where, frame.at, what)
                return None
            manifest = named_by or manifest
        again = False
        if chunk.content:
            chunk, manifest, again = self.copies.new_part(chunk, manifest)
        if again:
            self.info.note(self.where, frame.at, "a chunk is in the file twice: its messages count once")
        elif chunk.reason and not cut:
            self._lost(frame, chunk.reason)
        if chunk.content and manifest is not None and (chunk.whole is not None or manifest.names(chunk.digest)):
            block = whole_records(self.info, chunk, manifest, self.where, frame.at)
            if indexed and block is not None and chunk.whole is None and not index_agrees(block, indexed):
                self.info.note(self.where, frame.at, "the index of a chunk is not that of its messages")
            return block
        if not chunk.content:
            return None
        block = block_of(self.info, chunk.content, indexed, self.where, frame.at, len(packed.data))
        self.info.unchecked += 0 if block is None or packed.checksum else len(block.heads)
        if indexed and packed.checksum and checked and block is not None and not index_agrees(block, indexed):
            self.info.note(self.where, frame.at, "the index of a chunk is not that of its messages")
        proved = chunk.proved and (followed or bool(packed.checksum))
        return block if proved or block is None else self._unproved(frame, block)

    def _unproved(self, frame: Frame, block: Block) -> Block | None:
        """Messages of a content without a checksum, counted separately; without the truncated one."""
        kept = followed_by_records(block)
        left, what = len(block.heads) - len(kept.heads), "no checksum covers the messages where the file is truncated"
        self.info.unproved += len(kept.heads)
        self.info.note(self.where, frame.at, f"{what}: {len(kept.heads)} of a chunk are used, {left} excluded")
        return kept if kept.heads.size else None

    def _manifest_at(self, frame: Frame) -> Manifest | None:
        return decode_manifest(self._body(frame)) if frame.length <= self.info.max_chunk else None

    def _manifest_of(self, unpacked: Unpacked, nearest: Manifest | None) -> Manifest | None:
        """The manifest that names a content: the nearest one, or another one of the file; None without any."""
        if nearest is not None and nearest.names(unpacked.digest):
            return nearest
        place = self._named().get(unpacked.digest)
        return None if place is None else self._manifest_at(place)

    def _named(self) -> dict[bytes, Frame]:
        """Digests in all whole manifests of the file; looked for where a content is not what the nearest one names."""
        if self.manifests is None:
            frames = [f for f in self.framing.frames(len(MAGIC)) if f.op == OP_MANIFEST and f.whole]
            manifests = ((self._manifest_at(frame), frame) for frame in frames)
            self.manifests = {m.digest: frame for m, frame in manifests if m is not None and m.verified}
        return self.manifests

    def _check_data(self, end: Frame) -> None:
        """Compare the data with the checksum at their end, which most files leave out."""
        body = self._body(end)
        if end.op == OP_DATA_END and len(body) == 4 and any(body):
            self.info.data_checksum = checksum_before(self.stream, end.at) == int.from_bytes(body, "little")
            if not self.info.data_checksum:
                self.info.note(self.where, end.at, "the checksum of the data does not match")

    def _compare_digest(self) -> None:
        """Compare the bytes up to the footer with the digest there: where nothing is damaged, the file was altered."""
        if not (self.info.compares and self.info.finished and self.info.stated):
            return
        self.info.agrees = digest_before(self.stream, self.summary.digest) == self.info.stated
        tables = [table for records in self.info.metadata.values() for table in records if HASH in table]
        if not self.info.agrees and not self.info.damage and all(map(has_right_hash, tables)):
            self.info.contradict(self.where, self.summary.digest, OTHER_DIGEST)

    def _data_after(self, end: Frame) -> bool:
        """Whether an end of the data is out of place: records follow it that stand in no summary."""
        if self.summary.anchors.get(end.at, (0, 0))[0] == OP_DATA_END:
            return False
        for frame in self.framing.frames(end.end):
            if not frame.whole or frame.op in (OP_DATA_END, OP_FOOTER):
                return False
            if frame.op in (OP_CHUNK, OP_MANIFEST, OP_MESSAGE, OP_METADATA, OP_ATTACHMENT, OP_INDEX):
                return True
        return False

    def _data_records_after(self, at: int) -> None:
        """The summary, and records after the end of the data of a file with manifests: other readers may use both."""
        if self.unbound.summary is None and (self.unbound.bound or not may_lack_summary(self.stream)):
            self.info.note(self.where, at, "the summary is damaged or missing")  # other readers may use it all the same
        for frame in self.framing.frames(at) if self.unbound.bound else ():
            if frame.op in (OP_MESSAGE, OP_CHUNK, OP_MANIFEST, OP_METADATA, OP_ATTACHMENT, OP_INDEX, OP_DATA_END):
                what = f"{with_article(frame.op)} follows the end-of-data record"
                self.info.contradict(self.where, frame.at, what)
                break

    def _side_records_after(self, at: int) -> None:
        """Channels without a message stand only in the summary after the data; nothing verifies a damaged one."""
        if self.summary.anchors:
            return
        known = dict(self.info.channels)
        for frame in self.framing.frames(at):
            if frame.op == OP_FOOTER or not frame.whole:
                break
            if frame.op in (OP_SCHEMA, OP_CHANNEL) and frame.length <= self.info.max_chunk and not frame.defect:
                read_side_record(self.info, frame.op, self._body(frame), self.where, frame.at)
        self.info.channels.update(known)


def _unpacked_file(raw: BinaryIO, size: int, where: str) -> BinaryIO:
    """A file compressed as a whole, unpacked into a nameless temporary one."""
    limit = MAX_RATIO * size + MAX_SPARE
    stream: BinaryIO = tempfile.TemporaryFile()  # type: ignore[assignment]  # noqa: SIM115
    reader, total = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(raw), 0
    try:
        while piece := reader.read(1 << 20):
            total += stream.write(piece)
            if total > limit:
                raise BagError(f"{where}: the file must unpack to at most {limit / 1e9:.1f} GB, got more")
    except zstandard.ZstdError:
        pass  # truncated inside a record, which is reported
    return stream


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
        if where.endswith((".zstd", ".zst")):
            with _unpacked_file(raw, os.fstat(raw.fileno()).st_size, where) as stream:
                yield from _from_start(stream, info, where)
        else:
            yield from _from_start(raw, info, where)


def _from_start(stream: BinaryIO, info: FileInfo, where: str) -> Iterator[Block]:
    stream.seek(0)
    magic = stream.read(len(MAGIC))
    if magic != MAGIC:
        # A wrong byte or two of eight are damage; anything else is another kind of file.
        if len(magic) < len(MAGIC) or sum(a != b for a, b in zip(magic, MAGIC)) > 2:
            raise BagError(
                f"{where}: an MCAP file must begin with {MAGIC!r}, got {OTHER_FORMATS.get(magic, repr(magic))}"
            )
        info.note(where, 0, "the magic number is damaged")
    walk, left_out = _Walk(stream, info, where), 0
    for packed in walk.blocks():
        block, missing = unpack_messages(packed, min(info.max_chunk, walk.left))
        walk.left -= len(block.data) if block is not packed else 0
        left_out += missing
        if block.heads.size:
            yield block
    if left_out:
        what = f"cannot be unpacked, or not within the limit of {info.max_chunk / 1e6:g} MB (--max-chunk)"
        info.problems.append(f"{where}: {left_out} compressed messages {what}: excluded")
