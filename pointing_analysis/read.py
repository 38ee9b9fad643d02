"""Open a recorded run: ``Run.open(path)`` gives its topics as numpy arrays.

Reads rosbag2 folders and single files in MCAP, written by this testbed or by ``ros2 bag record``: chunk compression
zstd, lz4 or none, file-wise and message-wise zstd, split recordings, and recordings that were cut off.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml
import zstandard
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pointing_analysis import cdr
from pointing_analysis.mcap_records import BODY, HEAD, BagError, Block, Channel, FileInfo, walk
from pointing_analysis.message_types import COLUMNS, UNITS
from pointing_analysis.topic import NANO, Topic, make_topic

METADATA_NAME = "los_testbed"
#: topics of the testbed by their name without the namespace, with the unit of their values
KNOWN: Mapping[str, str] = MappingProxyType(
    {
        "isolator/accel": "m/s2, rad/s2",
        "m1/accel": "m/s2, rad/s2",
        "m2/accel": "m/s2, rad/s2",
        "fsm/strain_gauge": "rad",
        "camera/los": "rad",
        "los_estimate": "rad",
        "fsm/command": "rad",
        "pma/command": "N",
        "truth/los": "rad",
    }
)
MEMORY_LIMIT = 2_000_000_000


def _natural(path: Path) -> list[int | str]:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def _files(path: Path) -> tuple[list[Path], dict[str, Any], list[str]]:
    """Files of a bag in order, its metadata.yaml, and problems."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        return [path], {}, []
    info: dict[str, Any] = {}
    problems: list[str] = []
    on_disk = sorted((f for f in path.iterdir() if re.search(r"\.mcap(\.zst|\.zstd)?$", f.name)), key=_natural)
    if (path / "metadata.yaml").is_file():
        try:
            info = (yaml.safe_load((path / "metadata.yaml").read_text()) or {}).get("rosbag2_bagfile_information", {})
        except (yaml.YAMLError, AttributeError, UnicodeDecodeError) as error:
            problems.append(f"metadata.yaml cannot be read ({str(error).splitlines()[0]}): files taken in name order")
    else:
        problems.append("no metadata.yaml (the recorder was stopped hard): files taken in name order")
    named = [path / name for name in info.get("relative_file_paths", [])]
    missing = [f.name for f in named if not f.is_file()]
    if missing:
        problems.append(f"files named in metadata.yaml are missing: {', '.join(missing)}")
    files = [f for f in named if f.is_file()] or on_disk
    if any(f.suffix == ".db3" for f in files):
        raise BagError(f"{path}: the bag must be MCAP, got sqlite3 (convert it with `ros2 bag convert`)")
    if not files:
        raise BagError(f"{path}: a rosbag2 folder must hold .mcap files, got none")
    return files, info, problems


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


class _Column:
    """Collects the decoded messages of one topic in arrays that grow by doubling.

    The unused half of an array costs no memory (its pages are never touched), and there is no joining of pieces at the
    end, which would take the memory twice.
    """

    def __init__(self, name: str, schema: str) -> None:
        self.name, self.schema = name, schema
        width = len(COLUMNS[schema])
        self.size = 0
        self.arrays: list[NDArray[Any]] = _nothing(width)

    def add(self, stamp: NDArray[np.int64], values: NDArray[np.float64], sent: NDArray[np.int64]) -> None:
        """Append messages: stamps, values (m, k), times of publishing."""
        if not self.size and values.shape[1] != self.arrays[1].shape[1]:
            self.arrays = _nothing(values.shape[1])
        if values.shape[1] != self.arrays[1].shape[1]:
            raise BagError(
                f"all messages must have the same number of values, got {self.arrays[1].shape[1]} and {values.shape[1]}"
            )
        end = self.size + len(stamp)
        for i, new in enumerate((stamp, values, sent)):
            if end > len(self.arrays[i]):
                larger = np.empty((max(end, 2 * len(self.arrays[i])), *new.shape[1:]), self.arrays[i].dtype)
                larger[: self.size] = self.arrays[i][: self.size]
                self.arrays[i] = larger
            self.arrays[i][self.size : end] = new
        self.size = end

    @property
    def nbytes(self) -> int:
        """Memory in use [byte]."""
        return self.size * sum(a.itemsize * (a.shape[1] if a.ndim > 1 else 1) for a in self.arrays)

    def topic(self) -> Topic:
        """The finished topic; the column is empty afterwards."""
        columns = list(COLUMNS[self.schema])
        stamp, values, published = (a[: self.size] for a in self.arrays)
        if len(columns) != values.shape[1]:
            columns = [f"{columns[0]}[{i}]" for i in range(values.shape[1])]
        self.arrays = []
        unit = KNOWN.get(self.name, UNITS[self.schema])
        return make_topic(self.name, self.schema, unit, tuple(columns), stamp, values, published)


