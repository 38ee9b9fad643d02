"""Open a recorded run: ``Run.open(path)`` gives its topics as numpy arrays.

Reads rosbag2 folders and single files in MCAP, written by this testbed or by ``ros2 bag record``: chunk compression
zstd, lz4 or none, file-wise and message-wise zstd, split and truncated recordings.
"""

from __future__ import annotations

import copy
import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_loss import TopicLoss, digests_cover
from pointing_analysis.read.mcap.bag_metadata import REMAPPED, merged, value_of
from pointing_analysis.read.mcap.bag_pass import WHOLE, BagPass
from pointing_analysis.read.mcap.records import MAX_CHUNK, BagError
from pointing_analysis.read.messages.message_types import COLUMNS, UNITS
from pointing_analysis.read.messages.topic_columns import CAMERA, KNOWN, Column, decode_block
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.run_end import run_end
from pointing_analysis.read.topic import NANO, Topic
from pointing_analysis.read.unsent import OF_EVERY_TICK, topics_of_every_tick

MEMORY_LIMIT = 6_000_000_000


class Run:
    """A recorded run. Open it with `Run.open`; topics are read when first asked for.

    Attributes
    ----------
    path : the bag
    namespace : prefix of the topic names, e.g. ``/telescope``
    parameters : what the recorder wrote about the run (mode, loop, scenario, seed, ...), values decoded from JSON

    Examples
    --------
    >>> Run.open("no_such_bag")
    Traceback (most recent call last):
    ...
    pointing_analysis.read.mcap.records.BagError: no_such_bag: no such file or folder
    """

    def __init__(
        self, path: Path, namespace: str | None, start: float, stop: float, memory_limit: int, max_chunk: int
    ) -> None:
        self.path = path
        self._files = bag_files(path)
        self._noted: dict[str, None] = {}  # an ordered set: some are only met when a topic is read
        self._window = (start, stop)
        self._limit, self._max_chunk = memory_limit, max_chunk
        self._losses: dict[str, TopicLoss] = {}
        self._topics: dict[str, Topic] = {}
        self._read: BagPass  # the latest one that came to the end
        self._added: Mapping[str, bytes] = {}
        # Everything is read if it fits; else the arrays are dropped again, and only what describes the bag is kept
        columns, fits = self._pass(lambda name: True)
        if not fits:
            self._read = BagPass(self.path, self._files, self._max_chunk, self._window, heads_only=True)
            for _ in self._read.blocks():
                pass
            self._noted.update(dict.fromkeys(self._read.problems()))
        metadata, _ = merged(self._read.infos)
        self.parameters: Mapping[str, Any] = MappingProxyType({k: value_of(v) for k, v in metadata.items()})
        every = {c.topic: c for info in self._read.infos for c in info.channels.values()}
        named = self.parameters.get(REMAPPED)
        names = named.items() if isinstance(named, dict) else ()
        self._recorded_as = {str(usual): str(name) for usual, name in names if str(name) in every}
        self._usual = {name: usual for usual, name in self._recorded_as.items()}
        channels = {self._usual.get(topic, topic): channel for topic, channel in every.items()}
        self.namespace = self._choose_namespace(channels, namespace)
        self._schemas = {self.short(t): c.schema for t, c in channels.items() if t.startswith(self.namespace + "/")}
        if fits:
            for topic, column in columns.items():
                if self._usual.get(topic, topic).startswith(self.namespace + "/"):
                    self._topics[self.short(topic)] = self._finished(column)

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        namespace: str | None = None,
        start: float = 0.0,
        stop: float = float("inf"),
        memory_limit: int | None = None,
        max_chunk: int = MAX_CHUNK,
    ) -> Run:
        """Open a bag.

        Parameters
        ----------
        path : rosbag2 folder or ``.mcap`` file
        namespace : which plant, when the bag holds several
        start, stop : only this part of the run [s], counted from the first recorded message by recording time
        memory_limit : bytes that the arrays may take, in memory and in mapped files (None: `MEMORY_LIMIT`, 6 GB); a
            larger bag is read topic by topic, or in parts
        max_chunk : largest chunk that is unpacked [byte]; a larger one is left out and noted

        Raises
        ------
        BagError
            Not a bag, no known topic in it, several plants and no `namespace`, or too large.
        """
        if not (math.isfinite(start) and start >= 0):
            raise BagError(f"start must be zero or more seconds, got {start:g} s")
        if not stop > start:
            raise BagError(f"stop must be after start = {start:g} s, got {stop:g} s")
        limit = MEMORY_LIMIT if memory_limit is None else memory_limit
        return cls(Path(path), namespace, float(start), float(stop), limit, max_chunk)

    # -- reading ------------------------------------------------------------------------------------------------

    def _pass(self, selects: Callable[[str], bool]) -> tuple[dict[str, Column], bool]:
        """One pass over the files; returns the columns and whether they stayed inside the memory limit."""
        reading = BagPass(self.path, self._files, self._max_chunk, self._window)
        columns: dict[str, Column] = {}
        for info, block in reading.blocks():
            start, stop = self._window
            seconds = reading.seconds(block)
            for channel, rows in block.by_channel(info.channels):
                if channel.encoding != "cdr" or channel.schema not in COLUMNS or not selects(channel.topic):
                    continue
                if self._window != WHOLE:
                    rows = rows[(seconds[rows] >= start) & (seconds[rows] < stop)]
                if not rows.size:
                    continue
                column = columns.setdefault(channel.topic, Column(channel.topic, channel.schema))
                try:
                    decode_block(column, block, rows)
                except BagError as error:
                    raise BagError(f"{self.path}: {channel.topic}: {error}") from None
            if sum(c.nbytes for c in columns.values()) > self._limit:
                return {}, False
        self._read, self._losses = reading, {loss.topic: loss for loss in reading.losses()}
        self._noted.update(dict.fromkeys(reading.problems()))
        return columns, True

    def _finished(self, column: Column) -> Topic:
        """The topic of a column, with what is known to be lost before and after it."""
        name = self.short(column.name)
        column.name = name
        rate = self.parameters.get("rate_hz")
        period = 1.0 / rate if name in OF_EVERY_TICK and is_number(rate) and rate > 0 else None
        # The unit of the testbed's own topics, of a sensor as the recording describes it, else of the type
        described = {sensor.topic: ", ".join(sensor.unit.split(",")) for sensor in sensors_of(self)}
        unit = {**described, **KNOWN}.get(name, UNITS[column.schema])
        topic = column.topic(unit, period)
        to_its_end = self._window[1] == math.inf
        before, after = self._lost_ends(topic)
        expected = self._expected(topic)
        if to_its_end and expected is not None:
            after = max(expected - before - topic.span, after, 0)
        topic = replace(topic, lost_before=before, lost_after=after, unsent_after=self._unsent_after(topic))
        return replace(topic, open_end=to_its_end and self._read.cut and expected is None)

    def _unsent_after(self, topic: Topic) -> int:
        """Samples of the line of sight that a run has not sent behind its last ones; of a rig it is the camera's."""
        if topic.name not in ("truth/los", CAMERA) or self._window != WHOLE or self._read.cut:
            return 0
        ticks, rate = run_end(self.parameters).unsent, self.parameters.get("rate_hz")
        if topic.name != CAMERA:
            return ticks
        return math.floor(ticks / rate / topic.period + 1e-6) if is_number(rate) and rate > 0 < topic.period else 0

    def _lost_ends(self, topic: Topic) -> tuple[int, int]:
        """Messages before the first and after the last one that the bag knows to be lost."""
        loss = self._losses.get(self._full(topic.name))
        return (0, 0) if loss is None else loss.ends(topic.integrity.missing)

    def _expected(self, topic: Topic) -> int | None:
        """Samples of a whole run; None where it is not known.

        Of a file that was cut off by the duration in its configuration. Else by the ticks that the plant has sent: its
        report and the messages are written by different programs, and the end of one topic can be missing. In real time
        the last frame of a camera may come after the end.
        """
        duration, rate = self.parameters.get("duration"), self.parameters.get("rate_hz")
        if self._read.cut:
            if not is_number(duration) or not 0 < duration < 1e9 or not topic.period > 0:
                return None
            return max(round((duration - self._window[0]) / topic.period), 0)
        sent = run_end(self.parameters).sent if self._window == WHOLE else None
        if topic.name == CAMERA and sent is not None and is_number(rate) and rate > 0 and topic.period > 0:
            frames = sent / rate / topic.period
            simulated = self.parameters.get("mode") in ("inprocess", "lockstep")
            return math.ceil(frames - 1e-6) if simulated else math.floor(frames + 1e-6) - 1
        if topic.name == "truth/los" and not len(topic) and self.parameters.get("device"):
            return None  # which a rig need not have
        return sent if topic.name in OF_EVERY_TICK else None

    def _choose_namespace(self, names: Iterable[str], asked: str | None) -> str:
        plants = defaultdict(set)
        for name in names:
            for short in KNOWN:
                if name.endswith("/" + short):
                    plants[name[: -len(short) - 1]].add(short)
        if asked is not None:
            chosen = "/" + asked.strip("/") if asked.strip("/") else ""
            if chosen not in plants:
                raise BagError(f"{self.path}: namespace must be one of {sorted(plants)}, got {chosen!r}")
            return chosen
        if not plants:
            some = ", ".join(sorted(names)[:5]) or "no topics"
            raise BagError(
                f"{self.path}: the bag must hold a topic such as /telescope/truth/los, got {some}: "
                "`analyse --los` takes other lines of sight (`bag topics` lists them)"
            )
        if len(plants) > 1:
            raise BagError(
                f"{self.path}: the bag must hold one plant, got {sorted(plants)}: choose one with namespace="
            )
        return next(iter(plants))

    # -- access -------------------------------------------------------------------------------------------------

    def short(self, topic: str) -> str:
        """Name of a topic without the namespace; of one that was remapped its usual one."""
        return self._usual.get(topic, topic)[len(self.namespace) + 1 :]

    def _full(self, name: str) -> str:
        """Name under which a topic is recorded."""
        usual = f"{self.namespace}/{name}"
        return self._recorded_as.get(usual, usual)

    @property
    def problems(self) -> tuple[str, ...]:
        """Defects of the files, one sentence each; empty for an intact recording."""
        return tuple(self._noted)

    @property
    def losses(self) -> tuple[TopicLoss, ...]:
        """Messages that were recorded and cannot be read, by topic; known once a topic was read."""
        return tuple(self._losses.values())

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Records with a valid checksum that contradict the bag's digests, one sentence each."""
        return self._read.contradictions

    @property
    def has_digests(self) -> bool:
        """Whether a digest covers every chunk of messages, as in all bags of the testbed and in none of others."""
        return digests_cover(self._read.infos)

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics that can be read, without the namespace, sorted."""
        return tuple(sorted(name for name, schema in self._schemas.items() if schema in COLUMNS))

    def __contains__(self, name: object) -> bool:
        return name in self.topics

    def __getitem__(self, name: str) -> Topic:
        if name in self._topics:
            return self._topics[name]
        if name not in self.topics:
            raise BagError(f"{self.path}: no topic {name!r}; the bag has {', '.join(self.topics)}")
        full = self._full(name)
        columns, fits = self._pass(lambda topic: topic == full)
        if not fits:
            raise BagError(
                f"{self.path}: {name} does not fit into the memory limit of {self._limit / 1e6:.0f} MB: open a part "
                "with start= and stop= (seconds), or raise memory_limit="
            )
        topic = self._finished(columns.get(full, Column(full, self._schemas[name])))
        if sum(t.nbytes for t in self._topics.values()) + topic.nbytes > self._limit:
            self._topics.clear()  # keep the latest; another one is read again when asked for
        self._topics[name] = topic
        return topic

    @property
    def covered_ticks(self) -> int | None:
        """Ticks from the first to the last one that all topics of the plant have, with known losses; None of a part."""
        if self._window != WHOLE:
            return None
        names = [name for name in topics_of_every_tick(self.parameters) if name in self]
        regular = [topic for name in names if len(topic := self[name]) and topic.period > 0]
        if not regular:
            return 0
        first = max(topic.grid_start for topic in regular)
        last = min(int(topic.stamp[-1]) + round(self._lost_ends(topic)[1] * topic.period * NANO) for topic in regular)
        return round((last - first) / (regular[0].period * NANO)) + 1

    def messages(self, name: str) -> tuple[bytes, ...]:
        """Messages of a topic as they were recorded, in the order of the files; also of a type that is no columns.

        Empty where the bag has no such topic.
        """
        full, payloads = self._full(name), []
        reading = BagPass(self.path, self._files, self._max_chunk, self._window)
        for info, block in reading.blocks():
            seconds = reading.seconds(block)
            for channel, rows in block.by_channel(info.channels):
                if channel.topic == full and channel.encoding == "cdr":
                    inside = rows[(seconds[rows] >= self._window[0]) & (seconds[rows] < self._window[1])]
                    payloads += [block.payload(row) for row in inside.tolist()]
        return tuple(payloads)

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Files in the bag (controllers, plant parameters), by name."""
        files = {k: v.data for info in self._read.infos for k, v in info.attachments.items()}
        return MappingProxyType({**files, **self._added})

    def changed(self, parameters: Mapping[str, Any], attachments: Mapping[str, bytes]) -> Run:
        """The same bag with other parameters and further attachments; what is read already is shared."""
        other = copy.copy(self)
        other.parameters, other._added = MappingProxyType(dict(parameters)), {**self._added, **attachments}
        return other

    @property
    def window(self) -> tuple[float, float]:
        """Part of the run that was read [s]; the second is infinite up to its end."""
        return self._window

    @property
    def title(self) -> str:
        """Short name for tables and figures: the loop stage where it is known, else the file name."""
        loop = self.parameters.get("loop")
        return f"{loop}" if loop else self.path.name

    kind = "bag"
    """Type of the recording."""

    def shown(self, name: str) -> str:
        """Name of a topic for messages."""
        return name

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r}, {len(self.topics)} topics, loop={self.parameters.get('loop')!r})"
