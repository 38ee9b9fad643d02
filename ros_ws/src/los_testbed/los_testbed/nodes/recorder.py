"""Recorder node: every topic of the table, as bytes, into a bag."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from los_testbed.bags.cdr import Codec, CodecError, codec_for, stamp_of
from los_testbed.bags.metadata import METADATA_NAME, attachments, final_metadata, run_metadata
from los_testbed.bags.writer import BagWriter, check_new_bag
from los_testbed.factories import run_start
from los_testbed.loop.health import OK, STALE, WARN
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.raw_topics import RawPublisher, RawSubscription
from los_testbed.topics import DIAGNOSTICS_TOPIC, PROGRESS_TOPIC, TOPICS
from pointing_analysis.cdr import ENCAPSULATION, Encoder
from pointing_analysis.message_types import HEADER
from titop_plant.interface import TICK_NS

DEPTH = 5000
PERIOD_S = 0.01
QUIET_S = 0.2
CHUNK_S = 1.0
MAX_DISORDER = 1000
"""Periods that a sample may come after a later one and still count."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node("recorder", arguments, lambda context: Recorder(context).run())


def default_bag() -> Path:
    """New name under bags/ of the working directory."""
    return Path("bags") / datetime.now().strftime("run-%Y%m%d-%H%M%S")


class Track:
    """What came on one topic since the last chunk, and what is known of it altogether."""

    def __init__(self, path: str, subscription: RawSubscription, period_ns: int, codec: Codec | None = None) -> None:
        self.path = path
        self.codec = codec
        self.unreadable = 0
        self._numbers = np.zeros(codec.size if codec else 0)
        self.subscription = subscription
        self.period_ns = period_ns
        self.data: list[bytes] = []
        self.received: list[int] = []
        self.sent: list[int] = []
        self.held = False
        self.first = 0
        self.last = 0
        self.distinct = 0
        self._missing: set[int] = set()

    def drain(self) -> int:
        """Take everything that waits; the number of samples taken."""
        take, before = self.subscription.take, len(self.data)
        data, received, sent = self.data.append, self.received.append, self.sent.append
        while (taken := take()) is not None:
            message, times = taken
            if not self._readable(message):
                continue
            if len(message) >= 12 and stamp_of(message) == HOLD_STAMP and self.period_ns:
                self.held = True
                continue
            self.held = False
            data(message)
            received(times["received_timestamp"])
            sent(times["source_timestamp"])
        if len(self.data) > before and self.period_ns:
            self._note(self.data[before:])
        return len(self.data) - before

    def _readable(self, message: bytes) -> bool:
        """A message cut short would make the bag unreadable for others; it is counted instead."""
        if self.codec is None or (len(message) == self.codec.length and message[:2] == ENCAPSULATION[:2]):
            return True
        try:
            self.codec.decode(message, self._numbers)
        except CodecError:
            self.unreadable += 1
            return False
        return True

    def _note(self, messages: list[bytes]) -> None:
        for message in messages:
            stamp = stamp_of(message) if len(message) >= 12 else 0
            if stamp <= 0 or stamp % self.period_ns:
                continue
            if stamp > self.last:
                if self.last and stamp - self.last > self.period_ns:
                    self._note_gap(stamp)
                self.first = self.first or stamp
                self.last = stamp
                self.distinct += 1
            elif stamp in self._missing:  # out of order, not lost
                self._missing.remove(stamp)
                self.distinct += 1

    def _note_gap(self, stamp: int) -> None:
        """The periods between the last sample and this one may still come, out of order."""
        oldest = stamp - MAX_DISORDER * self.period_ns
        self._missing = {old for old in self._missing if old > oldest}
        self._missing.update(range(max(self.last + self.period_ns, oldest), stamp, self.period_ns))

    def begin_again(self) -> None:
        """Another run begins: what is known of the last one is forgotten."""
        self.first = self.last = self.distinct = self.unreadable = 0
        self._missing.clear()

    def lost(self, first: int, last: int) -> int:
        """Samples that should lie in this span of stamps and did not come."""
        expected = last // self.period_ns - (first - 1) // self.period_ns
        return max(0, expected - self.distinct)


