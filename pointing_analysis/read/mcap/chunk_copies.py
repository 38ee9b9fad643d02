"""The digest of a chunk's content tells a copy of an earlier chunk, and a content that its manifest refutes."""

from __future__ import annotations

import numpy as np

from pointing_analysis.arrays import BoolArray
from pointing_analysis.read.mcap.chunks import Unpacked, block_of
from pointing_analysis.read.mcap.manifest import Manifest
from pointing_analysis.read.mcap.records import FileInfo


def is_refuted(unpacked: Unpacked, manifest: Manifest, indexed: list[bytes]) -> bool:
    """Whether a content that no manifest names is a changed one of the manifest in front of it.

    It is not if the manifest is that of another chunk: none of the messages has a number that it names.

    Parameters
    ----------
    unpacked : the chunk
    manifest : in front of it
    indexed : index records of the chunk
    """
    if not manifest.verified:
        return False
    block = block_of(FileInfo(), unpacked.content, indexed)
    if block is None:
        return False
    channel, sequence = block.heads["channel"], block.heads["sequence"].astype(np.int64)
    return any(
        bool(np.any((channel == number) & (sequence >= first) & (sequence < first + count)))
        for number, count, _, first, _, _ in manifest.runs[manifest.runs["channel"] != 0].tolist()
    )


class ChunkCopies:
    """Messages that a pass over a file has yielded of each content of a chunk."""

    def __init__(self) -> None:
        self._given: dict[bytes, tuple[Manifest | None, BoolArray | None]] = {}

    def new_part(self, unpacked: Unpacked, manifest: Manifest | None) -> tuple[Unpacked, Manifest | None, bool]:
        """Take note of a chunk, and leave out of it what an earlier copy gave.

        Parameters
        ----------
        unpacked : the chunk
        manifest : by which its whole records were found

        Returns
        -------
        unpacked : what is new in it
        manifest : by which that is to be taken apart
        again : whether there was a copy before
        """
        damaged = unpacked.whole is not None and manifest is not None
        digest = manifest.digest if damaged and manifest is not None else unpacked.digest
        if digest not in self._given:
            # a whole chunk leaves nothing for a copy: its manifest, a tenth of its size, is not kept
            self._given[digest] = None if unpacked.whole is None else manifest, unpacked.whole
            return unpacked, manifest, False
        known, read_before = self._given[digest]
        if known is None or read_before is None:
            return Unpacked(b""), None, True
        if not damaged and len(unpacked.content) != known.size:
            return unpacked, manifest, False  # a forged manifest has the digest of this content
        whole = ~read_before if unpacked.whole is None else unpacked.whole & ~read_before
        self._given[digest] = known, read_before | whole
        return Unpacked(unpacked.content, whole, unpacked.reason), known, True
