"""Topics of the recorder: messages since the last chunk, and totals of each topic."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from los_testbed.bags.cdr import Codec, CodecError, codec_for, stamp_of
from los_testbed.bags.diagnostics import Status, read_diagnostics
from los_testbed.config.topics import DIAGNOSTICS_TOPIC, NODES, OWN_DIAGNOSTICS, TOPICS, TopicDefinition
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.transport.raw_topics import RawSubscription
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.members import OPEN, OWN, PENDING
from los_testbed.run.loop.source_guard import OURS, UNMATCHED, Stream
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP
from pointing_analysis.read.messages.cdr import ENCAPSULATION
from titop_plant.interface import TICK_NS

MAX_DISORDER = 5000
"""Periods that a sample may come after a later one and still count."""

MAX_WAITING = 5000
"""Messages buffered until their publisher is matched."""

UNKNOWN_NS = 5_000_000_000
"""Time [ns] within which the graph knows the node of a publisher, also on a busy machine."""

MAX_UNKNOWN = 100
"""Reports kept while the graph does not know their publisher's node."""


class Track:
    """Messages of one topic from its matched publisher since the last chunk, and its totals."""

    def __init__(self, path: str, subscription: RawSubscription, period_ns: int, codec: Codec | None = None) -> None:
        self.path = path  # where it is not remapped; the subscription has the name that it is sent under
        self.codec = codec
        self.unreadable = 0
        self._numbers = np.zeros(codec.size if codec else 0)
        self.subscription = subscription
        self.waiting: list[tuple[Stream | None, Taken]] = []
        self.period_ns = period_ns
        self.data: list[bytes] = []
        self.received: list[int] = []
        self.sent: list[int] = []
        self.held = self._stale = False
        self.first = 0
        self.last = 0
        self.kept = 0
        self._missing: set[int] = set()
        self._gone = 0
        """Samples that are missing for too long to come."""

    def drain(self) -> int:
        """Take all waiting messages; the number stored."""
        take, sort, before = self.subscription.take, self.subscription.sort, len(self.data)
        now = time.monotonic_ns()
        self._keep_decided()
        while (taken := take()) is not None:
            source = sort(taken, now)
            if not self._readable(taken[0]):
                continue
            if source == OURS:
                self._keep(taken)
            elif source == UNMATCHED and len(self.waiting) < MAX_WAITING:
                self.waiting.append((self.subscription.guard.latest, taken))
        if len(self.data) > before and self.period_ns:
            self._note(self.data[before:])
        return len(self.data) - before

    def _keep_decided(self) -> None:
        """Messages that came before their publisher was matched."""
        matched = self.subscription.guard.matched
        if self.waiting and matched is not None and any(stream is matched for stream, _ in self.waiting):
            for stream, taken in self.waiting:
                if stream is matched:
                    self._keep(taken)
            self.waiting = []

    def _keep(self, taken: Taken) -> None:
        message = taken.data
        self.held = bool(self.period_ns) and len(message) >= 12 and stamp_of(message) == HOLD_STAMP
        self._stale = self._stale and not self.held
        if not self.held and not self._stale:
            self.kept += 1
            self.data.append(message)
            self.received.append(taken.received)
            self.sent.append(taken.sent)

    def _readable(self, message: bytes) -> bool:
        """A truncated message would make the bag unreadable for other programs; it is counted instead."""
        if self.codec is None or (len(message) == self.codec.length and message[:2] == ENCAPSULATION[:2]):
            return True
        try:
            self.codec.decode(message, self._numbers)
        except CodecError:
            self.unreadable += 1
            return False
        return True

    def _note(self, messages: list[bytes]) -> None:
        """Count samples; stamps may vary by less than half a period, and their clock may drift."""
        for message in messages:
            stamp = stamp_of(message) if len(message) >= 12 else 0
            if stamp <= 0:
                continue
            periods = (stamp - self.last + self.period_ns // 2) // self.period_ns if self.last else 1
            if periods > 0:
                self._note_gap(stamp, periods - 1)
                self.first, self.last = self.first or stamp, stamp
            elif near := [gone for gone in self._missing if 2 * abs(gone - stamp) <= self.period_ns]:
                self._missing.remove(near[0])  # out of order, not lost

    def _note_gap(self, stamp: int, count: int) -> None:
        """So many samples before this one are missing; they may still come, out of order."""
        if not count:
            return
        oldest = stamp - MAX_DISORDER * self.period_ns
        late = {old for old in self._missing if old <= oldest}
        recent = min(count, MAX_DISORDER)
        self._gone += len(late) + count - recent
        self._missing -= late
        self._missing.update(stamp - k * self.period_ns for k in range(1, recent + 1))

    def begin_again(self) -> None:
        """Start of another run: the state of the last one is cleared.

        Messages of a topic before its node holds, too, are still of the last one.
        """
        self._stale = not self.held
        self.first = self.last = self.kept = self.unreadable = self._gone = 0
        self._missing.clear()

    def lost(self, first: int, last: int, over: bool = True) -> int:
        """Samples missing in this span of stamps.

        While the run is not `over`, those of which a later one has come.
        """
        if not self.first:
            return last // self.period_ns - (first - 1) // self.period_ns if over else 0
        missing = self._gone + sum(stamp <= last for stamp in self._missing)
        before = max(min(self.first, last) - first, 0) // self.period_ns
        behind = max(last - self.last, 0) // self.period_ns if over else 0
        return missing + before + behind


class ReportTrack(Track):
    """Diagnostics of one node, on the topic of its own; `status` is the last one.

    The publisher of a report must be in the list of the run or, without one, known to the graph as one of the node's.
    """

    def __init__(self, subscription: RawSubscription) -> None:
        super().__init__(subscription.name, subscription, 0)
        self.status: Status | None = None
        self.stamp = 0
        """Of the last one [ns]."""
        self._refused = 0
        self._undecided: list[tuple[int, str, Taken]] = []
        self._known: set[str] = set()
        subscription.guard.node = subscription.guard.expected

    @property
    def statistics(self) -> dict[str, str]:
        """Values of the last report."""
        return self.status.values if self.status is not None else {}

    @property
    def foreign(self) -> int:
        """Reports that were not of the node."""
        return self._refused + len(self._undecided)

    def drain(self) -> int:
        """Take all waiting messages; the number stored."""
        before, now = len(self.data), time.monotonic_ns()
        while (taken := self.subscription.take()) is not None:
            if self._readable(taken[0]):
                self._undecided.append((now, taken.gid.hex(), taken))
        if self._undecided:
            self._decide(now)
        return len(self.data) - before

    def learn(self) -> dict[str, str]:
        """Query the node of each publisher; publishers of the node stay known after it has left the graph."""
        nodes = {endpoint.gid: endpoint.node for endpoint in self.subscription.endpoints()}
        guard = self.subscription.guard
        for gid, node in nodes.items():
            standing = guard.standing(bytes.fromhex(gid))
            if standing == OWN or (standing == OPEN and node == guard.expected):
                self._known.add(gid)
        return nodes

    def _readable(self, message: bytes) -> bool:
        try:
            read_diagnostics(message)
        except CodecError:
            self.unreadable += 1
            return False
        return True

    def _decide(self, now_ns: int) -> None:
        """Store the reports of the node's publishers; one that the graph does not know yet is buffered."""
        unknown: set[str] = set()
        if any(publisher not in self._known for _, publisher, _ in self._undecided):
            nodes, standing = self.learn(), self.subscription.guard.standing
            for publisher in {publisher for _, publisher, _ in self._undecided} - self._known:
                listed = standing(bytes.fromhex(publisher))
                if listed == OWN:
                    self._known.add(publisher)
                elif listed == PENDING or (listed == OPEN and not nodes.get(publisher)):
                    unknown.add(publisher)
        waiting: list[tuple[int, str, Taken]] = []
        for since, publisher, taken in self._undecided:
            if publisher in self._known:
                self._keep(taken)
                self.status = next(iter(read_diagnostics(taken[0])[1][-1:]), None)
                self.stamp = stamp_of(taken[0])
            elif publisher in unknown and now_ns - since < UNKNOWN_NS and len(waiting) < MAX_UNKNOWN:
                waiting.append((since, publisher, taken))
            else:
                self._refused += 1
        self._undecided = waiting


def topic_tracks(
    context: NodeContext, depth: int, reliable: bool = True, topics: Sequence[TopicDefinition] = TOPICS
) -> list[Track]:
    """A track of each of the topics, in their order; `depth` messages may wait on each."""
    config, rates = context.config, RunParts(context.config).ports.ticks
    return [
        Track(
            topic.path_in(config.namespace),
            RawSubscription(context.node, topic.name, topic.type_name, depth, reliable, topic.publisher),
            topic.every(rates) * TICK_NS,
            codec_for(topic),
        )
        for topic in topics
    ]


def report_tracks(context: NodeContext) -> dict[str, ReportTrack]:
    """Reports of each node, from its own topic: any node may publish /diagnostics."""
    return {
        name: ReportTrack(RawSubscription(context.node, f"{name}/{OWN_DIAGNOSTICS}", DiagnosticArray, publisher=name))
        for name in NODES
    }


def merge(reports: Sequence[Track]) -> Track:
    """The reports of all nodes as one topic, in order of arrival; they are taken from their tracks."""
    merged = Track(DIAGNOSTICS_TOPIC, reports[0].subscription, 0)
    rows = sorted(
        (row for report in reports for row in zip(report.received, report.sent, report.data)), key=lambda row: row[0]
    )
    for received, sent, data in rows:
        merged.received.append(received)
        merged.sent.append(sent)
        merged.data.append(data)
    for report in reports:
        report.data, report.received, report.sent = [], [], []
    return merged
