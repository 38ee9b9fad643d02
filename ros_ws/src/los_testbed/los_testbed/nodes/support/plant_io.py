"""Topics of the plant node: sensors and truth out, commands in through their gates."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import codec_for
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
from los_testbed.topics import FSM_COMMAND, PMA_COMMAND, PROGRESS_TOPIC, SENSORS, TOPICS, TRUTH_LOS, TopicDefinition
from pointing_analysis.read.messages.message_types import HEADER
from titop_plant.interface import FORCES, MIRROR, TICK_NS

NOTHING: Mapping[str, FloatArray] = MappingProxyType({})


class PlantIo:
    """Publishers, subscriptions and gates of the plant."""

    def __init__(self, context: NodeContext) -> None:
        config, node = context.config, context.node

        def output(topic: TopicDefinition) -> tuple[TopicDefinition, RawPublisher]:
            return topic, RawPublisher(node, topic.name, topic.type_name)

        self._sensors = [
            (topic, publisher, codec_for(topic), topic.every(config.frame_ticks) * TICK_NS)
            for topic, publisher in map(output, SENSORS)
        ]
        self._truth = output(TRUTH_LOS)[1], codec_for(TRUTH_LOS)
        self._further = [
            (topic, publisher, codec_for(topic), topic.every(config.frame_ticks) * TICK_NS)
            for topic, publisher in map(output, RunParts(config).topics[len(TOPICS) :])
        ]
        every = config.mode == "lockstep"  # time stands still until a lost command was sent again

        def subscribe(topic: TopicDefinition) -> RawSubscription:
            depth = LOCKSTEP_DEPTH if every else READER_DEPTH
            return RawSubscription(node, topic.name, topic.type_name, depth, every, topic.publisher)

        self.fsm_input = subscribe(FSM_COMMAND)
        self.pma_input = subscribe(PMA_COMMAND)
        self.progress_input = RawSubscription(node, PROGRESS_TOPIC, HEADER, publisher="recorder")
        self.watch = SourceWatch(node, [self.fsm_input, self.pma_input, self.progress_input])
        hold = config.hold_ticks, config.fade_ticks
        mirror, force = RunParts(config).basis.authority
        self.fsm_gate = CommandGate(codec_for(FSM_COMMAND), mirror, *hold)
        self.pma_gate = CommandGate(codec_for(PMA_COMMAND), force, *hold)
        self._none = np.zeros(1)  # of hold ticks: all values
        self.start = 0

    def publish(
        self, stamp: int, measurement: FloatArray, truth: FloatArray, further: Mapping[str, FloatArray] = NOTHING
    ) -> None:
        """Send a tick; slower sensors only on theirs. The estimator's trigger goes before truth, image and readings.

        `further` holds the vectors behind those of the loop, by their names.
        """
        for topic, publisher, codec, period in self._sensors:
            if period == TICK_NS or stamp % period == 0:
                publisher.publish(codec.encode(stamp, measurement[topic.columns]))
        publisher, codec = self._truth
        publisher.publish(codec.encode(stamp, truth))
        for topic, publisher, codec, period in self._further:
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
            + [publisher for _, publisher, _, _ in self._further]
        )

    def begin(self, start: int, command: FloatArray | None = None) -> None:
        """Drop what is left of the handshake; the run begins at `start` with this command (8,), default zero."""
        self.start = start
        for subscription in (self.fsm_input, self.pma_input):
            while subscription.take() is not None:
                pass
        self.fsm_gate.begin(start, None if command is None else command[MIRROR])
        self.pma_gate.begin(start, None if command is None else command[FORCES])

    def forget(self) -> None:
        """The next run counts its own rejected commands."""
        for gate in (self.fsm_gate, self.pma_gate):
            gate.rejected.clear()

    def fresh(self, now_ns: int) -> bool:
        """Whether both commands are those computed from the tick before `now_ns`."""
        return self.fsm_gate.fresh(now_ns) and self.pma_gate.fresh(now_ns)

    def fading(self) -> bool:
        """Whether an actuator is being brought to zero for want of commands."""
        return self.fsm_gate.fading or self.pma_gate.fading

    def rejected_total(self) -> int:
        """Rejected commands of both topics."""
        return sum(self.fsm_gate.rejected.values()) + sum(self.pma_gate.rejected.values())

    def rejections(self) -> dict[str, str]:
        """Rejected commands by topic and reason."""
        gates = (("fsm", self.fsm_gate), ("pma", self.pma_gate))
        return {
            f"rejected_{name}_{reason}": str(count)
            for name, gate in gates
            for reason, count in sorted(gate.rejected.items())
        }
