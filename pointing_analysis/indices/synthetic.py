"""Bags with known answers: write any signals in the layout of the testbed's recordings.

For tests, for the reading benchmark, and for trying a pointing analysis on an error whose APE and RPE are known on
paper (a tone, white noise, a circular motion). A run of the testbed is recorded by its own recorder, not by this
module.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.writer import CompressionType, IndexType, Writer
from numpy.typing import ArrayLike

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME
from pointing_analysis.read.messages.cdr import Encoder
from pointing_analysis.read.messages.message_types import ACCEL, DEFINITIONS, JOINT_STATE, VECTOR3

NAMESPACE = "/telescope"
"""Of topics with relative names."""


@dataclass(frozen=True)
class McapStorage:
    """Storage of the messages in a bag's MCAP file.

    Attributes
    ----------
    compression : of the chunks: ``zstd``, ``lz4`` or ``none``
    chunk_size : [byte] of messages in a chunk
    chunks : whether messages are in chunks at all
    index : whether there are message indexes
    """

    compression: str = "zstd"
    chunk_size: int = 1 << 20
    chunks: bool = True
    index: bool = True


DEFAULT_STORAGE = McapStorage()


def _schema_of(width: int) -> str:
    return VECTOR3 if width in (2, 3) else ACCEL


def write_bag(
    path: str | Path,
    signals: Mapping[str, ArrayLike],
    *,
    dt: float = 1e-3,
    periods: Mapping[str, int] | None = None,
    stamps: Mapping[str, ArrayLike] | None = None,
    parameters: Mapping[str, Any] | None = None,
    storage: McapStorage = DEFAULT_STORAGE,
    start: int = 1_700_000_000 * 10**9,
) -> Path:
    """Write a rosbag2 folder (one MCAP file and metadata.yaml) holding the given signals.

    Parameters
    ----------
    path : folder to make; must not exist
    signals : topic name -> (n, 2), (n, 3) or (n, 6) samples; ``pma/command`` becomes a JointState. A relative name is
        one in the namespace ``/telescope``, one that begins with a slash is absolute
    dt : sampling period [s]
    periods : topic -> period as a multiple of `dt` (camera frames), default 1
    stamps : topic -> (n,) stamps [ns] in place of the regular ones, in the order of recording
    parameters : metadata of the run; values are stored as JSON
    storage : of the MCAP file
    start : stamp of the first sample [ns]

    Returns
    -------
    The folder.

    Examples
    --------
    >>> import tempfile
    >>> from pointing_analysis.read.run import Run
    >>> folder = tempfile.TemporaryDirectory()
    >>> bag = write_bag(Path(folder.name) / "bag", {"truth/los": np.zeros((100, 2))})
    >>> len(Run.open(bag)["truth/los"])
    100
    """
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=False)
    typed, events = _events(signals, dt, dict(periods or {}), dict(stamps or {}), start)
    file = folder / f"{folder.name}_0.mcap"
    with file.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=storage.chunk_size,
            compression=CompressionType[storage.compression.upper()],
            index_types=IndexType.ALL if storage.index else IndexType.NONE,
            use_chunking=storage.chunks,
        )
        writer.start(profile="ros2", library="pointing_analysis.indices.synthetic")
        text = {k: v if isinstance(v, str) else json.dumps(v) for k, v in (parameters or {}).items()}
        writer.add_metadata(METADATA_NAME, text)
        channels, encoders = {}, {}
        for name, (schema, values) in typed.items():
            encoders[name] = Encoder(schema, values.shape[1], name.strip("/").replace("/", "_"))
            number = writer.register_schema(schema, "ros2msg", DEFINITIONS[schema].encode())
            channels[name] = writer.register_channel(_topic(name), "cdr", number)
        for logged, stamp, name, row in events:
            data = bytes(encoders[name].encode(stamp, typed[name][1][row]))
            writer.add_message(channels[name], logged, data, logged, sequence=row)
        writer.finish()
    _write_yaml(folder, file.name, typed, np.array([e[0] for e in events], dtype=np.int64))
    return folder


_Signals = dict[str, tuple[str, FloatArray]]


def _topic(name: str) -> str:
    """Absolute name of a topic, as ROS resolves it."""
    return name if name.startswith("/") else f"{NAMESPACE}/{name}"


def _events(
    signals: Mapping[str, ArrayLike],
    dt: float,
    periods: dict[str, int],
    stamps: dict[str, ArrayLike],
    start: int,
) -> tuple[_Signals, list[tuple[int, int, str, int]]]:
    """Typed signals and the messages in order of recording: (time of recording, stamp, topic, row)."""
    typed: _Signals = {}
    events = []
    for name, signal in signals.items():
        values = np.atleast_2d(np.asarray(signal, dtype=float))
        schema = JOINT_STATE if _topic(name).endswith("/pma/command") else _schema_of(values.shape[1])
        if values.shape[1] == 2:
            values = np.column_stack([values, np.zeros(len(values))])
        typed[name] = (schema, values)
        step = round(dt * 1e9) * periods.get(name, 1)
        nominal = start + step * np.arange(len(values), dtype=np.int64)
        shown = np.asarray(stamps.get(name, nominal), dtype=np.int64)
        events += [(int(a), int(s), name, i) for i, (a, s) in enumerate(zip(nominal, shown))]
    return typed, sorted(events, key=lambda event: event[0])


def _write_yaml(folder: Path, file: str, typed: _Signals, times: IntArray) -> None:
    topics = [
        {
            "topic_metadata": {
                "name": _topic(name),
                "type": schema,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": "",
            },
            "message_count": len(values),
        }
        for name, (schema, values) in typed.items()
    ]
    first, last = (int(times.min()), int(times.max())) if times.size else (0, 0)
    begin, length = {"nanoseconds_since_epoch": first}, {"nanoseconds": last - first}
    info = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": length,
        "starting_time": begin,
        "message_count": int(times.size),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [
            {"path": file, "starting_time": dict(begin), "duration": dict(length), "message_count": int(times.size)}
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": info}, sort_keys=False)
    (folder / "metadata.yaml").write_text(text)
