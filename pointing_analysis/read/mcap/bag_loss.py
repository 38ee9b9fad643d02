"""Missing messages of a bag: topic, position and evidence.

A bag of this testbed numbers the messages of each topic from 1, so that a gap in the numbers is a count; how many there
were at the end is known from the manifests of the chunks, from the summary, or from metadata.yaml. Other bags tell
less: the counts of their summary, and the index records of the chunks that were left out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pointing_analysis.arrays import IntArray
from pointing_analysis.read.mcap.bag_metadata import OWN_LIBRARY, REPAIR_NAME, merged, value_of
from pointing_analysis.read.mcap.records import Block, FileInfo

NANO = 1e9
CONTRADICTIONS, MAX_TOLD = "contradictions", 200
"""Entry in the record of a repair: contradictions in the bag that was repaired, so many at most."""
COVERED = "covered"
"""Entry in the record of a repair: whether digests covered the messages of the bag that was repaired."""
REPEATED = "repeated"
"""Entry in the record of a repair: by topic, messages of the new bag whose number others of it have as well."""
ORIGIN = "origin"
"""Entry in the record of a repair: log time [ns] from which the times of its losses count."""
LAST = "last"
"""Entry in the record of a repair: by topic, log time [ns] of its last message, where that is known."""
ENDS = "ends"
"""Entry in the record of a repair of a bag without such numbers: by topic, what it lost before and after the others."""
MAX_PIECES = 10_000
"""Largest number of gaps listed individually."""


@dataclass(frozen=True)
class Span:
    """Lost messages in succession: between two times [s] after the first message of the bag, and how many."""

    start: float
    stop: float
    messages: int

    def __str__(self) -> str:
        if not np.isfinite(self.stop):
            return f"{self.messages} after {self.start:.3f} s"
        if not np.isfinite(self.start):
            return f"{self.messages} before {self.stop:.3f} s"
        return f"{self.messages} between {self.start:.3f} s and {self.stop:.3f} s"


@dataclass(frozen=True)
class TopicLoss:
    """Missing messages of one topic.

    Attributes
    ----------
    topic : its full name
    recovered : messages that can be read
    missing : messages that were recorded and cannot be read
    before, after : how many of the missing ones came before the first and after the last that can be read
    spans : where they are missing
    unplaced : how many of the missing ones may have been anywhere
    """

    topic: str
    recovered: int
    missing: int
    before: int
    after: int
    spans: tuple[Span, ...]
    unplaced: int = 0

    def ends(self, missing_between: int) -> tuple[int, int]:
        """Messages lost before the first and after the last one that can be read.

        Those of unknown place are counted at the end, unless they are in gaps between the messages that are left.

        Parameters
        ----------
        missing_between : samples missing between the first and the last stamp
        """
        placed = self.missing - self.before - self.after - self.unplaced
        return self.before, self.after + max(self.unplaced - max(missing_between - placed, 0), 0)

    def __str__(self) -> str:
        places = "; ".join(str(span) for span in self.spans[:5])
        more = f"; and {len(self.spans) - 5} more places" if len(self.spans) > 5 else ""
        total = self.recovered + self.missing
        return f"{self.topic}: {self.missing} of {total} recorded messages are lost: {places or 'place unknown'}{more}"


@dataclass
class _Numbers:
    """Sequence numbers of one topic that were read: rows of first and last number, log times of the two [ns].

    ``first`` and ``last`` are the log times of all of them.
    """

    pieces: list[list[int]] = field(default_factory=list)
    count: int = 0
    first: int = 1 << 64
    last: int = -1

    @property
    def incomplete(self) -> bool:
        """Whether there were more pieces than are kept."""
        return len(self.pieces) > MAX_PIECES

    def add(self, sequence: IntArray, log: IntArray) -> None:
        self.count += len(sequence)
        self.first, self.last = min(self.first, int(log.min())), max(self.last, int(log.max()))
        if self.incomplete:
            return
        edges = np.flatnonzero(np.diff(sequence) != 1) + 1
        for begin, end in zip(np.append(0, edges).tolist(), np.append(edges, len(sequence)).tolist()):
            row = [int(sequence[begin]), int(sequence[end - 1]), int(log[begin]), int(log[end - 1])]
            if self.pieces and self.pieces[-1][1] + 1 == row[0]:
                self.pieces[-1][1], self.pieces[-1][3] = row[1], row[3]
            else:
                self.pieces.append(row)


def _numbered(infos: Sequence[FileInfo]) -> bool:
    """Whether the messages are numbered: by the header, or, where that is lost, by manifests, which no other writes."""
    if len(infos) != 1 or ENDS in merged(infos, REPAIR_NAME)[0]:
        return False
    return infos[0].library.startswith(OWN_LIBRARY) or bool(infos[0].expected)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and 0 <= value < 1 << 48


def _is_time(value: object) -> bool:
    """Whether this can be a log time [ns]."""
    return type(value) is int and 0 < value < 1 << 63


def _of_repair(infos: Sequence[FileInfo], name: str) -> dict[str, Any]:
    """A table by topic in the record of a repair."""
    table = value_of(merged(infos, REPAIR_NAME)[0].get(name, "{}"))
    return table if isinstance(table, dict) else {}


def _before_repair(infos: Sequence[FileInfo]) -> dict[str, int]:
    """Messages of each topic that the bag had from which this one was repaired."""
    return {topic: count for topic, count in _of_repair(infos, "expected").items() if _is_count(count)}


def _ends_before_repair(infos: Sequence[FileInfo], topic: str) -> tuple[int, int]:
    """Missing messages of the repaired bag before and after the others, as far as known."""
    ends = _of_repair(infos, ENDS).get(topic, (0, 0))
    if not isinstance(ends, (list, tuple)) or len(ends) != 2 or not all(map(_is_count, ends)):
        return 0, 0
    return ends[0], ends[1]


def _repeated_in_repair(infos: Sequence[FileInfo], topic: str) -> int:
    """Messages that the statistics of a repaired bag count a second time."""
    count = _of_repair(infos, REPEATED).get(topic, 0)
    return count if _is_count(count) else 0


def _last_of(infos: Sequence[FileInfo], topic: str) -> int | None:
    """Log time [ns] of the last message of a topic by the manifests, or by those of the bag that was repaired."""
    times = [
        info.expected[number].last
        for info in infos
        for number, channel in info.channels.items()
        if channel.topic == topic and number in info.expected
    ]
    stated: Any = _of_repair(infos, LAST).get(topic)
    if _is_time(stated):
        times.append(int(stated))
    return max(times, default=None)


def repair_entries(
    infos: Sequence[FileInfo], losses: Sequence[TopicLoss], repeated: Mapping[str, int], origin: int
) -> dict[str, str]:
    """Record of a repair for readers of the new bag: losses, repeated numbers, contradictions."""
    tables: dict[str, object] = {
        ORIGIN: origin,
        LAST: {
            loss.topic: last
            for loss in losses
            if (last := _last_of(infos, loss.topic)) is not None and all(np.isfinite(s.stop) for s in loss.spans[-1:])
        },
        REPEATED: repeated,
        CONTRADICTIONS: contradictions(infos)[:MAX_TOLD],
        "lost": {loss.topic: loss.missing for loss in losses},
        "expected": {loss.topic: loss.missing + loss.recovered for loss in losses},
    }
    if not _numbered(infos):
        tables[ENDS] = {loss.topic: [loss.before, loss.after] for loss in losses}
    return {name: json.dumps(table) for name, table in tables.items()}


def contradictions(infos: Sequence[FileInfo]) -> tuple[str, ...]:
    """Contradictions of digests in the files, or in the bags before their repair."""
    noted = value_of(merged(infos, REPAIR_NAME)[0].get(CONTRADICTIONS, "[]"))
    before = [text for text in noted if isinstance(text, str)] if isinstance(noted, list) else []
    return tuple(dict.fromkeys([*(text for info in infos for text in info.contradictions), *before]))


class LossLedger:
    """Counts the messages read of a bag, to find the missing ones."""

    def __init__(self) -> None:
        self._topics: dict[str, _Numbers] = {}
        self.origin: int | None = None

    def add(self, info: FileInfo, block: Block) -> None:
        """Take note of the messages of a block."""
        if not block.heads.size:
            return
        numbers = block.heads["channel"]
        first = int(block.heads["log"].min())
        self.origin = first if self.origin is None else min(first, self.origin)
        for number in np.unique(numbers).tolist():
            channel = info.channels.get(number)
            if channel is not None:
                rows = block.heads[numbers == number]
                kept = self._topics.setdefault(channel.topic, _Numbers())
                kept.add(rows["sequence"].astype(np.int64), rows["log"].astype(np.int64))

    def origin_of(self, infos: Sequence[FileInfo]) -> int:
        """Log time [ns] from which the times of losses count: of the first message that is known of.

        A repair knew of earlier ones than those it could copy.
        """
        origins = [e.first for info in infos for e in info.expected.values()]
        stated = value_of(merged(infos, REPAIR_NAME)[0].get(ORIGIN, "null"))
        origins += [stated] if _is_time(stated) else []
        return min([*origins, *([self.origin] if self.origin is not None else [])], default=0)

    def losses(self, infos: Sequence[FileInfo], counts: Mapping[str, int]) -> tuple[TopicLoss, ...]:
        """Missing messages by topic; complete topics are omitted.

        Parameters
        ----------
        infos : of the files of the bag
        counts : messages of each topic by metadata.yaml, for files whose own summary is damaged or missing
        """
        origin = self.origin_of(infos)
        # A file whose channels are lost: metadata.yaml names the topics.
        topics = {c.topic: None for info in infos for c in info.channels.values()} | dict.fromkeys(counts)
        of_topics = []
        for topic in topics:
            make = self._by_numbers if _numbered(infos) else self._by_counts
            loss = make(topic, infos, counts, origin)
            if loss is not None and loss.missing > 0:
                of_topics.append(loss)
        return tuple(of_topics)

    def repeated(self, infos: Sequence[FileInfo]) -> dict[str, int]:
        """Messages of each topic whose number was read before, in files that number them."""
        counts = {}
        for topic, numbers in self._topics.items() if _numbered(infos) else ():
            last = distinct = 0
            for begin, end, _, _ in sorted(numbers.pieces):
                distinct += max(end - max(begin - 1, last), 0)
                last = max(last, end)
            if numbers.count > distinct and not numbers.incomplete:
                counts[topic] = numbers.count - distinct
        return counts

    def inner_losses(self, infos: Sequence[FileInfo]) -> tuple[TopicLoss, ...]:
        """Missing messages between those read, for a part of a bag."""
        inner = []
        for loss in self.losses(infos, {}):
            spans = tuple(s for s in loss.spans if np.isfinite([s.start, s.stop]).all())[
                : None if not loss.after else -1
            ]
            if spans:
                missing = sum(span.messages for span in spans)
                inner.append(TopicLoss(loss.topic, self._topics[loss.topic].count, missing, 0, 0, spans))
        return tuple(inner)

    def _by_numbers(
        self, topic: str, infos: Sequence[FileInfo], counts: Mapping[str, int], origin: int
    ) -> TopicLoss | None:
        info = infos[0]
        channels = [number for number, channel in info.channels.items() if channel.topic == topic]
        pieces = sorted(self._topics[topic].pieces) if topic in self._topics else []
        expected = [info.expected[number] for number in channels if number in info.expected]
        total = max([e.last_sequence for e in expected], default=0)
        if channels and info.statistics is not None:  # which name channels by their numbers
            counted = max(info.statistics.get(number, 0) for number in channels)
            total = max(total, counted - _repeated_in_repair(infos, topic))
        elif topic in counts:
            total = max(total, counts[topic] - _repeated_in_repair(infos, topic))
        total = max(total, _before_repair(infos).get(topic, 0))
        if topic in self._topics and self._topics[topic].incomplete:
            count = self._topics[topic].count
            missing = max(total - count, 0)
            return TopicLoss(topic, count, missing, 0, 0, (), missing)
        spans, number, time = [], 0, float("-inf")
        for first, last, log_first, log_last in pieces:
            if first > number + 1:
                spans.append(Span(time, (log_first - origin) / NANO, first - number - 1))
            if last > number:
                number, time = last, (log_last - origin) / NANO
        before = spans[0].messages if spans and not np.isfinite(spans[0].start) else 0
        after = max(total - number, 0)
        if after:
            last_of_all = _last_of(infos, topic)
            stop = math.inf if last_of_all is None or (last_of_all - origin) / NANO <= time else last_of_all - origin
            # Of chunks after those that manifests name no time is known; a repair states that of the last message.
            stated = topic in _of_repair(infos, LAST)
            named = total if stated else max([e.last_sequence for e in expected], default=total)
            until = min(max(named - number, 0), after) if np.isfinite(stop) else 0
            if until:
                spans.append(Span(time, stop / NANO, until))
                time = stop / NANO
            if after > until:
                spans.append(Span(time, math.inf, after - until))
        missing = sum(span.messages for span in spans)
        recovered = max(total, number) - missing
        return TopicLoss(topic, recovered, missing, before, after, tuple(spans))

    def _by_counts(
        self, topic: str, infos: Sequence[FileInfo], counts: Mapping[str, int], origin: int
    ) -> TopicLoss | None:
        read = self._topics.get(topic, _Numbers())
        known = expected = 0
        spans = []
        for info in infos:
            channels = [number for number, channel in info.channels.items() if channel.topic == topic]
            if info.statistics is not None:
                known += 1
                expected += sum(info.statistics.get(number, 0) for number in channels)
            times = [chunk[n] for chunk in info.lost_chunks for n in channels if n in chunk]
            spans += [Span((t[0] - origin) / NANO, (t[-1] - origin) / NANO, int(t.size)) for t in times]
        indexed = sum(span.messages for span in spans)
        total = expected if known == len(infos) else max(counts.get(topic, 0), read.count + indexed)
        missing = max(max(total, _before_repair(infos).get(topic, 0)) - read.count, 0)
        before, after = _ends_before_repair(infos, topic)
        first, last = (read.first - origin) / NANO, (read.last - origin) / NANO
        before = min(before + sum(span.messages for span in spans if span.stop < first), missing)
        after = min(after + sum(span.messages for span in spans if span.start > last), missing - before)
        placed = sum(span.messages for span in spans if span.stop >= first and span.start <= last)
        unplaced = max(missing - before - after - placed, 0)
        return TopicLoss(topic, read.count, missing, before, after, tuple(spans), unplaced)


def digests_cover(infos: Sequence[FileInfo]) -> bool:
    """Whether a digest covers every chunk of messages; those of a repair count where the bag before it had some."""
    repaired, _ = merged(infos, REPAIR_NAME)
    covered = not repaired or repaired.get(COVERED) == "true"
    return covered and all(info.manifests >= info.chunks > 0 for info in infos)
