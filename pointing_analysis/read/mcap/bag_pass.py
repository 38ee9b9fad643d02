"""One pass over the files of a bag: the one way in which every bag is read, of the testbed or of another program.

It yields the messages that a checksum confirms, or that nothing refutes, and then reports the losses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.read import mapped_arrays
from pointing_analysis.read.mcap.bag_files import BagFiles
from pointing_analysis.read.mcap.bag_loss import LossLedger, TopicLoss, contradictions
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, REPAIR_NAME, merged
from pointing_analysis.read.mcap.records import MAX_CHUNK, Block, FileInfo
from pointing_analysis.read.mcap.walk import walk

NANO = 1e9
WHOLE = (0.0, math.inf)
"""The part of a bag that is all of it [s]."""
TRIMMED = 1 << 26
"""Bytes of messages after which free memory is given back to the system."""


def _ends(block: Block) -> tuple[int, int]:
    """First and last log time [ns] of the messages of a block."""
    log = block.heads["log"]
    return int(log.min()), int(log.max())


class BagPass:
    """One pass over a bag.

    Parameters
    ----------
    path : of the bag, for messages
    bag : its files
    max_chunk : largest chunk that is unpacked [byte]
    window : the part that is read [s], counted from the first message by log time
    heads_only : read no messages, and unpack the first chunk of each file alone: enough for topics, metadata,
        attachments

    Attributes
    ----------
    infos : records of each file besides messages, up to the position of the pass
    origin : log time of the first block [ns]; None before it
    """

    def __init__(
        self,
        path: Path,
        bag: BagFiles,
        max_chunk: int = MAX_CHUNK,
        window: tuple[float, float] = WHOLE,
        heads_only: bool = False,
    ) -> None:
        self._path, self._bag, self._max_chunk, self._window = path, bag, max_chunk, window
        self._heads_only = heads_only
        self._ledger = LossLedger()
        self.infos: list[FileInfo] = []
        self.origin: int | None = None

    def blocks(self) -> Iterator[tuple[FileInfo, Block]]:
        """Messages of the files in their order; chunks that lie outside the window by their times are not unpacked.

        Raises
        ------
        BagError
            A file is not MCAP.
        """
        passed = 0
        for file in self._bag.files:
            everything = self._window == WHOLE and not self._heads_only  # else what is damaged is not known
            info = FileInfo(max_chunk=self._max_chunk, compares=everything)
            self.infos.append(info)
            if self.origin is not None:
                info.unpacks = self._in_window
            for block in walk(file, info):
                if self.origin is None:
                    self.origin = _ends(block)[0]
                    info.unpacks = self._in_window
                if self._heads_only:
                    info.unpacks = lambda first, last: False
                    continue
                if block.heads.size and not self._in_window(*_ends(block)):
                    continue  # the first chunk, which is read for the origin
                self._ledger.add(info, block)
                passed += len(block.data)
                yield info, block
                if passed >= TRIMMED:
                    passed = 0
                    mapped_arrays.trim()

    def seconds(self, block: Block) -> FloatArray:
        """Log times (n,) of the messages of a block [s], counted from the first message of the bag."""
        assert self.origin is not None
        return np.asarray((block.heads["log"].astype(np.int64) - self.origin) / NANO)

    def _in_window(self, first: int, last: int) -> bool:
        """Whether a chunk between two log times [ns] can hold something of the part that was asked for."""
        start, stop = self._window
        assert self.origin is not None
        return self._window == WHOLE or (last >= self.origin + start * NANO and first < self.origin + stop * NANO)

    @property
    def cut(self) -> bool:
        """Whether a file has no end of its data, or had none when it was repaired."""
        repaired, _ = merged(self.infos, REPAIR_NAME)
        return not all(info.finished for info in self.infos) or repaired.get("finished") == "false"

    def losses(self) -> tuple[TopicLoss, ...]:
        """Losses of the bag, or inside a part of it; empty without requested messages."""
        if self._heads_only:
            return ()
        if self._window == WHOLE:
            return self._ledger.losses(self.infos, self._bag.counts)
        return self._ledger.inner_losses(self.infos)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Records with a valid checksum that contradict the digests of the files."""
        return contradictions(self.infos)

    def problems(self) -> list[str]:
        """Defects of the files and what they lack, one sentence each, each once."""
        losses = self.losses()
        sentences = [*self._bag.problems, *(problem for info in self.infos for problem in info.problems)]
        sentences += [str(loss) for loss in losses]
        if losses or any(info.damage or not info.finished for info in self.infos):
            sentences.append(f"`los-testbed bag repair {self._path}` makes a new bag of all readable data")
        sentences += merged(self.infos, METADATA_NAME)[1]
        repaired, _ = merged(self.infos, REPAIR_NAME)
        if repaired:
            sentences.append(f"repaired from {repaired.get('source', 'another bag')}")
        sentences += [text for key, text in repaired.items() if key.startswith("note_")]
        return list(dict.fromkeys(sentences))
