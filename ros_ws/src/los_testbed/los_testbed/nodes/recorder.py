"""Recorder node: writes every topic of the table, serialised, to a bag."""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from lftkit.errors import InputError
from los_testbed.bags.cdr import stamp_of
from los_testbed.bags.writer import BagWriter, check_new_bag
from los_testbed.config.topics import NODES, PROGRESS_TOPIC, REPORT_DEADLINE_S, UNSENT_TICKS
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.report_watch import ReportWatch
from los_testbed.nodes.support.source_watch import SourceWatch
from los_testbed.nodes.support.track import UNKNOWN_NS, Track, merge, report_tracks, topic_tracks
from los_testbed.nodes.support.transport.raw_topics import RawPublisher
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import AT_REST
from los_testbed.run.bag_names import free_name
from los_testbed.run.identity import DIGEST, announced
from los_testbed.run.loop.health import ERROR, OK, STALE, WARN
from los_testbed.run.loop.scheduling import enlarge_receive_buffers
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.run.metadata import METADATA_NAME, attachments, final_metadata, run_metadata
from los_testbed.run.processes.node_launch import STATISTICS_VARIABLE
from pointing_analysis.read.mcap.bag_metadata import REMAPPED
from pointing_analysis.read.messages.cdr import Encoder
from pointing_analysis.read.messages.message_types import HEADER
from pointing_analysis.read.unsent import UNSENT
from titop_plant.interface import TICK_NS

