"""Message counts of one pass over a bag: by file and topic, and the ticks covered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pointing_analysis.arrays import IntArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.mcap.bag_loss import TopicLoss
from pointing_analysis.read.mcap.bag_metadata import REMAPPED
from pointing_analysis.read.mcap.records import BODY, HEAD, Block, FileInfo
from pointing_analysis.read.messages.cdr import NS_PER_S, STAMP, STAMP_OFFSET
from pointing_analysis.read.messages.message_types import COLUMNS
from pointing_analysis.read.unsent import OF_EVERY_TICK


class Contents:
    """Messages that were read.

    Attributes
    ----------
    files : messages by topic, of each file
    stamps : first and last stamp [ns] of each topic with stamps
    """

    def __init__(self) -> None:
        self.files: list[Counter[str]] = []
        self.stamps: dict[str, tuple[int, int]] = {}

    def add(self, number: int, info: FileInfo, block: Block) -> None:
        """Count the messages of a block of the file with this number."""
        self.files += [Counter() for _ in range(number + 1 - len(self.files))]
        for channel, rows in block.by_channel(info.channels):
            self.files[number][channel.topic] += int(rows.size)
            stamps = _stamps(block, rows) if channel.schema in COLUMNS and channel.encoding == "cdr" else rows[:0]
            if stamps.size:
                first, last = self.stamps.get(channel.topic, (int(stamps[0]), int(stamps[0])))
                self.stamps[channel.topic] = min(first, int(stamps.min())), max(last, int(stamps.max()))

    @property
    def topics(self) -> Counter[str]:
        """Messages by topic, of all files."""
        return sum(self.files, Counter())

    def covered_ticks(self, parameters: Mapping[str, Any], losses: Sequence[TopicLoss]) -> int | None:
        """Ticks from the first to the last one with samples, those known to be lost counted; None without a rate.

        Parameters
        ----------
        parameters : what the recorder wrote about the run
        losses : what was recorded and cannot be read
        """
        rate, remapped = parameters.get("rate_hz"), parameters.get(REMAPPED)
        if not is_number(rate) or not rate > 0:
            return None
        usual = {str(name): str(key) for key, name in remapped.items()} if isinstance(remapped, dict) else {}
        ends = tuple(f"/{name}" for name in OF_EVERY_TICK)
        lost = max((loss.missing for loss in losses if usual.get(loss.topic, loss.topic).endswith(ends)), default=0)
        spans = [span for topic, span in self.stamps.items() if usual.get(topic, topic).endswith(ends)]
        if not spans:
            return lost
        first, last = min(first for first, _ in spans), max(last for _, last in spans)
        return round((last - first) * rate / NS_PER_S) + 1 + lost


def _stamps(block: Block, rows: IntArray) -> IntArray:
    """Stamps [ns] of messages of a block; those of messages too short for one, and zeros, are left out."""
    whole = rows[block.heads["length"][rows] >= BODY + STAMP_OFFSET + STAMP.size]
    starts = block.offsets[whole] + HEAD + STAMP_OFFSET
    data = np.frombuffer(block.data, np.uint8)[starts[:, None] + np.arange(STAMP.size)]
    found = np.ascontiguousarray(data).view(np.dtype([("s", "<i4"), ("ns", "<u4")])).reshape(-1)
    stamps = found["s"].astype(np.int64) * NS_PER_S + found["ns"]
    return np.asarray(stamps[stamps != 0])
