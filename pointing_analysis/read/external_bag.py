"""Line of sight in a bag of any program: any message type with two or three numbers, read by its definition.

The bag is MCAP (a file, or a rosbag2 folder); the definitions are those in the bag, plain CDR. The time of a sample is
the stamp of its header; without a header, or where it is zero, the time at which the message was recorded.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from pointing_analysis.read.mcap.bag_files import is_single_file
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages import ros_definitions
from pointing_analysis.read.series import Series, make_series

TimeSource = Literal["auto", "header", "log"]
TIME_SOURCES = ("auto", "header", "log")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LISTED = 8
MAX_RECORD = 1 << 30
SUFFIXES = (".mcap", ".mcap.zst", ".mcap.zstd")


@dataclass(frozen=True)
class Candidate:
    """A field that could be the line of sight.

    Attributes
    ----------
    topic : its name in the bag
    schema : message type
    field : path of the field in the message; empty if it is the message itself
    components : names of its numbers; the first two are used
    stamped : whether the messages have a header
    messages : number of messages
    rate : median rate of recording [Hz]; NaN with fewer than two messages
    """

    topic: str
    schema: str
    field: str
    components: tuple[str, ...]
    stamped: bool
    messages: int
    rate: float

    @property
    def name(self) -> str:
        """Name for the option ``--los``."""
        return f"{self.topic}.{self.field}" if self.field else self.topic

    def __str__(self) -> str:
        return f"{self.name} ({self.schema}: {', '.join(self.components)})"


@dataclass
class _Topic:
    schema: Schema
    encoding: str
    data: list[bytes]
    logged: list[int]
    published: list[int]


def mcap_files(path: Path) -> list[Path]:
    """MCAP files of a bag.

    Raises
    ------
    BagError
        No such bag, or no MCAP file in the folder.
    """
    if is_single_file(path):
        return [path]
    files = sorted(f for f in path.iterdir() if f.name.endswith(SUFFIXES) and f.is_file())
    if not files:
        sqlite = any(path.glob("*.db3"))
        what = "sqlite3 (convert it with `ros2 bag convert`)" if sqlite else "no .mcap file"
        raise BagError(f"{path}: the bag must be MCAP, got {what}")
    return files


def _records(file: Path, problems: list[str]) -> Iterator[Any]:
    """Records of a file as far as it can be read."""
    with file.open("rb") as raw:
        stream: BinaryIO = raw
        if file.name.endswith((".zst", ".zstd")):
            stream = zstandard.ZstdDecompressor().stream_reader(raw)  # type: ignore[assignment]
        try:
            yield from StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD).records
        except (McapError, struct.error, zstandard.ZstdError, RuntimeError, UnicodeDecodeError) as error:
            problems.append(f"{file.name}: read up to a damaged place ({type(error).__name__}: {error})")


def _scan(path: Path, los: str = "") -> tuple[dict[str, _Topic], list[str]]:
    """Topics of a bag; all messages of those that `los` can mean, of the others the first one and the times."""
    problems: list[str] = []
    topics: dict[str, _Topic] = {}
    for file in mcap_files(path):
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in _records(file, problems):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    continue
                schema = schemas.get(channel.schema_id) or Schema(id=0, data=b"", encoding="", name="")
                topic = topics.setdefault(channel.topic, _Topic(schema, channel.message_encoding, [], [], []))
                if los == channel.topic or los.startswith(f"{channel.topic}.") or not topic.data:
                    topic.data.append(record.data)
                topic.logged.append(record.log_time)
                topic.published.append(record.publish_time)
    if not topics and problems:
        raise BagError(f"{path}: {problems[0]}")
    return topics, problems


def _definitions(topic: _Topic) -> ros_definitions.Definitions:
    if topic.encoding != "cdr" or topic.schema.encoding != "ros2msg":
        return {}
    return ros_definitions.parse_definition(topic.schema.name, topic.schema.data.decode("utf-8", "replace"))


def _candidates(name: str, topic: _Topic) -> list[Candidate]:
    steps = np.diff(np.sort(np.array(topic.logged, dtype=np.int64)))
    middle = float(np.median(steps)) if steps.size else 0.0
    types = _definitions(topic)
    found = []
    for vector in ros_definitions.vectors(topic.schema.name, types):
        try:
            ros_definitions.locate(topic.schema.name, types, vector.path, _plain(topic.data[0]))
        except (BagError, KeyError):
            continue  # an array with fewer than two elements, or a definition that is not whole
        rate = 1e9 / middle if middle > 0 else float("nan")
        shape = (vector.path, vector.components, vector.stamped)
        found.append(Candidate(name, topic.schema.name, *shape, len(topic.logged), rate))
    return found


def candidates(path: Path) -> tuple[Candidate, ...]:
    """Everything in a bag that could be a line of sight, by topic.

    Raises
    ------
    BagError
        Not a bag.
    """
    topics, _ = _scan(path)
    return tuple(c for name in sorted(topics) for c in _candidates(name, topics[name]))


def _plain(data: bytes) -> bytes:
    """Payload; that of a bag with message-wise compression unpacked."""
    return zstandard.ZstdDecompressor().decompressobj().decompress(data) if data[:4] == ZSTD_MAGIC else data


def _choose(path: Path, los: str, topics: dict[str, _Topic]) -> Candidate:
    everything = [c for name in sorted(topics) for c in _candidates(name, topics[name])]
    of_topic = [c for c in everything if c.topic == los]
    named = [c for c in everything if c.name == los] or of_topic
    if len(named) == 1:
        return named[0]
    if named:
        raise BagError(f"{path}: los must name a field, {' or '.join(c.name for c in named)}, got {los!r}")
    listed = "; ".join(str(c) for c in everything[:LISTED]) or "a topic with two numbers, of which the bag has none"
    more = f" and {len(everything) - LISTED} others (los-testbed bag topics)" if len(everything) > LISTED else ""
    raise BagError(f"{path}: los must be one of {listed}{more}, got {los!r}")


def read_external(path: Path, los: str, *, unit: str | None, rate: float | None = None, time: str = "auto") -> Series:
    """Line of sight from a topic of any bag.

    Parameters
    ----------
    path : rosbag2 folder or MCAP file
    los : topic, or topic and field: ``/my/los``, ``/imu.angular_velocity``; the first two numbers are used
    unit : of the numbers
    rate : sampling rate [Hz] to whose grid the times are moved; by default they are taken as they are
    time : ``header``, ``log`` (time of recording), or ``auto``: the header where it is there and set

    Raises
    ------
    BagError
        Not a bag, no such field (the message lists what could be used), messages that cannot be read.
    ValueError
        Unknown unit or time, or a rate that the samples do not have.
    """
    if time not in TIME_SOURCES:
        raise ValueError(f"time must be one of {', '.join(TIME_SOURCES)}, got {time!r}")
    topics, problems = _scan(path, los)
    cut = bool(problems)
    chosen = _choose(path, los, topics)
    topic = topics[chosen.topic]
    values, header, fitting = _decode(chosen, topic)
    if not fitting.all():
        problems.append(f"{chosen.topic}: {int((~fitting).sum())} messages have fewer than two numbers: left out")
    logged = np.array(topic.logged, dtype=np.int64)
    by_header = chosen.stamped and time != "log" and bool(header[fitting].any())
    if time == "header" and not by_header:
        raise BagError(f"{path}: time must be log for {chosen.topic}, whose messages have no stamp, got 'header'")
    if not by_header:
        reason = "" if time == "log" else ": the samples have no stamp"
        problems.append(f"{chosen.topic}: times are those of recording, with its jitter{reason}")
    stamps = header if by_header else logged
    about = {
        "line_of_sight": chosen.name,
        "message_type": chosen.schema,
        "components": list(chosen.components[:2]),
        "time": "header" if by_header else "log",
    }
    return make_series(
        stamps[fitting],
        values[fitting],
        unit=unit,
        rate=rate,
        published=np.array(topic.published)[fitting],
        path=path,
        schema=chosen.schema,
        parameters=about,
        problems=problems,
        open_end=cut,
    )


def _decode(chosen: Candidate, topic: _Topic) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Numbers (n, 2) and header stamps (n,) of all messages, and which of them could be read."""
    types = _definitions(topic)
    payloads = [_plain(data) for data in topic.data]
    values = np.full((len(payloads), 2), np.nan)
    stamps, fitting = np.zeros(len(payloads), np.int64), np.zeros(len(payloads), bool)
    waiting: dict[int, list[int]] = defaultdict(list)
    for i, payload in enumerate(payloads):
        waiting[len(payload)].append(i)
    for size, same in waiting.items():
        index = np.array(same)
        rows: NDArray[np.uint8] = np.frombuffer(b"".join(payloads[i] for i in same), np.uint8).reshape(len(same), size)
        while index.size:
            try:
                places = ros_definitions.locate(chosen.schema, types, chosen.field, rows[0].tobytes())
            except BagError:
                index, rows = index[1:], rows[1:]
                continue
            found, fits = ros_definitions.numbers(rows, places)
            values[index[fits]], fitting[index[fits]] = found[fits], True
            if chosen.stamped:
                stamps[index[fits]] = ros_definitions.stamps(rows[fits], places.order)
            index, rows = index[~fits], rows[~fits]
    return values, stamps, fitting