DEPTH = 5000
PERIOD_S = 0.01
QUIET_S = 0.2
CHUNK_S = 1.0
BUFFER_BYTES = 4 << 20
"""Receive buffer of each socket. The kernel's default of 208 KiB is 30 ms of a run: after such a pause samples are
lost, and retransmitted ones fill the buffer again. The nodes of the loop keep the default: for them a lost sample is
better than a late one."""
LOOK_NS = 20_000_000
"""Time between looks at the publishers of the topics."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node("recorder", arguments, lambda context: Recorder(context).run())


def default_bag() -> Path:
    """New name under bags/ of the working directory."""
    return Path("bags") / datetime.now().strftime("run-%Y%m%d-%H%M%S")


class Recorder:
    """Loop of the recorder: take messages every 10 ms, write a chunk every second."""

    def __init__(self, context: NodeContext) -> None:
        config, node = context.config, context.node
        self.context = context
        self.path = Path(config.output) if config.output else default_bag()
        check_new_bag(self.path)
        self._base = self.path
        self.parts = RunParts(config)
        self._announced = announced(self.parts)
        final_metadata(self.parts, {})  # its imports take most of a second: not at real-time priority
        # at rest there are no states to record; the plant may be another than the telescope, which has no such tone
        self.start = AT_REST if config.start == "rest" else self.parts.start
        self._reported: dict[str, int] = {}
        topics = self.parts.topics
        self.tracks = topic_tracks(context, DEPTH, topics=topics)
        self._from_plant = [track for track, topic in zip(self.tracks, topics) if topic.publisher == "plant"]
        self._sent_as = {t.path: t.subscription.name for t in self.tracks if t.subscription.name != t.path}
        self.reports = report_tracks(context)
        self._late = ReportWatch(node, NODES[:-1]) if config.mode == "realtime" else None
        self.watch = SourceWatch(node, [t.subscription for t in (*self.tracks, *self.reports.values())])
        self._second = ""
        self._next_look = 0
        self._held_since = 0
        self._named = self._moving = False
        self.progress = RawPublisher(node, PROGRESS_TOPIC, HEADER)
        self._header = Encoder(HEADER, 0, "")
        self.simulated = config.mode == "lockstep"
        self.bag: BagWriter | None = None
        self.finished = 0
        self.statistics: dict[str, dict[str, str]] = {}

    def run(self) -> int:
        """Record until a signal comes and the topics are quiet."""
        context = self.context
        enlarge_receive_buffers(BUFFER_BYTES)
        context.become_real_time()
        context.all_listed()
        context.event("ready")
        quiet_since, next_chunk, next_service = 0.0, time.monotonic() + CHUNK_S, 0.0
        while True:
            count = sum(track.drain() for track in self.tracks)
            self._moving |= count > 0
            count += sum(report.drain() for report in self.reports.values())
            self._refuse_others()
            now = time.monotonic()
            self._look()
            if count:
                quiet_since = now
            if self._another_run():
                self._begin_again()
            self._tell_progress()
            if now >= next_chunk or sum(len(track.data) for track in self.tracks) > 20_000:
                next_chunk = now + CHUNK_S
                self._write_chunk()
                self._report()
            if now >= next_service:
                next_service = now + 0.2
                context.service()
            if context.stop and now - quiet_since > QUIET_S:
                break
            time.sleep(PERIOD_S if not self.simulated else PERIOD_S / 4)
        self._close()
        return 0

    def _refuse_others(self) -> None:
        """End where a node announces another plant or law than the settings of this node make: the bag would have them.

        What was recorded until then stays.

        Raises
        ------
        InputError
            A node does.
        """
        for name, report in self.reports.items():
            expected, said = self._announced.get(name, ""), report.statistics.get(DIGEST, "")
            if said and said != expected:
                if self.bag is not None:
                    self._write_chunk()
                    self._finish_bag()
                raise InputError(
                    f"the settings of the recorder must be those of the node {name}, whose digest is {said}, got "
                    f"{expected or 'none'}: give both the same options"
                )

    def _look(self) -> None:
        """Match publishers; report a second one immediately."""
        now = time.monotonic_ns()
        waiting = any(track.waiting for track in (*self.tracks, *self.reports.values()))
        if now < self._next_look and not waiting:
            return
        self._next_look = now + LOOK_NS
        self._look_for_names(now)
        if news := self.watch.look(now):
            self._second = ", ".join(f"{topic} (node {node})" for topic, node in news)
            self.context.report_second_publishers(news)
            self._report()

    def _look_for_names(self, now: int) -> None:
        """While the plant holds: whether the graph knows the node of each publisher, or the time for it has passed.

        The graph learns a node later than its samples arrive, by seconds on a busy machine; a report is only accepted
        from a known node.
        """
        if not all(track.held for track in self.tracks):
            self._held_since, self._named = 0, False
        elif not self._named:
            self._held_since = self._held_since or now
            nodes = [endpoint.node for track in self.tracks for endpoint in track.subscription.endpoints()]
            nodes += [node for report in self.reports.values() for node in report.learn().values()]
            self._named = all(nodes) or now - self._held_since > UNKNOWN_NS

    def _tell_progress(self) -> None:
        """Stamp of the newest tick received on every topic; zero while the plant holds and all nodes are known."""
        ticks = [track.last for track in self.tracks if track.period_ns == TICK_NS]
        if any(ticks):
            stamp = min(ticks)
            if not self.simulated:
                return
        elif self._named and all(track.held for track in self.tracks):
            stamp = HOLD_STAMP
        else:
            return
        self.progress.publish(self._header.encode(stamp))

    def _another_run(self) -> bool:
        """Whether the plant holds after a run: it was restarted, and the next messages are of another run.

        One topic is not enough: a message with stamp zero from a foreign publisher must not end the bag. Those of the
        other nodes do not count: at the start the answer to a tick may be taken before the tick itself, whose topics
        were looked at earlier.
        """
        return any(track.first for track in self._from_plant) and all(track.held for track in self._from_plant)

    def _begin_again(self) -> None:
        """Close the bag of the aborted run; the next one gets another name."""
        self._write_chunk()
        self._finish_bag()
        self.finished += 1
        self.context.event("bag", path=str(self.path))
        self.path = free_name(self._base)
        self.bag, self.statistics = None, {}
        for track in self.tracks:
            track.begin_again()

    def _write_chunk(self) -> None:
        for name, report in self.reports.items():
            if report.statistics:
                self.statistics[name] = report.statistics
        if self.bag is None:
            if not any(track.data for track in self.tracks):
                return
            self.bag = BagWriter(
                self.path,
                {METADATA_NAME: {**run_metadata(self.parts, self.start, self.statistics), **self._remapped()}},
                attachments(self.parts, self.start),
                diagnostics=not self.simulated,
                topics=self.parts.topics,
                sent_as=self._sent_as,
            )
        for track in self.tracks:
            self._write(self.bag, track)
        merged = merge(list(self.reports.values()))
        if not self.simulated:  # values of the wall clock would make two equal runs differ
            self._write(self.bag, merged)
        self.bag.end_chunk()

    def _remapped(self) -> dict[str, str]:
        """Metadata of remapped topics."""
        return {REMAPPED: json.dumps(self._sent_as)} if self._sent_as else {}

    def _write(self, bag: BagWriter, track: Track) -> None:
        """Messages of equal length go in one block."""
        if not track.data:
            return
        sizes = np.array([len(message) for message in track.data])
        log, sent = np.array(track.received, np.int64), np.array(track.sent, np.int64)
        if self.simulated:
            log = sent = np.array([stamp_of(message) for message in track.data], np.int64)
        # Stretches of equal sizes
        cuts = np.flatnonzero(np.diff(sizes)) + 1
        edges = [0, *cuts.tolist(), len(sizes)]
        for start, stop in list(itertools.pairwise(edges)):
            block = np.frombuffer(b"".join(track.data[start:stop]), np.uint8).reshape(stop - start, -1)
            bag.write(self._sent_as.get(track.path, track.path), log[start:stop], sent[start:stop], block)
        track.data, track.received, track.sent = [], [], []

    def own_statistics(self, over: bool = True) -> dict[str, str]:
        """Messages and losses; while the run is not over, those up to the plant's last report on what it has sent."""
        started = [track for track in self.tracks if track.first]
        first = min((track.first for track in started), default=0)
        last = max((track.last for track in started), default=0)
        device = self.context.config.device  # a rig need not know the truth
        known = last if over else max(self.reports["plant"].stamp, last - round(1e9 * REPORT_DEADLINE_S))
        there = [t for t in self.tracks if t.first or not device] if started else []
        missing = dict.fromkeys((t.path for t in self.tracks), 0) | {t.path: t.lost(first, known, over) for t in there}
        unsent = self._unsent(missing, (last - first) // TICK_NS + 1)
        lost = {name: count - unsent.get(name, 0) for name, count in missing.items()}
        unreadable = {t.path: t.unreadable for t in (*self.tracks, *self.reports.values())}
        return {
            "messages": str(sum(track.kept for track in self.tracks)),
            "samples_lost": str(sum(lost.values())),
            **{f"unreadable_{name}": str(count) for name, count in unreadable.items() if count},
            **{f"lost_{name}": str(count) for name, count in lost.items() if count},
            **{f"{UNSENT}{name}": str(count) for name, count in unsent.items() if count},
            **{f"foreign_{t.path}": str(t.foreign) for t in self.reports.values() if t.foreign},
            **self.watch.statistics(),
            **(self._late.statistics() if self._late is not None else {}),
        }

    def _unsent(self, missing: dict[str, int], span: int) -> dict[str, int]:
        """Of the samples that are missing in a span of ticks those that the plant did not send, by topic.

        The plant counts for its whole run: for the part that a restarted recorder has, nothing is known, and missing
        samples count as lost.
        """
        plant = self.statistics.get("plant", {})
        ticks, outside, between = (int(plant.get(n, "0")) for n in ("ticks", UNSENT + "outside", UNSENT + UNSENT_TICKS))
        if ticks - outside > span:
            return {}
        counts = [
            between if track.period_ns == TICK_NS else int(plant.get(UNSENT + topic.name, "0"))
            for track, topic in zip(self.tracks, self.parts.topics)
        ]
        return {name: min(count, most) for (name, count), most in zip(missing.items(), counts)}

    def _report(self) -> None:
        if self._late is not None and self._moving:  # after the last sample no report is due
            self._late.look()
        self._moving = False
        values = self.own_statistics(over=False)
        news = {name: int(values[name]) - self._reported.get(name, 0) for name in ("messages", "samples_lost")}
        self._reported = {name: int(values[name]) for name in news}
        self.context.plot(lambda: dict(news))
        if self._second:
            level, message, self._second = ERROR, f"second publisher on {self._second}", ""
        elif self.bag is None:
            level, message = STALE, "no samples yet"
        else:
            level, message = (OK, "recording") if values["samples_lost"] == "0" else (WARN, "samples lost")
        self.context.diagnose(level, message, lambda: values, self.tracks[0].last)
        self.context.finish_work()

    def _finish_bag(self) -> None:
        """Results into the head of the bag, and its index."""
        if self.bag is not None:
            final = {**self.statistics, "recorder": self.own_statistics()}
            self.bag.close({METADATA_NAME: final_metadata(self.parts, final, self.start)})

    def _take_last_statistics(self) -> None:
        """Statistics that the runner has of each node: they do not depend on lost reports."""
        path = os.environ.get(STATISTICS_VARIABLE, "")
        text = Path(path).read_text() if path else ""
        for name, values in (json.loads(text) if text else {}).items():
            if values:
                self.statistics[name] = {**self.statistics.get(name, {}), **values}

    def _close(self) -> None:
        self._write_chunk()
        self._take_last_statistics()
        self._finish_bag()
        path = str(self.path) if self.bag is not None else None
        self.context.event("done", statistics=self.own_statistics(), bag=path)
        if self.bag is None and not self.finished:
            raise InputError("a plant must run on this domain, got no message before the recorder ended")


if __name__ == "__main__":
    sys.exit(main())
