"""Line of sight in a bag of any program: any message with two or three numbers or a quaternion, by its definition.

The bag is MCAP (a file, or a rosbag2 folder); the definitions are those in the bag, plain CDR. The time of a sample is
the stamp of its header; without a header, or where it is zero, the time at which the message was recorded. The bag is
read through the same pass as one of the testbed (`pointing_analysis.read.mcap.bag_pass`), so that damage costs only
what it has destroyed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.read.attitude import line_of_sight, turned_about, unit_quaternions
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.records import MAX_CHUNK, BagError, Block, Channel
from pointing_analysis.read.messages import ros_definitions
from pointing_analysis.read.messages.cdr import byte_order, stamps_of
from pointing_analysis.read.messages.channel_types import channel_types
from pointing_analysis.read.messages.transforms import TF_MESSAGE, transforms
from pointing_analysis.read.series import ORIGIN, Provenance, Series, make_series
from pointing_analysis.read.tables.table import split_unit, unit_name
from pointing_analysis.units import ANGLES, NAMES

TIME_SOURCES = ("auto", "header", "log")
LISTED = 8
REACH = 50
"""Messages over which the rate of recording is measured: the jitter of one is that much smaller."""
NO_ATTITUDE = "a quaternion must have norm 1, got another, such as the zeros of an unknown attitude"
Samples = tuple[FloatArray, IntArray, BoolArray]


@dataclass(frozen=True)
class Candidate:
    """A field that could be the line of sight.

    Attributes
    ----------
    topic : its name in the bag
    schema : message type
    field : path of the field in the message; empty if it is the message itself
    components : names of its numbers, the first two of which are used; of an attitude the axes of rotation
    stamped : whether the messages have a header
    messages : number of messages
    rate : median rate of recording [Hz]; NaN with fewer than two messages
    unit : of the numbers, where the type or their names have it; empty: to be stated
    axis : of an attitude, the axis of the body that is the line of sight; else empty
    """

    topic: str
    schema: str
    field: str
    components: tuple[str, ...]
    stamped: bool
    messages: int
    rate: float
    unit: str = ""
    axis: str = ""

    @property
    def name(self) -> str:
        """Name for the option ``--los``: topic, field, and axis of an attitude."""
        return ".".join(filter(None, (self.topic, self.field, self.axis)))

    def __str__(self) -> str:
        return f"{self.name} ({self.schema}: {', '.join(self.components)})"


@dataclass
class _Topic:
    """A topic as far as the pass has come: what of it could be used, times of its messages, numbers of the field."""

    channel: Channel
    name: str
    types: ros_definitions.Definitions = field(default_factory=dict)
    vectors: tuple[ros_definitions.Vector, ...] = ()
    refusal: str = ""
    logged: list[IntArray] = field(default_factory=list)
    published: list[IntArray] = field(default_factory=list)
    samples: list[Samples] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def candidates(self) -> list[Candidate]:
        """A possible line of sight."""
        if not self.logged:
            return []
        logged = np.concatenate(self.logged)
        reach, times = min(REACH, logged.size - 1), np.sort(logged)
        span = float(np.median(times[reach:] - times[:-reach])) if reach else 0.0
        rate = 1e9 * reach / span if span > 0 else float("nan")
        schema = self.channel.schema
        return [
            Candidate(self.name, schema, v.path, _components(v), v.stamped, logged.size, rate, _unit(v), v.axis)
            for v in self.vectors
            if not v.quantity
        ]

    def names(self, los: str) -> list[ros_definitions.Vector]:
        """Fields that an option ``--los`` means; angles, where one of them can be one."""
        topic = self.name
        exact = [v for v in self.vectors if los == (f"{topic}.{v.name}" if v.name else topic)]
        exact = exact or [v for v in self.vectors if v.axis and los == f"{topic}.{v.path}"]
        named = exact or (list(self.vectors) if los == topic else [])
        return [v for v in named if not v.quantity] or named

    def decode(self, block: Block, rows: IntArray, vector: ros_definitions.Vector) -> Samples:
        """Numbers (n, 2), of an attitude (n, 4), and header stamps (n,) of messages, and which could be read."""
        count = len(ros_definitions.QUATERNION) if vector.axis else 2
        values: FloatArray = np.full((rows.size, count), np.nan)
        stamps, fitting = np.zeros(rows.size, np.int64), np.zeros(rows.size, bool)
        for index, payloads in block.payloads(rows):
            while index.size:
                try:
                    schema, first = self.channel.schema, payloads[0].tobytes()
                    places = ros_definitions.locate(schema, self.types, vector.path, first, count)
                except BagError as error:
                    self.left_out[str(error)] += 1
                    index, payloads = index[1:], payloads[1:]
                    continue
                decoded, fits = ros_definitions.numbers(payloads, places)
                values[index[fits]], fitting[index[fits]] = decoded[fits], True
                if vector.stamped:
                    stamps[index[fits]] = stamps_of(payloads[fits], places.order)
                index, payloads = index[~fits], payloads[~fits]
        if vector.axis:
            values = values[:, [vector.components.index(one) for one in ros_definitions.QUATERNION]]
            turned = unit_quaternions(values)
            if strange := int((fitting & ~turned).sum()):
                self.left_out["a quaternion must have norm 1, got another, such as that of an unknown attitude"] += (
                    strange
                )
            fitting &= turned
        return values, stamps, fitting


def _components(vector: ros_definitions.Vector) -> tuple[str, ...]:
    return tuple(f"about {axis}" for axis in turned_about(vector.axis)) if vector.axis else vector.components


def _unit(vector: ros_definitions.Vector) -> str:
    """Unit of the two numbers where the type has one (an attitude: rad), or their names, or that of the field."""
    if vector.axis:
        return "rad"
    stated = {split_unit(name)[1] for name in vector.components[:2]}
    unit = stated.pop() if len(stated) == 1 else ""
    unit = unit or split_unit(vector.path.rpartition(".")[2])[1]
    return unit if unit in ANGLES else ""


def _met(channel: Channel, first: bytes) -> _Topic:
    """A topic by one of its messages."""
    topic = _Topic(channel, channel.topic)
    try:
        topic.types = channel_types(channel)
        byte_order(channel.schema, first)
        groups = ros_definitions.vectors(channel.schema, topic.types)
    except BagError as error:
        topic.refusal = str(error)
        return topic
    # not there: an array with fewer than two elements, or what is behind a definition that is not whole
    there = ros_definitions.located(channel.schema, topic.types, first)
    topic.vectors = tuple(v for v in groups if v.path in there)
    return topic


def _add_transforms(topics: dict[str, _Topic], channel: Channel, block: Block, rows: IntArray) -> None:
    """Attitudes of messages of tf2, those of each child frame as a topic of its own: ``/tf[camera]``."""
    of_child: dict[str, list[tuple[int, int, int, tuple[float, ...]]]] = {}
    for row in rows.tolist():
        try:
            of_message = transforms(block.payload(row))
        except BagError as error:  # the topic of all messages counts it
            whole = topics.setdefault(channel.topic, _Topic(channel, channel.topic, refusal=str(error)))
            whole.left_out[str(error)] += 1
            continue
        times = int(block.heads["log"][row]), int(block.heads["publish"][row])
        for child, stamp, rotation in of_message:
            of_child.setdefault(child, []).append((*times, stamp, rotation))
    for child, all_of_it in of_child.items():
        name = f"{channel.topic}[{child}]"
        if name not in topics:
            vectors = (ros_definitions.Vector("rotation", ros_definitions.QUATERNION, True, "", axis) for axis in "xyz")
            topics[name] = _Topic(channel, name, vectors=tuple(vectors))
        logged, published, stamps, rotations = zip(*all_of_it)
        values, topic = np.array(rotations, dtype=float), topics[name]
        turned = unit_quaternions(values)
        topic.left_out[NO_ATTITUDE] += int((~turned).sum())
        topic.logged.append(np.array(logged, np.int64))
        topic.published.append(np.array(published, np.int64))
        topic.samples.append((values, np.array(stamps, np.int64), turned))


def _scan(path: Path, los: str = "", max_chunk: int = MAX_CHUNK) -> tuple[dict[str, _Topic], BagPass]:
    """Topics of a bag with the times of their messages; the numbers of the one field that `los` means."""
    reading = BagPass(path, bag_files(path), max_chunk)
    topics: dict[str, _Topic] = {}
    for info, block in reading.blocks():
        for channel, rows in block.by_channel(info.channels):
            if ros_definitions.short_name(channel.schema) == TF_MESSAGE and channel.encoding == "cdr":
                _add_transforms(topics, channel, block, rows)
                continue
            topic = topics.get(channel.topic)
            if topic is None:
                first = [_met(channel, block.payload(row)) for row in rows[:LISTED].tolist()]
                topic = topics[channel.topic] = max(first, key=lambda met: len(met.vectors))
            if (channel.schema, channel.encoding) != (topic.channel.schema, topic.channel.encoding):
                topic.left_out[f"messages must be {topic.channel.schema}, got {channel.schema}"] += rows.size
                continue
            topic.logged.append(block.heads["log"][rows].astype(np.int64))
            named = topic.names(los)
            if len(named) == 1:
                topic.published.append(block.heads["publish"][rows].astype(np.int64))
                topic.samples.append(topic.decode(block, rows, named[0]))
    if not topics and reading.problems():
        raise BagError(f"{path}: {reading.problems()[0]}")
    return topics, reading


def candidates(path: Path) -> tuple[Candidate, ...]:
    """Everything in a bag that could be a line of sight, by topic.

    Raises
    ------
    BagError
        Not a bag, or an unreadable one: the message has the reason for one topic.
    """
    topics, _ = _scan(path)
    possible = tuple(c for name in sorted(topics) for c in topics[name].candidates())
    refused = next((name for name in sorted(topics) if topics[name].refusal), None)
    if refused is not None and not possible:
        raise BagError(f"{path}: {refused}: {topics[refused].refusal}")
    return possible


def _choose(path: Path, los: str, topics: dict[str, _Topic]) -> Candidate:
    for name, topic in topics.items():
        if topic.refusal and (los == name or los.startswith(f"{name}.")):
            raise BagError(f"{path}: {name}: {topic.refusal}")
        for vector in topic.names(los):
            if vector.quantity:
                field_, schema = f"{name}.{vector.path}" if vector.path else name, topic.channel.schema
                raise BagError(
                    f"{path}: los must be an angle, got {field_}, {vector.quantity} of {schema}: record the line of "
                    "sight as geometry_msgs/msg/Vector3Stamped, or in a type of its own"
                )
    everything = [c for name in sorted(topics) for c in topics[name].candidates()]
    named = [c for c in everything if c.name == los] or [
        c for c in everything if los in (c.topic, f"{c.topic}.{c.field}")
    ]
    if len(named) == 1:
        return named[0]
    if named:
        raise BagError(f"{path}: los must name a field, {' or '.join(c.name for c in named)}, got {los!r}")
    listed = "; ".join(str(c) for c in everything[:LISTED]) or "a topic with two numbers, of which the bag has none"
    more = f" and {len(everything) - LISTED} others (los-testbed bag topics)" if len(everything) > LISTED else ""
    raise BagError(f"{path}: los must be one of {listed}{more}, got {los!r}")


def _is_start(stamps: IntArray) -> bool:
    """Whether the stamp 0 is that of the first sample: the next one comes one step of the others later."""
    others = np.sort(stamps[stamps != 0])
    if stamps[0] != 0 or others.size < 2 or others[0] < 0:
        return False
    step = float(np.median(np.diff(others)))
    return bool(abs(float(others[0]) - step) <= 0.5 * step)


def _of_attitude(quaternions: FloatArray, chosen: Candidate, path: Path, problems: list[str]) -> FloatArray:
    """Angles (n, 2) of the axis about its mean, which is noted."""
    try:
        angles = line_of_sight(quaternions, chosen.axis)
    except BagError as error:
        raise BagError(f"{path}: {chosen.name}: {error}") from None
    first, second = turned_about(chosen.axis)
    problems.append(
        f"{chosen.topic}: the line of sight is the body's {chosen.axis} axis, its angles about {first} and {second} "
        "are those from the mean attitude: a constant error is not seen"
    )
    return angles


def read_external(
    path: Path,
    los: str,
    *,
    unit: str | None,
    rate: float | None = None,
    time: str = "auto",
    max_chunk: int = MAX_CHUNK,
) -> Series:
    """Line of sight from a topic of any bag.

    Parameters
    ----------
    path : rosbag2 folder or MCAP file
    los : topic, or topic and field: ``/my/los``, ``/my/msg.error``, of which the first two numbers are used; of an
        attitude with the axis of the body, ``/imu.orientation.z``, of tf2 with the child frame, too,
        ``/tf[camera].rotation.z``: `pointing_analysis.read.attitude.line_of_sight`
    unit : of the numbers; not needed where the type or their names have it
    rate : sampling rate [Hz] to whose grid the times are moved; by default that of the times, where they have one
    time : ``header``, ``log`` (time of recording), or ``auto``: the header where it is there and set
    max_chunk : largest chunk that is unpacked [byte]; a larger one is left out and noted

    Raises
    ------
    BagError
        Not a bag, no such field (the message lists what could be used), messages that cannot be read, another unit than
        theirs, an attitude that slews.
    ValueError
        Unknown unit or time, or a rate that the samples do not have.
    """
    if time not in TIME_SOURCES:
        raise InputError(f"time must be one of {', '.join(TIME_SOURCES)}, got {time!r}")
    topics, reading = _scan(path, los, max_chunk)
    chosen = _choose(path, los, topics)
    if chosen.unit and unit is not None and unit_name(unit) != chosen.unit:
        raise BagError(f"{path}: unit must be {chosen.unit} for {chosen.name}, got {unit!r}")
    if not chosen.unit and unit is None:
        raise InputError(f"{path}: unit must be given (--unit {NAMES}) for {chosen.name}, got none")
    topic, problems = topics[chosen.topic], reading.problems()
    values, header, fitting = (np.concatenate(arrays) for arrays in zip(*topic.samples))
    whole = topics.get(topic.channel.topic, topic)  # of tf2, the messages that cannot be read
    left_out = topic.left_out + whole.left_out if whole is not topic else +topic.left_out
    for reason, count in left_out.most_common(LISTED):
        problems.append(f"{chosen.topic}: {counted(count, 'message')} excluded: {reason}")
    logged, published = np.concatenate(topic.logged), np.concatenate(topic.published)
    by_header = chosen.stamped and time != "log" and bool(header[fitting].any())
    if time == "header" and not by_header:
        raise BagError(f"{path}: time must be log for {chosen.topic}, whose messages have no stamp, got 'header'")
    if not by_header:
        reason = "" if time == "log" else ": the samples have no stamp"
        problems.append(f"{chosen.topic}: time stamps are those of the recorder, with its jitter{reason}")
    stamps = header if by_header else logged
    if (zero := int((stamps[fitting] == 0).sum())) == 1 and _is_start(stamps[fitting]):
        stamps = stamps + ORIGIN  # the clock of the samples began at zero, as one of a simulation does
    elif zero:
        problems.append(f"{chosen.topic}: {counted(zero, 'message')} without a stamp excluded")
    used = values[fitting]
    if chosen.axis:
        used = _of_attitude(used, chosen, path, problems)
    about = {
        "line_of_sight": chosen.name,
        "message_type": chosen.schema,
        "components": list(chosen.components[:2]),
        "time": "header" if by_header else "log",
    }
    los_series = make_series(
        stamps[fitting],
        used,
        unit=chosen.unit or unit,
        rate=rate,
        published=published[fitting],
        provenance=Provenance(path, "bag", chosen.name, chosen.schema, about, problems),
    )
    loss = next((loss for loss in reading.losses() if loss.topic == topic.channel.topic), None)
    before, after = loss.ends(los_series.topic.integrity.missing) if loss is not None else (0, 0)
    judged = replace(los_series.topic, lost_before=before, lost_after=after, open_end=reading.cut)
    return replace(los_series, topic=judged, losses=reading.losses(), contradictions=reading.contradictions)
