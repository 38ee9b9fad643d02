"""Topics of the plant node: sensors and truth out, commands in through their gates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, CodecError, codec_for
from los_testbed.config.topics import (
    COMMAND_TOPICS,
    IMAGE_VECTOR,
    PROGRESS_TOPIC,
    SENSORS,
    TOPICS,
    TRUTH_LOS,
    TopicDefinition,
    command_topics,
)
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.source_watch import SourceWatch
from los_testbed.nodes.support.transport.bundle import TickBundle, command_bundle, measurement_bundle
from los_testbed.nodes.support.transport.raw_topics import (
    LOCKSTEP_DEPTH,
    READER_DEPTH,
    RawPublisher,
    RawSubscription,
    settle,
)
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.command_gate import CommandGate
from pointing_analysis.read.messages.message_types import HEADER
from titop_plant.interface import TICK_NS

Frames = Mapping[str, tuple[int, FloatArray]]
"""Stamp [ns] and values of samples of slow sensors, by port."""

Accepted = Callable[[int, int], None]

Output = tuple[TopicDefinition, RawPublisher, Codec, int]
"""Topic, publisher, codec and period [ns] of a message of the plant."""


def _ignore(stamp: int, received: int) -> None:
    """No requester."""


@dataclass(frozen=True)
class CommandInput:
    """Commands of one topic on their way to the plant.

    Parameters
    ----------
    name : str
        In the names of statistics.
    topic : TopicDefinition
    gate : CommandGate
    """

    name: str
    topic: TopicDefinition
    gate: CommandGate


class CommandReader:
    """A subscription with commands: of one topic, or the message with those of all.

    Parameters
    ----------
    source : RawSubscription
    codec : Codec
        Bytes of its messages.
    inputs : sequence of CommandInput
        To whose gates the values go.
    """

    def __init__(self, source: RawSubscription, codec: Codec, inputs: Sequence[CommandInput]) -> None:
        self.source = source
        self.inputs = tuple(inputs)
        self._codec = codec
        self._values = np.zeros(codec.size)
        first = min(one.topic.columns.start for one in inputs)
        self._gates = [
            (one.gate, self._values[one.topic.columns.start - first : one.topic.columns.stop - first]) for one in inputs
        ]

    def take(self, now_ns: int, steady_ns: int, accepted: Accepted) -> None:
        """Offer every message that has come to the gates.

        Parameters
        ----------
        now_ns : int
            Stamp of the tick at which the commands are applied.
        steady_ns : int
            Steady clock.
        accepted : callable
            Called with stamp and time of arrival (wall clock) of each message that all gates accept [ns].
        """
        while (taken := self.source.take()) is not None:
            source = self.source.sort(taken, steady_ns)
            try:
                stamp = self._codec.decode(taken.data, self._values)
            except CodecError as error:
                for gate, _ in self._gates:
                    gate.rejected[error.reason] += 1
                continue
            offered = [gate.offer_values(stamp, values, now_ns, source) for gate, values in self._gates]
            if all(offered):
                accepted(stamp, taken.received)

    def stamp_of(self, taken: Taken) -> int:
        """Stamp of a message [ns]; -1 of one that cannot be read."""
        try:
            return self._codec.decode(taken.data, self._values)
        except CodecError:
            return -1

    def empty(self) -> None:
        """Drop what has come."""
        while self.source.take() is not None:
            pass


class PlantIo:
    """Publishers, subscriptions and gates of the plant.

    Commands come in the message of all of them or, from nodes that do not send that, in their topics:
    :meth:`choose_readers` decides when all have responded. Until then both are read.
    """

    def __init__(self, context: NodeContext) -> None:
        config, node, parts = context.config, context.node, RunParts(context.config)
        self.ports = parts.ports

        def output(topic: TopicDefinition) -> Output:
            publisher = RawPublisher(node, topic.name, topic.type_name)
            return topic, publisher, codec_for(topic), topic.every(self.ports.ticks) * TICK_NS

        self._bundle = measurement_bundle(parts)
        self._whole = RawPublisher(node, self._bundle.name, self._bundle.type_name), self._bundle.codec()
        self._packed = np.zeros(self._bundle.size)
        self._waiting: dict[str, tuple[int, FloatArray]] = {}
        self._sensors = [output(topic) for topic in SENSORS]
        self._ages = [
            (topic, self._bundle.ages[topic.name], period)
            for topic, _, _, period in self._sensors
            if topic.name in self._bundle.ages
        ]
        self._truth = output(TRUTH_LOS)
        others = [topic for topic in parts.topics[len(TOPICS) :] if topic.publisher == "plant"]
        self._placed = [output(topic) for topic in others if topic.vector != IMAGE_VECTOR]
        self._images = [output(topic) for topic in others if topic.vector == IMAGE_VECTOR]
        every = config.mode == "lockstep"  # time stands still until a lost command was sent again

        def subscribe(topic: TopicDefinition | TickBundle) -> RawSubscription:
            depth = LOCKSTEP_DEPTH if every else READER_DEPTH
            return RawSubscription(node, topic.name, topic.type_name, depth, every, topic.publisher)

        hold = config.hold_ticks, config.fade_ticks

        def command(name: str, topic: TopicDefinition, limit: float) -> CommandInput:
            return CommandInput(name, topic, CommandGate(codec_for(topic), limit, *hold))

        mirror, force = parts.basis.authority
        mirror_topic, force_topic = COMMAND_TOPICS
        rows = zip(self.ports.actuators, command_topics(self.ports.actuators), strict=True)
        placed = [command(row.name, topic, row.authority) for row, topic in rows if topic not in COMMAND_TOPICS]
        self.mirror, self.forces = command("fsm", mirror_topic, mirror), command("pma", force_topic, force)
        self.commands = (*placed, self.mirror, self.forces)
        """Command topics in the order in which the controller sends them."""
        whole = command_bundle(parts)
        self.bundle_reader = CommandReader(subscribe(whole), whole.codec(), self.commands)
        self.topic_readers = [CommandReader(subscribe(one.topic), codec_for(one.topic), [one]) for one in self.commands]
        self.readers: list[CommandReader] = [self.bundle_reader, *self.topic_readers]
        self.progress_input = RawSubscription(node, PROGRESS_TOPIC, HEADER, publisher="recorder")
        self.watch = SourceWatch(node, [*(reader.source for reader in self.readers), self.progress_input])
        self.start = 0

    def choose_readers(self, bundled: bool) -> None:
        """Take commands from the message of all from now on, or from their topics.

        Unused subscriptions are closed, since they cost time at every tick.
        """
        self.readers = [self.bundle_reader] if bundled else list(self.topic_readers)
        if bundled:
            for reader in self.topic_readers:
                reader.source.close()

    def pack(self, stamp: int, measurement: FloatArray) -> None:
        """Prepare the message with all samples of a tick, before its deadline."""
        packed = self._packed
        packed[: len(measurement)] = measurement
        for _, column, period in self._ages:
            packed[column] = 0.0 if stamp % period == 0 else np.nan
        self._whole[1].encode(stamp, packed)

    def publish(self, stamp: int, measurement: FloatArray, truth: FloatArray, image: FloatArray | None = None) -> None:
        """Send a tick that was packed: the message first, then the topics, slower ones only at their ticks.

        Of a camera that takes images `image` are its pixels, row by row; None: all zero.
        """
        publisher, codec = self._whole
        publisher.publish(codec.message)
        for topic, publisher, codec, period in self._sensors:
            if period == TICK_NS or stamp % period == 0:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        _, publisher, codec, _ = self._truth
        publisher.publish(codec.encode(stamp, truth))
        for topic, publisher, codec, period in self._placed:
            if stamp % period == 0:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        for topic, publisher, codec, period in self._images:
            if stamp % period == 0:
                publisher.publish(codec.encode(stamp, np.zeros(topic.size) if image is None else image))

    def publish_samples(self, stamp: int, measurement: FloatArray | None, frames: Frames, truth: str) -> None:
        """Publish a device's samples of a tick: frames with their stamps, the estimator's trigger last.

        Parameters
        ----------
        stamp : of the tick [ns]
        measurement : (m,), of which the columns of the sensors of every tick are sent; None: nothing is
        frames : stamp and values of slower sensors, by port
        truth : port of the true line of sight
        """
        self._waiting |= frames
        if measurement is not None:
            self._publish_with_ages(stamp, measurement)
        for topic, publisher, codec, _ in self._sensors:
            if topic.framed:
                if topic.port in frames:
                    publisher.publish(codec.encode(*frames[topic.port]))
            elif measurement is not None:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        if truth in frames and measurement is not None:
            _, publisher, codec, _ = self._truth
            publisher.publish(codec.encode(stamp, frames[truth][1]))

    def _publish_with_ages(self, stamp: int, measurement: FloatArray) -> None:
        """Send the message with the samples of a tick and the newest frames that have come since the one before."""
        self.pack(stamp, measurement)
        publisher, codec = self._whole
        for topic, column, _ in self._ages:
            acquired, values = self._waiting.pop(topic.port, (0, np.nan))
            self._packed[topic.columns] = values
            self._packed[column] = (stamp - acquired) * 1e-9 if acquired else np.nan
        publisher.publish(codec.encode(stamp, self._packed))

    def framed_at(self, stamp: int) -> list[str]:
        """Topics with a sample at some ticks only, which have one at this."""
        outputs = (*self._sensors, *self._placed, *self._images)
        slow = [(topic.name, period) for topic, _, _, period in outputs if period > TICK_NS]
        return [name for name, period in slow if stamp % period == 0]

    def settle(self) -> None:
        """Wait until the subscribers have received the last messages."""
        outputs = [publisher for _, publisher, _, _ in (*self._sensors, self._truth, *self._placed, *self._images)]
        settle([self._whole[0], *outputs])

    def begin(self, start: int, command: FloatArray | None = None) -> None:
        """Discard messages of the handshake; the run begins at `start` with this command, default zero."""
        self.start = start
        self._waiting.clear()
        for reader in self.readers:
            reader.empty()
        for one in self.commands:
            known = command is not None and one.topic.columns.stop <= len(command)
            one.gate.begin(start, command[one.topic.columns] if command is not None and known else None)

    def forget(self) -> None:
        """Reset the counts of rejected commands for the next run."""
        for one in self.commands:
            one.gate.rejected.clear()

    def take(self, now_ns: int, steady_ns: int, accepted: Accepted = _ignore) -> None:
        """Offer all commands that have come to the gates.

        Parameters
        ----------
        now_ns : int
            Stamp of the tick at which they are applied.
        steady_ns : int
            Steady clock.
        accepted : callable
            Called with stamp and time of arrival (wall clock) of each command of the mirror that is accepted [ns].
        """
        for reader in self.readers:
            reader.take(now_ns, steady_ns, accepted if self.mirror in reader.inputs else _ignore)

    def fresh(self, now_ns: int) -> bool:
        """Whether all commands are those computed from the tick before `now_ns`."""
        return all(one.gate.fresh(now_ns) for one in self.commands)

    def unanswered(self, now_ns: int) -> list[str]:
        """Topics on which no command has come that was computed from the tick before `now_ns`."""
        late = [one for one in self.commands if not one.gate.fresh(now_ns)]
        return [reader.source.name for reader in self.readers if any(one in late for one in reader.inputs)]

    def apply(self, now_ns: int, out: FloatArray) -> None:
        """Write the command of a tick into `out`."""
        for one in self.commands:
            one.gate.apply(now_ns, out[one.topic.columns])

    def fading(self) -> bool:
        """Whether an actuator is fading to zero for lack of commands."""
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
