"""Message counts and times of one pass over a bag: by file and topic, and the ticks covered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pointing_analysis.arrays import IntArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.arrivals import Arrivals, arrivals
from pointing_analysis.read.mapped_arrays import GrowingArray, by_parts
from pointing_analysis.read.mcap.bag_loss import TopicLoss
from pointing_analysis.read.mcap.bag_metadata import REMAPPED
from pointing_analysis.read.mcap.records import BODY, HEAD, BagError, Block, Channel, FileInfo
from pointing_analysis.read.messages.cdr import NS_PER_S, STAMP, STAMP_OFFSET
from pointing_analysis.read.messages.channel_types import channel_types
from pointing_analysis.read.messages.message_types import COLUMNS
from pointing_analysis.read.messages.ros_definitions import HEADER, short_name
from pointing_analysis.read.run_end import run_end
from pointing_analysis.read.unsent import topics_of_every_tick


class Contents:
    """Messages that were read.

    Attributes
    ----------
    files : messages by topic, of each file
    stamps : first and last stamp [ns] of each topic of the testbed's types with stamps
    """

    def __init__(self) -> None:
        self.files: list[Counter[str]] = []
        self.stamps: dict[str, tuple[int, int]] = {}
        self._times: dict[str, tuple[GrowingArray, GrowingArray]] = {}
        self._stamped: dict[Channel, bool] = {}

    def add(self, number: int, info: FileInfo, block: Block) -> None:
        """Count the messages of a block of the file with this number."""
        self.files += [Counter() for _ in range(number + 1 - len(self.files))]
        for channel, rows in block.by_channel(info.channels):
            self.files[number][channel.topic] += int(rows.size)
            stamps = _stamps(block, rows) if self._has_stamps(channel) else np.zeros(rows.size, np.int64)
            logged = block.heads["log"][rows].astype(np.int64)
            if channel.topic not in self._times:
                self._times[channel.topic] = GrowingArray(None, np.int64), GrowingArray(None, np.int64)
            for times, more in zip(self._times[channel.topic], (logged, stamps)):
                times.append(more)
            stamps = stamps[stamps != 0]
            if stamps.size and channel.schema in COLUMNS:
                first, last = self.stamps.get(channel.topic, (int(stamps[0]), int(stamps[0])))
                self.stamps[channel.topic] = min(first, int(stamps.min())), max(last, int(stamps.max()))

    def _has_stamps(self, channel: Channel) -> bool:
        """Whether the messages of a channel begin with a header, by their definition or as a type of the testbed."""
        if channel not in self._stamped:
            try:
                fields = channel_types(channel).get(short_name(channel.schema), ())
                self._stamped[channel] = bool(fields) and fields[0].type == HEADER
            except BagError:
                self._stamped[channel] = channel.schema in COLUMNS and channel.encoding == "cdr"
        return self._stamped[channel]

    def arrivals(self) -> dict[str, Arrivals]:
        """Gaps, stalls and clock steps of each topic; messages without a stamp among others with one are left out.

        To be asked for once, at the end.
        """
        by_topic = {}
        for topic, times in sorted(self._times.items()):
            logged, stamps = (one.array() for one in times)
            stamped = by_parts(lambda part: part != 0, stamps, dtype=bool)
            if stamped.any() and not stamped.all():
                logged, stamps = logged[stamped], stamps[stamped]
            by_topic[topic] = arrivals(logged, stamps) if stamped.any() else arrivals(logged)
        return by_topic

    @property
    def topics(self) -> Counter[str]:
        """Messages by topic, of all files."""
        return sum(self.files, Counter())

    def covered_ticks(self, parameters: Mapping[str, Any], losses: Sequence[TopicLoss]) -> int | None:
        """Ticks from the first to the last one that all topics of the plant have, losses counted; None without a rate.

        Parameters
        ----------
        parameters : what the recorder wrote about the run
        losses : what was recorded and cannot be read
        """
        rate, remapped = parameters.get("rate_hz"), parameters.get(REMAPPED)
        if not is_number(rate) or not rate > 0:
            return None
        usual = {str(name): str(key) for key, name in remapped.items()} if isinstance(remapped, dict) else {}
        ends = tuple(f"/{name}" for name in topics_of_every_tick(parameters))
        lost = max((loss.missing for loss in losses if usual.get(loss.topic, loss.topic).endswith(ends)), default=0)
        spans = [span for topic, span in self.stamps.items() if usual.get(topic, topic).endswith(ends)]
        if not spans:
            return lost
        first, last = max(first for first, _ in spans), min(last for _, last in spans)
        covered, sent = round((last - first) * rate / NS_PER_S) + 1, run_end(parameters).sent
        return max(covered, min(covered + lost, sent)) if sent is not None else covered + lost  # some may lie between


def _stamps(block: Block, rows: IntArray) -> IntArray:
    """Stamps (m,) [ns] of messages of a block; 0 of those too short for one."""
    whole = block.heads["length"][rows] >= BODY + STAMP_OFFSET + STAMP.size
    starts = block.offsets[rows[whole]] + HEAD + STAMP_OFFSET
    data = np.frombuffer(block.data, np.uint8)[starts[:, None] + np.arange(STAMP.size)]
    fields = np.ascontiguousarray(data).view(np.dtype([("s", "<i4"), ("ns", "<u4")])).reshape(-1)
    stamps = np.zeros(rows.size, np.int64)
    stamps[whole] = fields["s"].astype(np.int64) * NS_PER_S + fields["ns"]
    return stamps
