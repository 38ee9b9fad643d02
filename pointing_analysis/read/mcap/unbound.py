"""Parts of a file that no manifest covers: records outside the chunks, and the summary.

A file without manifests may have all of its messages outside of chunks. In one with manifests whoever altered it has
put them there: none of them is used, and the file contradicts itself. Which of both it is, is known at its end. The
summary is used to find records; where it says something else than the chunks, other readers would be led astray.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from pointing_analysis.read.mcap.framing import Frame
from pointing_analysis.read.mcap.records import OP_CHANNEL, OP_CHUNK, OP_MESSAGE, OP_SCHEMA, Channel, FileInfo
from pointing_analysis.read.mcap.summary import SummarySection

PIECE = 4 << 20
"""Messages outside of chunks are read in pieces of this size [byte]."""


@dataclass
class Unbound:
    """Parts of one file that no manifest covers.

    Attributes
    ----------
    summary : of the file; None without a whole one
    named : channels that the summary names, by number
    bound : whether the file has a manifest
    """

    summary: SummarySection | None
    named: dict[int, Channel]
    bound: bool = False
    _chunks: list[int] = field(default_factory=list)
    _messages: int = 0
    _pieces: list[list[int]] = field(default_factory=list)
    _types: list[int] = field(default_factory=list)

    def add(self, frame: Frame) -> None:
        """Take note of a record of the data: of chunks, and of messages, types and channels outside, the place."""
        if frame.op == OP_CHUNK:
            self._chunks.append(frame.at)
        elif frame.op in (OP_SCHEMA, OP_CHANNEL):
            self._types.append(frame.at)
        elif frame.op == OP_MESSAGE:
            self._messages += 1
            last = self._pieces[-1] if self._pieces else [0, 0]
            if last[1] == frame.at and frame.end - last[0] <= PIECE:
                last[1] = frame.end
            else:
                self._pieces.append([frame.at, frame.end])

    def pieces(self) -> Iterator[tuple[int, int]]:
        """Begin and end of the parts of the file that hold messages; none where manifests bind the others."""
        yield from ((begin, end) for begin, end in self._pieces if not self.bound)

    def contradictions(self, info: FileInfo) -> Iterator[tuple[int, str]]:
        """Offset and sentence of what nothing binds in a file with manifests, at its end."""
        if not self.bound:
            return
        if self._pieces:
            what = f"{self._messages} messages are outside the chunks and in no manifest: excluded"
            yield self._pieces[0][0], what
        if self._types:
            yield self._types[0], "a type or channel is outside the chunks and in no manifest"
        complete = info.digests == info.chunks == info.manifests  # every chunk was read, and is right
        if complete and self.summary is not None:
            for number, channel in self.named.items():
                if (same := info.channels.get(number)) is channel or same != channel:  # the same: no chunk has it
                    yield self.summary.at, f"the summary names channel {number}, which the chunks do not have"
                    break
            if self.summary.chunks and sorted(self.summary.chunks) != self._chunks:
                yield self.summary.at, "the summary does not list each chunk once at its position"