class Recorder:
    """Loop of the recorder: every 10 ms take what came, once a second write a chunk."""

    def __init__(self, context: NodeContext) -> None:
        config, node = context.config, context.node
        self.context = context
        self.path = Path(config.output) if config.output else default_bag()
        check_new_bag(self.path)
        self._base = self.path
        self.start = run_start(config)
        self._reported: dict[str, int] = {}
        frame_ns = config.frame_ticks * TICK_NS
        self.tracks = [
            Track(
                topic.path,
                RawSubscription(node, topic.name, topic.type_name, DEPTH),
                frame_ns if topic.rate == "camera" else TICK_NS,
                codec_for(topic),
            )
            for topic in TOPICS
        ]
        self._from_plant = [track for track, topic in zip(self.tracks, TOPICS) if topic.publisher == "plant"]
        self.diagnostics = Track(DIAGNOSTICS_TOPIC, RawSubscription(node, DIAGNOSTICS_TOPIC, DiagnosticArray), 0)
        self.progress = RawPublisher(node, PROGRESS_TOPIC, HEADER)
        self._header = Encoder(HEADER, 0, "")
        self.simulated = config.mode == "lockstep"
        self.bag: BagWriter | None = None
        self.finished = 0
        self.statistics: dict[str, dict[str, str]] = {}

    def run(self) -> int:
        """Record until a signal comes and the topics are quiet."""
        context = self.context
        context.become_real_time()
        context.event("ready")
        quiet_since, next_chunk, next_service = 0.0, time.monotonic() + CHUNK_S, 0.0
        while True:
            count = sum(track.drain() for track in self.tracks)
            count += self.diagnostics.drain()
            now = time.monotonic()
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

    def _tell_progress(self) -> None:
        """Stamp of the newest tick that is here of every topic; zero while the plant holds."""
        ticks = [track.last for track in self.tracks if track.period_ns == TICK_NS]
        if any(ticks):
            stamp = min(ticks)
            if not self.simulated:
                return
        elif all(track.held for track in self.tracks):
            stamp = HOLD_STAMP
        else:
            return
        self.progress.publish(self._header.encode(stamp))

    def _another_run(self) -> bool:
        """Whether the plant holds after a run: it was started again, and what comes now is another run.

        One topic is not enough: a message with stamp zero from a foreign publisher must not end the bag.
        """
        return any(track.first for track in self.tracks) and all(track.held for track in self._from_plant)

    def _begin_again(self) -> None:
        """Close the bag of the run that broke off; the next one gets a name of its own."""
        self._write_chunk()
        self._finish_bag()
        self.finished += 1
        self.context.event("bag", path=str(self.path))
        self.path = _free_name(self._base)
        self.bag, self.statistics = None, {}
        for track in self.tracks:
            track.begin_again()

    def _write_chunk(self) -> None:
        if self.bag is None:
            if not any(track.data for track in self.tracks):
                return
            config = self.context.config
            self.bag = BagWriter(
                self.path,
                {METADATA_NAME: run_metadata(config, self.start)},
                attachments(config, self.start),
                diagnostics=not self.simulated,
            )
        for track in self.tracks:
            self._write(self.bag, track)
        self._keep_statistics()
        if not self.simulated:  # values of the wall clock would make two equal runs differ
            self._write(self.bag, self.diagnostics)
        self.diagnostics.data, self.diagnostics.received, self.diagnostics.sent = [], [], []
        self.bag.end_chunk()

    def _write(self, bag: BagWriter, track: Track) -> None:
        """Messages of equal length go in one block."""
        if not track.data:
            return
        sizes = np.array([len(message) for message in track.data])
        log, sent = np.array(track.received, np.int64), np.array(track.sent, np.int64)
        if self.simulated:
            log = sent = np.array([stamp_of(message) for message in track.data], np.int64)
        for start, stop in _runs(sizes):
            block = np.frombuffer(b"".join(track.data[start:stop]), np.uint8).reshape(stop - start, -1)
            bag.write(track.path, log[start:stop], sent[start:stop], block)
        track.data, track.received, track.sent = [], [], []

    def _keep_statistics(self) -> None:
        """Last word of each node; it goes into the metadata at the end."""
        for message in self.diagnostics.data:
            for status in deserialize_message(message, DiagnosticArray).status:
                name = status.name.partition(": ")[2]
                self.statistics[name] = {entry.key: entry.value for entry in status.values}

    def own_statistics(self) -> dict[str, str]:
        """Messages and losses so far."""
        started = [track for track in self.tracks if track.first]
        first = min((track.first for track in started), default=0)
        last = max((track.last for track in started), default=0)
        lost = {t.path: t.lost(first, last) for t in self.tracks} if started else {}
        return {
            "messages": str(sum(track.distinct for track in self.tracks)),
            "samples_lost": str(sum(lost.values())),
            **{f"unreadable_{t.path}": str(t.unreadable) for t in self.tracks if t.unreadable},
            **{f"lost_{name}": str(count) for name, count in lost.items() if count},
        }

    def _report(self) -> None:
        values = self.own_statistics()
        news = {name: int(values[name]) - self._reported.get(name, 0) for name in ("messages", "samples_lost")}
        self._reported = {name: int(values[name]) for name in news}
        self.context.plot(dict(news))
        if self.bag is None:
            level, message = STALE, "no samples yet"
        else:
            level, message = (OK, "recording") if values["samples_lost"] == "0" else (WARN, "samples lost")
        self.context.diagnose(level, message, values, self.tracks[0].last)

    def _finish_bag(self) -> None:
        """Results into the head of the bag, and its index."""
        if self.bag is not None:
            final = {**self.statistics, "recorder": self.own_statistics()}
            self.bag.close({METADATA_NAME: final_metadata(self.context.config, final, self.start)})

    def _close(self) -> None:
        self._write_chunk()
        self._finish_bag()
        path = str(self.path) if self.bag is not None else None
        self.context.event("done", statistics=self.own_statistics(), bag=path, nodes=self.statistics)
        if self.bag is None and not self.finished:
            raise ValueError("a plant must run on this domain, got no message to record")


def _free_name(base: Path) -> Path:
    """Name of another bag beside `base`."""
    return next(path for n in itertools.count(2) if not (path := base.with_name(f"{base.name}-{n}")).exists())


def _runs(sizes: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Stretches of equal sizes."""
    cuts = np.flatnonzero(np.diff(sizes)) + 1
    edges = [0, *cuts.tolist(), len(sizes)]
    return list(itertools.pairwise(edges))


if __name__ == "__main__":
    sys.exit(main())
