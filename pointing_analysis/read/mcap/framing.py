"""Framing of the records of an MCAP file, also with a damaged length or opcode.

A record's content tells its length a second time: strings, tables and data inside it have length fields whose sum it
must be. A header is accepted if this sum agrees, or if a record follows at its end. Otherwise the sum alone is tried,
under the type that the head names and under the others; then the file is searched for the next place where a head and
the content behind it agree. A whole summary at the end of the file (its checksum decides) tells the places of most
records beforehand.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from pointing_analysis.read.mcap.records import (
    BODY,
    MAGIC,
    OP_ATTACHMENT,
    OP_ATTACHMENT_INDEX,
    OP_CHANNEL,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DATA_END,
    OP_FOOTER,
    OP_HEADER,
    OP_INDEX,
    OP_MANIFEST,
    OP_MESSAGE,
    OP_METADATA,
    OP_METADATA_INDEX,
    OP_SCHEMA,
    OP_STATISTICS,
    OP_SUMMARY_OFFSET,
    RECORD,
)

#: content of each record: numbers of bytes, I and Q for data with a length of 4 and of 8 bytes before them
PARTS: Mapping[int, tuple[int | str, ...]] = {
    OP_HEADER: ("I", "I"),
    OP_FOOTER: (20,),
    OP_SCHEMA: (2, "I", "I", "I"),
    OP_CHANNEL: (4, "I", "I", "I"),
    OP_CHUNK: (28, "I", "Q"),
    OP_INDEX: (2, "I"),
    OP_CHUNK_INDEX: (32, "I", 8, "I", 16),
    OP_ATTACHMENT: (16, "I", "I", "Q", 4),
    OP_ATTACHMENT_INDEX: (40, "I", "I"),
    OP_STATISTICS: (42, "I"),
    OP_METADATA: ("I", "I"),
    OP_METADATA_INDEX: (16, "I"),
    OP_SUMMARY_OFFSET: (17,),
    OP_DATA_END: (4,),
    OP_MANIFEST: (36, "I", "I"),
}
IN_DATA = (OP_SCHEMA, OP_CHANNEL, OP_CHUNK, OP_INDEX, OP_ATTACHMENT, OP_METADATA, OP_DATA_END, OP_MANIFEST)
_SEARCHED = np.isin(np.arange(256), (*IN_DATA, OP_MESSAGE))
_WINDOW = 1 << 20
OF_CONTENT = "its content is damaged"
MAX_TRIALS = 200_000  # places that are looked at in one search for a record


@dataclass(frozen=True)
class Frame:
    """A record in the file.

    Attributes
    ----------
    op : its type, the right one where the file's own byte is wrong; 0 where it is not known
    at : its offset [byte]; the content begins 9 bytes later
    length : bytes of content that there are
    whole : False if the file ends inside it
    defect : what is wrong with its head; empty if nothing is
    """

    op: int
    at: int
    length: int
    whole: bool = True
    defect: str = ""

    @property
    def end(self) -> int:
        """Offset of what follows."""
        return self.at + RECORD.size + self.length


class Framing:
    """The records of a file from one offset to another.

    Parameters
    ----------
    stream : the file, seekable
    stop : offset of the end [byte]
    anchors : offset -> (type, length of the content) of records whose place is known from elsewhere
    """

    def __init__(self, stream: BinaryIO, stop: int, anchors: Mapping[int, tuple[int, int]]) -> None:
        self.stream, self.stop, self.anchors = stream, stop, anchors
        # After records were removed, inserted or moved, later offsets are invalid.
        confirmed = [at for at, (op, length) in anchors.items() if self._confirmed(at, op, length)]
        self._places = np.array(sorted(confirmed), dtype=np.int64)
        self.chunked = any(op == OP_CHUNK for op, _ in anchors.values())
        self._trials = 0

    def peek(self, at: int, count: int) -> bytes:
        """Bytes at an offset, not beyond the end."""
        if at >= self.stop:
            return b""
        self.stream.seek(at)
        return self.stream.read(min(count, self.stop - at))

    def frames(self, at: int) -> Iterator[Frame]:
        """The records from `at` on; ends behind the last one that can be found."""
        while at < self.stop:
            i = int(np.searchsorted(self._places, at))
            if i < self._places.size and int(self._places[i]) == at:
                op, length = self.anchors[at]
                agrees = self.peek(at, RECORD.size) == RECORD.pack(op, length)
                frame = Frame(op, at, length, defect="" if agrees else "its header is damaged")
            else:
                frame = self._frame(at, int(self._places[i]) if i < self._places.size else self.stop)
            self.chunked |= frame.op == OP_CHUNK
            yield frame
            at = frame.end

    def _confirmed(self, at: int, op: int, length: int) -> bool:
        """Whether the header or the content of a record agrees with the summary."""
        return self.peek(at, RECORD.size) == RECORD.pack(op, length) or self._agrees(op, at, length, self.stop)

    def _measure(self, op: int, at: int, stop: int) -> int | None:
        """Length of the content of a record at `at` by its inner lengths; None if they lead beyond `stop`."""
        begin = position = at + RECORD.size
        for part in PARTS[op]:
            if isinstance(part, int):
                position += part
                continue
            kind = struct.Struct("<" + part)
            head = self.peek(position, kind.size)
            if len(head) < kind.size:
                return None
            position += kind.size + kind.unpack(head)[0]
            if position > stop:
                return None
        return position - begin if position <= stop else None

    def _agrees(self, op: int, at: int, length: int, stop: int) -> bool:
        return op in PARTS and at + RECORD.size + length <= stop and self._measure(op, at, stop) == length

    def _starts(self, at: int, stop: int) -> bool:
        """Whether a record or the end is at this offset."""
        if at == stop:
            return True
        head = self.peek(at, RECORD.size)
        if len(head) < RECORD.size or at + RECORD.size > stop:
            return head[:8] == MAGIC
        op, length = RECORD.unpack(head)
        if op in PARTS:
            return self._agrees(op, at, length, stop)
        return bool(op == OP_MESSAGE and length >= BODY and at + RECORD.size + length <= stop)

    def _frame(self, at: int, stop: int) -> Frame:
        head = self.peek(at, RECORD.size)
        if len(head) < RECORD.size or head[:8] == MAGIC:
            return Frame(0, at, max(self.stop - at - RECORD.size, 0), False, "" if head[:8] == MAGIC else "cut")
        op, length = RECORD.unpack(head)
        end = at + RECORD.size + length
        if self._agrees(op, at, length, stop):
            return Frame(op, at, length)
        if op == OP_MESSAGE and end == self.stop:  # no end of the data, no checksum: nothing tells that it is whole
            return Frame(op, at, length, False, "cut")
        if op == OP_MESSAGE and not self.chunked and length >= BODY and end <= stop and self._starts(end, stop):
            return Frame(op, at, length)
        if end <= stop:
            for other in IN_DATA:
                if self._agrees(other, at, length, stop):
                    return Frame(other, at, length, defect="its opcode is damaged")
            if self._starts(end, stop):
                right = op >= 0x80 or (op == OP_MESSAGE and length >= BODY)
                return Frame(op if right or op in PARTS else 0, at, length, defect="" if right else OF_CONTENT)
        elif stop == self.stop and op in PARTS and self._measure(op, at, end) == length:
            return Frame(op, at, stop - at - RECORD.size, False, "cut")
        for other in dict.fromkeys((op, *IN_DATA)):
            measured = self._measure(other, at, stop) if other in PARTS else None
            if measured is not None and self._starts(at + RECORD.size + measured, stop):
                return Frame(other, at, measured, defect="its length is damaged")
        following = self._search(at + 1, stop)
        if following is not None:
            known = op in PARTS and following - at >= RECORD.size
            return Frame(op if known else 0, at, following - at - RECORD.size, defect="its header is damaged")
        rest = max(stop - at - RECORD.size, 0)
        if stop < self.stop:
            return Frame(op if op in PARTS else 0, at, rest, defect="its header is damaged")
        return Frame(op, at, rest, False, "cut" if length > rest else OF_CONTENT)

    def _search(self, at: int, stop: int) -> int | None:
        """Next place where a head and its content agree."""
        while at + RECORD.size <= stop:
            data = np.frombuffer(self.peek(at, min(_WINDOW + RECORD.size, stop - at)), np.uint8)
            if data.size < RECORD.size:
                return None
            n = data.size - RECORD.size + 1
            short = ~(data[5 : 5 + n] | data[6 : 6 + n] | data[7 : 7 + n] | data[8 : 8 + n]).astype(bool)
            for i in np.flatnonzero(_SEARCHED[data[:n]] & short).tolist():
                self._trials += 1
                if self._trials > MAX_TRIALS:
                    return None
                op, length = RECORD.unpack(data[i : i + RECORD.size].tobytes())
                if self._agrees(op, at + i, length, stop):
                    return int(at + i)
                if op == OP_MESSAGE and not self.chunked and length >= BODY and self._two_messages(at + i, stop):
                    return int(at + i)
            at += n
        return None

    def _two_messages(self, at: int, stop: int) -> bool:
        """Whether a message is at this offset and a record after it."""
        length = RECORD.unpack(self.peek(at, RECORD.size))[1]
        end = at + RECORD.size + int(length)
        return end < stop and self._starts(end, stop)