def _nothing(width: int) -> list[NDArray[Any]]:
    return [np.empty(0, np.int64), np.empty((0, width)), np.empty(0, np.int64)]


def _decode_block(column: _Column, block: Block, chosen: NDArray[np.bool_], packed: bool) -> None:
    """Decode the chosen messages of a block; equal sizes go through one numpy view."""
    buffer = np.frombuffer(block.data, np.uint8)
    heads, offsets = block.heads[chosen], block.offsets[chosen]
    sizes = heads["length"].astype(np.int64) - BODY
    sent = heads["publish"].astype(np.int64)
    if packed:
        unzip = zstandard.ZstdDecompressor()
        payloads = [
            unzip.decompressobj().decompress(block.data[o + HEAD : o + HEAD + n]) for o, n in zip(offsets, sizes)
        ]
        buffer = np.frombuffer(b"".join(payloads), np.uint8)
        sizes = np.array([len(p) for p in payloads], dtype=np.int64)
        starts = np.cumsum(sizes) - sizes
    else:
        starts = offsets + HEAD
    for size in np.unique(sizes):
        same = np.flatnonzero(sizes == size)
        begin = starts[same]
        plan = cdr.layout(column.schema, buffer[begin[0] : begin[0] + size].tobytes())
        rows = sliding_window_view(buffer, int(size))[begin]
        stamp, values, fits = cdr.decode(rows, plan)
        if fits.all():
            column.add(stamp, values, sent[same])
            continue
        column.add(stamp[fits], values[fits], sent[same][fits])
        odd = np.flatnonzero(~fits)
        stamp, single = cdr.decode_any(column.schema, [rows[i].tobytes() for i in odd])
        for i, row in enumerate(single):
            column.add(stamp[i : i + 1], row[None, :], sent[same[odd[i : i + 1]]])


