"""Bags: a rosbag2 folder (metadata.yaml version 9, one MCAP file) that any ROS 2 reader opens.

The recorder node and the run in one process write through the same :class:`BagWriter`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from lftkit.errors import InputError
from lftkit.support.atomic_output import check_output, named_errors, write_text
from los_testbed.bags.mcap_blocks import McapBlockWriter
from los_testbed.bags.schemas import DEFINITIONS, TYPE_HASHES
from los_testbed.config.run_config import NAMESPACE
from los_testbed.config.topics import DEPTH, DIAGNOSTICS, DIAGNOSTICS_TOPIC, TOPICS, TopicDefinition
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, REPAIR_NAME, with_hash

QOS = [
    {
        "history": "keep_last",
        "depth": DEPTH,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": {"sec": 9223372036, "nsec": 854775807},
        "lifespan": {"sec": 9223372036, "nsec": 854775807},
        "liveliness": "automatic",
        "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
        "avoid_ros_namespace_conventions": False,
    }
]
"""Quality of service that every topic was offered with."""
_LATEST = 2**63 - 1
"""Largest time [ns] that metadata.yaml may name; MCAP has one bit more."""


def check_new_bag(path: Path) -> None:
    """Reject a path where no new bag can be created.

    Raises
    ------
    ValueError
        The path exists, the name is too long, or the parent is not a writable folder.
    """
    check_output(path, "the bag", new=True, folder=True)


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors, which not every reader of metadata.yaml resolves."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _yaml(content: Any) -> str:
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)


_QOS_TEXT = _yaml(QOS).strip()


def _sealed(name: str, table: Mapping[str, str]) -> Mapping[str, str]:
    """Tables of the run and of a repair carry a hash."""
    return with_hash(table) if name in (METADATA_NAME, REPAIR_NAME) else table


class BagWriter:
    """A new bag with the topics of a run.

    Parameters
    ----------
    path : Path
        Folder to make; its file is called ``<folder>_0.mcap``.
    metadata : mapping of str to mapping
        Named tables of strings for the head of the file (run parameters, seed, hashes). The run's ``namespace`` is that
        of the topics.
    attachments : mapping of str to (media type, bytes)
        Files to keep with the data: controllers, run configuration.
    diagnostics : bool
        Whether ``/diagnostics`` has a channel.
    name : str, optional
        Name of the bag, if the folder is renamed to it afterwards.
    namespace : str, optional
        Of the topics; default: that in the metadata.
    topics : sequence of TopicDefinition
        Default: those of the table.
    sent_as : mapping of str to str
        Other names of topics, absolute as well, under which they are recorded.

    Raises
    ------
    ValueError
        The folder exists, or cannot be made.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, tuple[str, bytes]] | None = None,
        diagnostics: bool = False,
        name: str | None = None,
        namespace: str | None = None,
        topics: Sequence[TopicDefinition] = TOPICS,
        sent_as: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        check_new_bag(path)
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"the bag {path} cannot be created: {error.strerror}") from None
        self.path = path
        self.file_name = f"{name or path.name}_0.mcap"
        self._mcap = McapBlockWriter(path / self.file_name)
        self.namespace = (
            namespace if namespace is not None else metadata.get(METADATA_NAME, {}).get("namespace", NAMESPACE)
        )
        paths = {topic.path_in(self.namespace): topic.type_name for topic in topics}
        self._types = {sent_as.get(path, path): type_name for path, type_name in paths.items()}
        if diagnostics:
            self._types[DIAGNOSTICS_TOPIC] = DIAGNOSTICS
        for name, table in metadata.items():
            self._mcap.add_metadata(name, _sealed(name, table))
        for name, (media_type, data) in (attachments or {}).items():
            self._mcap.add_attachment(name, media_type, data)
        self._channels: dict[str, int] = {}
        for name, type_name in list(self._types.items()):
            self.add_topic(name, type_name, DEFINITIONS[type_name], TYPE_HASHES[type_name])
        self._closed = False

    def add_topic(
        self, name: str, type_name: str, definition: str, type_hash: str = "", language: str = "ros2msg"
    ) -> None:
        """Another topic than those of the table, with the definition of its type and the language of that."""
        metadata = {"offered_qos_profiles": _QOS_TEXT, "topic_type_hash": type_hash}
        self._types[name] = type_name
        self._channels[name] = self._mcap.add_channel(name, type_name, definition, metadata, language)

    def write(
        self,
        topic: str,
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
        messages: NDArray[np.uint8],
        sequences: NDArray[np.int64] | None = None,
    ) -> None:
        """Append messages (n, length) of one topic with their times (n,) [ns]; see `McapBlockWriter.add_block`."""
        with named_errors(self.path, self.path):
            self._mcap.add_block(self._channels[topic], log_times, publish_times, messages, sequences)

    def end_chunk(self) -> None:
        """Compress and write the messages since the last call; called once per second of data."""
        with named_errors(self.path, self.path):
            self._mcap.flush_chunk()

    @property
    def topics(self) -> frozenset[str]:
        """Names of the topics that have a channel."""
        return frozenset(self._channels)

    @property
    def types(self) -> Mapping[str, str]:
        """Types of the messages, by topic."""
        return self._types

    def counts(self) -> dict[str, int]:
        """Messages so far per topic."""
        return {name: self._mcap.counts[channel] for name, channel in self._channels.items()}

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write `metadata` (results of the run), the index and metadata.yaml."""
        if self._closed:
            return
        self._closed = True
        with named_errors(self.path, self.path):
            self._finish(metadata or {})

    def _finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._mcap.flush_chunk()
        for name, table in metadata.items():
            self._mcap.add_metadata(name, _sealed(name, table))
        description = self._description()
        text = _yaml(description)
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
        self._mcap.finish()
        write_text(self.path / "metadata.yaml", _yaml({"rosbag2_bagfile_information": description}))

    def _description(self) -> dict[str, Any]:
        start, end = (min(stamp, _LATEST) for stamp in (self._mcap.start_time, self._mcap.end_time))
        counts = self.counts()
        total = sum(counts.values())
        span = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": end - start},
            "message_count": total,
        }
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": span["duration"],
            "starting_time": span["starting_time"],
            "message_count": total,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": QOS,
                        "type_description_hash": TYPE_HASHES.get(type_name, ""),
                    },
                    "message_count": counts[name],
                }
                for name, type_name in self._types.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file_name],
            "files": [{"path": self.file_name, **span}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
