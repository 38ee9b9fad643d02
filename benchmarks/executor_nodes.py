"""The loop as one writes it with rclpy: callbacks with message objects, a ROS timer, an executor. For comparison only.

    python benchmarks/executor_nodes.py plant|estimator|controller KIND --ros-args --params-file run.yaml

KIND is events, single, or events-real-time, which has the priorities and processors of the testbed's own nodes.

The same cores, topics, stamps and recorder as the testbed's own nodes; rclpy, middleware and process as they come:
default transports and profile, ordinary scheduling and timers, collector on. The plant measures the same figures; the
arrival of a command is its callback, because callbacks with message information fail on EventsExecutor (rclpy 7.1.6).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from typing import Any

import numpy as np
from los_testbed.config.topics import (
    ACCEL,
    COMMAND_TOPICS,
    FSM_COMMAND,
    ISOLATOR_ACCEL,
    JOINT_STATE,
    LOS_ESTIMATE,
    PMA_COMMAND,
    PROGRESS_TOPIC,
    SENSORS,
    TRUTH_LOS,
    TopicDefinition,
)
from los_testbed.nodes.support import node_context
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.raw_topics import MESSAGES
from los_testbed.parts.run_parts import RunParts, build_controller, build_estimator, build_plant
from los_testbed.run.loop.closed_loop import aligned_start
from los_testbed.run.loop.latency_histogram import LatencyHistogram
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor

from lftkit.support.threads import one_thread
from pointing_analysis.read.messages.message_types import HEADER
from titop_plant.interface import TICK_NS

NS = 1_000_000_000
RING = 64
HOLD_TICKS = 20


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec) * NS + int(message.header.stamp.nanosec)


def read(message: Any, topic: TopicDefinition, out: np.ndarray) -> None:
    if topic.type_name == ACCEL:
        linear, angular = message.accel.linear, message.accel.angular
        out[:] = linear.x, linear.y, linear.z, angular.x, angular.y, angular.z
    elif topic.type_name == JOINT_STATE:
        out[:] = message.effort
    else:
        out[:] = message.vector.x, message.vector.y


class Output:
    """Publisher of a topic; each sample is a message object."""

    def __init__(self, context: NodeContext, topic: TopicDefinition) -> None:
        kind = MESSAGES[topic.type_name]
        self.topic, self.kind = topic, kind
        self.publisher = context.node.create_publisher(kind, topic.name, 10)

    def send(self, stamp: int, values: np.ndarray) -> None:
        message, numbers = self.kind(), values.tolist()
        message.header.frame_id = self.topic.frame_id
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NS)
        if self.topic.type_name == ACCEL:
            linear, angular = message.accel.linear, message.accel.angular
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers
        elif self.topic.type_name == JOINT_STATE:
            message.effort = numbers
        else:
            message.vector.x, message.vector.y = numbers
        self.publisher.publish(message)


class Synchronizer:
    """Samples of a tick by stamp; `tick(stamp, vector)` when all that are due have come."""

    def __init__(
        self, context: NodeContext, topics: tuple[TopicDefinition, ...], columns: list[slice], size: int, tick: Any
    ) -> None:
        self.pending: dict[int, tuple[np.ndarray, set[int]]] = {}
        self.size, self.tick = size, tick
        self.periods = [topic.every(RunParts(context.config).ports.ticks) * TICK_NS for topic in topics]
        for index, topic in enumerate(topics):
            callback = self.callback(index, topic, columns[index])
            context.node.create_subscription(MESSAGES[topic.type_name], topic.name, callback, 10)

    def callback(self, index: int, topic: TopicDefinition, columns: slice) -> Any:
        def receive(message: Any) -> None:
            stamp = stamp_of(message)
            if stamp not in self.pending:
                self.pending[stamp] = (np.full(self.size, np.nan), set())
            vector, seen = self.pending[stamp]
            read(message, topic, vector[columns])
            seen.add(index)
            due = sum(stamp % period == 0 for period in self.periods)
            if len(seen) == due:
                self.pending = {s: entry for s, entry in self.pending.items() if s > stamp}
                self.tick(stamp, vector)

        return receive


class PlantTimer:
    """Plant on a ROS timer of 1 ms."""

    def __init__(self, context: NodeContext) -> None:
        self.context, self.core = context, build_plant(context.config)
        self.core.reset()
        self.sensors, self.truth_output = [Output(context, t) for t in SENSORS], Output(context, TRUTH_LOS)
        self.ports = RunParts(context.config).ports
        self.frame_ns = self.core.frame_ticks * TICK_NS
        self.command, self.measurement, self.truth = np.zeros(8), np.zeros(22), np.zeros(2)
        self.latency, self.lateness, self.execution = LatencyHistogram(), LatencyHistogram(), LatencyHistogram()
        self.woke = [0] * RING
        self.newest = {FSM_COMMAND.name: 0, PMA_COMMAND.name: 0}
        self.echoes: set[str] = set()
        self.start = self.begin = self.k = self.held = self.skipped = self.calls = 0
        for topic in COMMAND_TOPICS:
            kind = MESSAGES[topic.type_name]
            context.node.create_subscription(kind, topic.name, self.receiver(topic), 10)
        context.node.create_subscription(MESSAGES[HEADER], PROGRESS_TOPIC, lambda m: self.echoes.add("recorder"), 10)
        self.timer = context.node.create_timer(1e-3, self.tick)
        context.event("alone")

    def receiver(self, topic: TopicDefinition) -> Any:
        values = self.command[topic.columns]

        def receive(message: Any) -> None:
            stamp = stamp_of(message)
            if stamp == 0:
                self.echoes.add(topic.name)
            elif stamp > self.newest[topic.name]:
                self.newest[topic.name] = stamp
                read(message, topic, values)
                if topic is FSM_COMMAND:
                    self.latency.add(time.time_ns() - self.woke[((stamp - self.start) // TICK_NS) % RING])

        return receive

    def tick(self) -> None:
        now = time.monotonic_ns()
        if not self.start:
            self.hold(now)
            return
        due = self.begin + (self.k + self.skipped) * TICK_NS
        late = now - due
        if late >= TICK_NS:
            self.skipped += late // TICK_NS
        self.lateness.add(late)
        self.woke[self.k % RING] = time.time_ns()
        stamp = self.start + self.k * TICK_NS
        if self.k and min(self.newest.values()) < stamp - TICK_NS:
            self.held += 1
        if self.k == self.context.config.ticks or self.context.stop:
            self.context.end()
            return
        self.core.step(self.command, self.measurement, self.truth)
        self.send(stamp)
        self.execution.add(time.monotonic_ns() - now)
        self.k += 1
        if self.k % 100 == 50:
            self.context.event("progress", tick=self.k)

    def send(self, stamp: int) -> None:
        for output in self.sensors:
            if stamp % (output.topic.every(self.ports.ticks) * TICK_NS) == 0:
                output.send(stamp, self.measurement[output.topic.columns])
        self.truth_output.send(stamp, self.truth)

    def hold(self, now: int) -> None:
        self.calls += 1
        if len(self.echoes) < 3 and self.calls % HOLD_TICKS == 0:
            self.send(0)
        elif len(self.echoes) == 3 and self.calls % HOLD_TICKS == 0:
            self.start = aligned_start(time.time_ns(), self.ports.period)
            self.begin = now + TICK_NS
            self.context.event("running", start_ns=self.start)

    def finish(self) -> None:
        statistics = {
            "ticks": str(self.k),
            "missed_ticks": str(self.held + self.skipped),
            "skipped_periods": str(self.skipped),
            **self.latency.summary("latency"),
            **self.lateness.summary("lateness"),
            **self.execution.summary("execution"),
        }
        self.context.event("done", statistics=statistics, latency=self.latency.histogram())


class Estimator:
    def __init__(self, context: NodeContext) -> None:
        self.core, self.output, self.los = build_estimator(context.config), Output(context, LOS_ESTIMATE), np.zeros(2)
        self.synchronizer = Synchronizer(context, SENSORS, [t.columns for t in SENSORS], 22, self.tick)
        context.event("ready")

    def tick(self, stamp: int, measurement: np.ndarray) -> None:
        if stamp:
            self.core.step(measurement, self.los)
        self.output.send(stamp, self.los)

    def finish(self) -> None:
        pass


class Controller:
    def __init__(self, context: NodeContext) -> None:
        self.core, self.outputs = build_controller(context.config), [Output(context, t) for t in COMMAND_TOPICS]
        self.command = np.zeros(8)
        self.synchronizer = Synchronizer(
            context, (ISOLATOR_ACCEL, LOS_ESTIMATE), [slice(2, 8), slice(0, 2)], 8, self.tick
        )
        context.event("ready")

    def tick(self, stamp: int, sample: np.ndarray) -> None:
        if stamp:
            self.core.step(sample[:2], sample[2:], self.command)
        for output in self.outputs:
            output.send(stamp, self.command[output.topic.columns])

    def finish(self) -> None:
        pass


NODES: dict[str, Any] = {"plant": PlantTimer, "estimator": Estimator, "controller": Controller}


def main() -> int:
    if len(sys.argv) < 3:
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    name, kind, *arguments = sys.argv[1:]

    if kind != "events-real-time":
        node_context.sharpen_timers = lambda: None  # the process as it comes

    def body(context: NodeContext) -> int:
        with one_thread():
            node = NODES[name](context)
            executor = SingleThreadedExecutor() if kind == "single" else EventsExecutor()
            executor.add_node(context.node)
            if kind == "events-real-time":
                context.become_real_time()
            while not context.stop:  # without a finite timeout the events executor keeps the interpreter to itself
                executor.spin_once(timeout_sec=0.1)
            node.finish()
            time.sleep(0.5)  # the last samples arrive
        return 0

    return run_node(name, arguments, body)


if __name__ == "__main__":
    sys.exit(main())
