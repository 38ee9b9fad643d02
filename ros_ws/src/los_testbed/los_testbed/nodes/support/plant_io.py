"""Topics of the plant node: sensors and truth out, commands in through their gates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, codec_for
from los_testbed.factories import RunParts
from los_testbed.loop.command_gate import CommandGate
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.source_watch import SourceWatch
from los_testbed.nodes.support.transport.raw_topics import (
    LOCKSTEP_DEPTH,
    READER_DEPTH,
    RawPublisher,
    RawSubscription,
    settle,
)
from los_testbed.topics import (
    FSM_COMMAND,
    PMA_COMMAND,
    PROGRESS_TOPIC,
    SENSORS,
    TOPICS,
    TRUTH_LOS,
    TopicDefinition,
    actuator_topics,
)
from pointing_analysis.read.messages.message_types import HEADER
from titop_plant.interface import TICK_NS

NOTHING: Mapping[str, FloatArray] = MappingProxyType({})


Output = tuple[TopicDefinition, RawPublisher, Codec, int]
"""Topic, publisher, codec and period [ns] of what the plant sends."""


@dataclass(frozen=True)
class CommandInput:
    """A topic of commands on its way to the plant.

    Parameters
    ----------
    name : str
        In the names of statistics.
    topic : TopicDefinition
    source : RawSubscription
    gate : CommandGate
    """

    name: str
    topic: TopicDefinition
    source: RawSubscription
    gate: CommandGate


class PlantIo:
    """Publishers, subscriptions and gates of the plant."""

    def __init__(self, context: NodeContext) -> None:
        config, node, parts = context.config, context.node, RunParts(context.config)

        def output(topic: TopicDefinition) -> tuple[TopicDefinition, RawPublisher]:
            return topic, RawPublisher(node, topic.name, topic.type_name)

        self._sensors = [
            (topic, publisher, codec_for(topic), topic.every(config.frame_ticks) * TICK_NS)
            for topic, publisher in map(output, SENSORS)
        ]
        self._truth = output(TRUTH_LOS)[1], codec_for(TRUTH_LOS)
        read = {port.name for devices in parts.used.values() for port in devices.inputs}
        more = [t for t in parts.topics[len(TOPICS) :] if t.publisher == "plant"]
        outputs: list[Output] = [
            (topic, publisher, codec_for(topic), topic.every(config.frame_ticks) * TICK_NS)
            for topic, publisher in map(output, more)
        ]
        self._read = [one for one in outputs if one[0].port in read]
        self._further = [one for one in outputs if one[0].port not in read]
        every = config.mode == "lockstep"  # time stands still until a lost command was sent again

        def subscribe(topic: TopicDefinition) -> RawSubscription:
            depth = LOCKSTEP_DEPTH if every else READER_DEPTH
            return RawSubscription(node, topic.name, topic.type_name, depth, every, topic.publisher)

        hold = config.hold_ticks, config.fade_ticks

        def command(name: str, topic: TopicDefinition, limit: float) -> CommandInput:
            return CommandInput(name, topic, subscribe(topic), CommandGate(codec_for(topic), limit, *hold))

        mirror, force = parts.basis.authority
        further = parts.used["k_pma"].actuators
        self.mirror = command("fsm", FSM_COMMAND, mirror)
        self.forces = command("pma", PMA_COMMAND, force)
        self.commands = (
            *(command(one.name, topic, one.authority) for one, topic in zip(further, actuator_topics(further))),
            self.mirror,
            self.forces,
        )
        """Command topics in the order in which the controller sends them."""
        self.command_size = max(one.topic.columns.stop for one in self.commands)
        self.progress_input = RawSubscription(node, PROGRESS_TOPIC, HEADER, publisher="recorder")
        self.watch = SourceWatch(node, [*(one.source for one in self.commands), self.progress_input])
        self._none = np.zeros(1)  # of hold ticks: all values
        self.start = 0

    def publish(
        self, stamp: int, measurement: FloatArray, truth: FloatArray, further: Mapping[str, FloatArray] = NOTHING
    ) -> None:
        """Send a tick; slower sensors only on theirs. The estimator's trigger goes before truth, image and readings.

        Readings that a controller takes in go before all others.

        `further` holds the vectors behind those of the loop, by their names.
        """
        self._publish_further(stamp, further, self._read)
        for topic, publisher, codec, period in self._sensors:
            if period == TICK_NS or stamp % period == 0:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        publisher, codec = self._truth
        publisher.publish(codec.encode(stamp, truth))
        self._publish_further(stamp, further, self._further)

    def _publish_further(self, stamp: int, further: Mapping[str, FloatArray], outputs: list[Output]) -> None:
        for topic, publisher, codec, period in outputs:
            if stamp % period == 0:
                values = further[topic.vector][topic.columns] if topic.vector in further else self._none
                publisher.publish(codec.encode(stamp, values))

    def publish_samples(
        self, stamp: int, measurement: FloatArray | None, frames: Mapping[str, tuple[int, FloatArray]], truth: str
    ) -> None:
        """Send what a device gave at a tick: frames with their stamps first, the estimator's trigger last.

        Parameters
        ----------
        stamp : of the tick [ns]
        measurement : (22,), of which the columns of the sensors of every tick are sent; None: nothing is
        frames : stamp and values of slower sensors, by port
        truth : port of the true line of sight
        """
        for topic, publisher, codec, _ in self._sensors:
            if topic.framed:
                if topic.port in frames:
                    publisher.publish(codec.encode(*frames[topic.port]))
            elif measurement is not None:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        if truth in frames and measurement is not None:
            self._truth[0].publish(self._truth[1].encode(stamp, frames[truth][1]))

    def framed_at(self, stamp: int) -> list[str]:
        """Topics with a sample at some ticks only, which have one at this."""
        slow = [(topic.name, period) for topic, _, _, period in self._sensors if period > TICK_NS]
        slow += [(topic.name, period) for topic, _, _, period in self._further if period > TICK_NS]
        return [name for name, period in slow if stamp % period == 0]

    def settle(self) -> None:
        """Let the readers take in what was sent last."""
        settle(
            [publisher for _, publisher, _, _ in self._sensors]
            + [self._truth[0]]
            + [publisher for _, publisher, _, _ in (*self._read, *self._further)]
        )

    def begin(self, start: int, command: FloatArray | None = None) -> None:
        """Drop what is left of the handshake; the run begins at `start` with this command (8,), default zero."""
        self.start = start
        for one in self.commands:
            while one.source.take() is not None:
                pass
            known = command is not None and one.topic.columns.stop <= len(command)
            one.gate.begin(start, command[one.topic.columns] if command is not None and known else None)

    def forget(self) -> None:
        """The next run counts its own rejected commands."""
        for one in self.commands:
            one.gate.rejected.clear()

    def fresh(self, now_ns: int) -> bool:
        """Whether all commands are those computed from the tick before `now_ns`."""
        return all(one.gate.fresh(now_ns) for one in self.commands)

    def apply(self, now_ns: int, out: FloatArray) -> None:
        """Write the command of a tick into `out` (8 and those of further actuators)."""
        for one in self.commands:
            one.gate.apply(now_ns, out[one.topic.columns])

    def fading(self) -> bool:
        """Whether an actuator is being brought to zero for want of commands."""
        return any(one.gate.fading for one in self.commands)

    def rejected_total(self) -> int:
        """Rejected commands of all topics."""
        return sum(one.gate.rejected.total() for one in self.commands)

    def rejections(self) -> dict[str, str]:
        """Rejected commands by topic and reason."""
        return {
            f"rejected_{one.name}_{reason}": str(count)
            for one in (self.mirror, self.forces, *self.commands[:-2])
            for reason, count in sorted(one.gate.rejected.items())
        }