class Run:
    """A recorded run. Open it with `Run.open`; topics are read when first asked for.

    Attributes
    ----------
    path : the bag
    namespace : what stands before the topic names, e.g. ``/telescope``
    parameters : what the recorder wrote about the run (mode, loop, scenario, seed, ...), values decoded from JSON

    Examples
    --------
    >>> Run.open("no_such_bag")
    Traceback (most recent call last):
    ...
    pointing_analysis.mcap_records.BagError: no_such_bag: no such bag
    """

    def __init__(self, path: Path, namespace: str | None, start: float, stop: float, memory_limit: int) -> None:
        self.path = path
        self._files, self._yaml, problems = _files(path)
        self._noted = dict.fromkeys(problems)  # an ordered set: some are only met when a topic is read
        self._window = (start, stop)
        self._limit = memory_limit
        self._topics: dict[str, Topic] = {}
        self._infos: list[FileInfo] = []
        self._asked_namespace = namespace
        self.namespace = ""
        self._first_pass()

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        namespace: str | None = None,
        start: float = 0.0,
        stop: float = float("inf"),
        memory_limit: int | None = None,
    ) -> Run:
        """Open a bag.

        Parameters
        ----------
        path : rosbag2 folder or ``.mcap`` file
        namespace : which plant, when the bag holds several
        start, stop : only this part of the run [s], counted from the first recorded message by recording time
        memory_limit : bytes that the arrays may take (None: `MEMORY_LIMIT`, 2 GB); a larger bag is read topic by topic,
            or in parts

        Raises
        ------
        BagError
            Not a bag, no known topic in it, several plants and no `namespace`, or too large.
        """
        if not stop > start:
            raise BagError(f"stop must be after start = {start:g} s, got {stop:g} s")
        limit = MEMORY_LIMIT if memory_limit is None else memory_limit
        return cls(Path(path), namespace, float(start), float(stop), limit)

    # -- reading ------------------------------------------------------------------------------------------------

    def _first_pass(self) -> None:
        """Read everything if it fits; else drop the arrays again and keep only what describes the bag."""
        columns, fits = self._pass(lambda name: True)
        names = {c.topic for info in self._infos for c in info.channels.values()}
        self.namespace = self._choose_namespace(names)
        self._schemas = {
            self.short(c.topic): c.schema
            for info in self._infos
            for c in info.channels.values()
            if c.topic.startswith(self.namespace + "/")
        }
        merged: dict[str, str] = {}
        for info in self._infos:
            merged.update(info.metadata.get(METADATA_NAME, {}))
        self.parameters: Mapping[str, Any] = MappingProxyType({k: _value(v) for k, v in merged.items()})
        if fits:
            for topic, column in columns.items():
                if topic.startswith(self.namespace + "/"):
                    column.name = self.short(topic)
                    self._topics[column.name] = column.topic()

    def _pass(self, selects: Callable[[str], bool] | None) -> tuple[dict[str, _Column], bool]:
        """One pass over the files; returns the columns and whether they stayed inside the memory limit.

        Without `selects` only the first chunk of each file is unpacked: enough for topics, parameters and attachments.
        """
        self._infos = []
        columns: dict[str, _Column] = {}
        origin: int | None = None
        packed = str(self._yaml.get("compression_mode", "")).upper() == "MESSAGE"
        for file in self._files:
            info = FileInfo()
            self._infos.append(info)
            if origin is not None:
                info.unpacks = self._in_window(origin)
            for block in walk(file, info):
                if origin is None:
                    origin = int(block.heads["log"].min())
                    info.unpacks = self._in_window(origin)
                if selects is None:
                    info.unpacks = lambda first, last: False
                    continue
                self._take(block, info, columns, selects, origin, packed)
                if sum(c.nbytes for c in columns.values()) > self._limit:
                    return self._pass(None)[0], False
            self._noted.update(dict.fromkeys(info.problems))
        return columns, True

    def _in_window(self, origin: int) -> Callable[[int, int], bool]:
        """Whether a chunk between two recording times [ns] can hold something of the part that was asked for."""
        start, stop = self._window
        if start == 0 and not np.isfinite(stop):
            return lambda first, last: True
        low = origin + start * NANO
        high = origin + stop * NANO if np.isfinite(stop) else math.inf
        return lambda first, last: last >= low and first < high

    def _take(
        self,
        block: Block,
        info: FileInfo,
        columns: dict[str, _Column],
        selects: Callable[[str], bool],
        origin: int,
        packed: bool,
    ) -> None:
        start, stop = self._window
        inside = None
        if start > 0 or np.isfinite(stop):
            since = (block.heads["log"].astype(np.int64) - origin) / NANO
            inside = (since >= start) & (since < stop)
        numbers = block.heads["channel"]
        for number in np.unique(numbers):
            channel: Channel | None = info.channels.get(int(number))
            if channel is None or channel.encoding != "cdr" or channel.schema not in COLUMNS:
                continue
            if not selects(channel.topic):
                continue
            chosen = numbers == number if inside is None else (numbers == number) & inside
            if not chosen.any():
                continue
            column = columns.setdefault(channel.topic, _Column(channel.topic, channel.schema))
            try:
                _decode_block(column, block, chosen, packed)
            except (BagError, zstandard.ZstdError) as error:
                raise BagError(f"{self.path}: {channel.topic}: {error}") from None

    def _choose_namespace(self, names: Iterable[str]) -> str:
        found = defaultdict(set)
        for name in names:
            for short in KNOWN:
                if name.endswith("/" + short):
                    found[name[: -len(short) - 1]].add(short)
        if self._asked_namespace is not None:
            chosen = "/" + self._asked_namespace.strip("/") if self._asked_namespace.strip("/") else ""
            if chosen not in found:
                raise BagError(f"{self.path}: namespace must be one of {sorted(found)}, got {chosen!r}")
            return chosen
        if not found:
            some = ", ".join(sorted(names)[:5]) or "no topics at all"
            raise BagError(f"{self.path}: the bag must hold a topic such as /telescope/truth/los, got {some}")
        if len(found) > 1:
            raise BagError(f"{self.path}: the bag must hold one plant, got {sorted(found)}: choose one with namespace=")
        return next(iter(found))

    # -- access -------------------------------------------------------------------------------------------------

    def short(self, topic: str) -> str:
        """Name of a topic without the namespace."""
        return topic[len(self.namespace) + 1 :]

    @property
    def problems(self) -> tuple[str, ...]:
        """Defects of the files, one sentence each; empty for an intact recording."""
        return tuple(self._noted)

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
        full = f"{self.namespace}/{name}"
        columns, fits = self._pass(lambda topic: topic == full)
        if not fits:
            raise BagError(
                f"{self.path}: {name} does not fit into the memory limit of {self._limit / 1e6:.0f} MB: open a part "
                "with start= and stop= (seconds), or raise memory_limit="
            )
        column = columns.get(full, _Column(full, self._schemas[name]))
        column.name = name
        topic = column.topic()
        if sum(t.nbytes for t in self._topics.values()) + topic.nbytes > self._limit:
            self._topics.clear()  # keep the latest; another one is read again when asked for
        self._topics[name] = topic
        return topic

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Files in the bag (controllers, plant parameters), by name."""
        return MappingProxyType({k: v for info in self._infos for k, v in info.attachments.items()})

    @property
    def title(self) -> str:
        """Short name for tables and figures: the loop stage where it is known, else the file name."""
        loop = self.parameters.get("loop")
        return f"{loop}" if loop else self.path.name

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r}, {len(self.topics)} topics, loop={self.parameters.get('loop')!r})"
