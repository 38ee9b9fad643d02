"""Chunks that stand in a file more than once: a copy is known by its content, and gives no message a second time."""

from __future__ import annotations

from pointing_analysis.arrays import BoolArray
from pointing_analysis.read.mcap.chunks import Unpacked
from pointing_analysis.read.mcap.manifest import Manifest, content_digest


class ChunkCopies:
    """What a pass over a file has given of each content of a chunk."""

    def __init__(self) -> None:
        self._given: dict[bytes, tuple[Manifest | None, BoolArray | None]] = {}

    def new_part(self, found: Unpacked, manifest: Manifest | None) -> tuple[Unpacked, Manifest | None, bool]:
        """Take note of a chunk, and leave out of it what an earlier copy gave.

        Parameters
        ----------
        found : the chunk
        manifest : by which its whole records were found

        Returns
        -------
        found : what is new in it
        manifest : by which that is to be taken apart
        again : whether there was a copy before
        """
        damaged = found.whole is not None and manifest is not None
        digest = manifest.digest if damaged and manifest is not None else content_digest(found.content)
        if digest not in self._given:
            self._given[digest] = manifest, found.whole
            return found, manifest, False
        known, given = self._given[digest]
        if known is None or given is None:
            return Unpacked(b""), None, True
        if not damaged and len(found.content) != known.size:
            return found, manifest, False  # a forged manifest has the digest of this content
        whole = ~given if found.whole is None else found.whole & ~given
        self._given[digest] = known, given | whole
        return Unpacked(found.content, whole, found.reason), known, True
