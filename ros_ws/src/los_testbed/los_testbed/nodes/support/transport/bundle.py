"""All samples, or all commands, of a tick in one message.

A tick of the loop then needs one message each way. The topics of the single sensors and actuators have the same values
for other subscribers, and are published after it. The message is a ``sensor_msgs/JointState``: each entry of ``name``
says what the entry of ``effort`` at its place is. A sensor without a sample at a tick is NaN. A sensor that is slower
than the loop has an age besides: time from its sample to the tick [s], NaN without one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from los_testbed.bags.cdr import Codec
from los_testbed.config.topics import BUNDLES, TopicDefinition, command_topics, sensor_topics
from los_testbed.parts.run_parts import RunParts
from pointing_analysis.read.messages.message_types import JOINT_STATE

FRAME = "loop"


@dataclass(frozen=True)
class TickBundle:
    """Content of the message of a tick.

    Parameters
    ----------
    name : str
        Topic, relative to the namespace.
    publisher : str
        Node that sends it.
    topics : tuple of TopicDefinition
        Topics whose values it holds; their columns are those in the message.
    ages : mapping of str to int
        Column of the age of each topic that is slower than the loop, by its name.
    """

    name: str
    publisher: str
    topics: tuple[TopicDefinition, ...]
    ages: Mapping[str, int]

    @property
    def size(self) -> int:
        """Number of values."""
        return max(int(topic.columns.stop) for topic in self.topics) + len(self.ages)

    @property
    def names(self) -> list[str]:
        """Name of each value: topic and index, or topic and ``age``."""
        names = [""] * self.size
        for topic in self.topics:
            for i, column in enumerate(range(topic.columns.start, topic.columns.stop)):
                names[column] = f"{topic.name}[{i}]"
        for topic_name, column in self.ages.items():
            names[column] = f"{topic_name} age"
        return names

    @property
    def type_name(self) -> str:
        """ROS message type."""
        return JOINT_STATE

    def codec(self) -> Codec:
        """Bytes of the message."""
        return Codec(self.type_name, self.size, FRAME, self.names)


def measurement_bundle(parts: RunParts) -> TickBundle:
    """The message of the plant: the measurement, then the ages of slow sensors."""
    topics = sensor_topics(parts.ports.sensors)
    slow = [topic.name for topic in topics if topic.framed and topic.every(parts.ports.ticks) > 1]
    end = parts.ports.measurements
    return TickBundle(BUNDLES["plant"], "plant", topics, {name: end + i for i, name in enumerate(slow)})


def command_bundle(parts: RunParts) -> TickBundle:
    """The message of the controller: the command."""
    return TickBundle(BUNDLES["controller"], "controller", command_topics(parts.ports.actuators), {})
