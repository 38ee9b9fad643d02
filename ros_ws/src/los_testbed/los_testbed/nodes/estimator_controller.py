"""Estimator and controller as two nodes of one process.

All samples of a tick come in one message of the plant, the estimate goes from one to the other by a function call, and
all commands leave in one message; then the topics of both nodes are published for other subscribers. Each node has its
own parameters, services, life cycle and diagnostics, as in a process of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np

from lftkit.arrays import IntArray
from los_testbed.config.topics import TopicDefinition
from los_testbed.nodes.controller import ControllerLaw
from los_testbed.nodes.estimator import EstimatorLaw, slow_sensor
from los_testbed.nodes.support.follower import Follower
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.bundle import TickBundle, command_bundle, measurement_bundle
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.stamp_synchronizer import StampSynchronizer, TickPart


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both nodes; returns the exit code."""

    def body(context: NodeContext) -> int:
        beside = NodeContext("controller", beside=context)
        try:
            parts = RunParts(context.config)
            bundle = measurement_bundle(parts)
            estimator, controller = EstimatorLaw(context), ControllerLaw(beside)
            columns = {topic.name: np.arange(topic.columns.start, topic.columns.stop) for topic in bundle.topics}
            estimator.columns = _of(estimator.topics, columns)
            controller.compose(estimator.los, _of(controller.topics, columns), command_bundle(parts))
            return Follower([bundle], _synchronizer(context, bundle), [estimator, controller]).run()
        finally:
            beside.close()

    return run_node("estimator", arguments, body)


def _of(topics: Sequence[TopicDefinition], columns: Mapping[str, IntArray]) -> IntArray:
    """Columns of these topics, one after the other."""
    return np.concatenate([np.zeros(0, int), *(columns[topic.name] for topic in topics)])


def _synchronizer(context: NodeContext, bundle: TickBundle) -> StampSynchronizer:
    """Of the one message; the frames of slow sensors in it are used when they come, in real time."""
    config, rates = context.config, RunParts(context.config).ports.ticks
    slow = [topic for topic in bundle.topics if topic.name in bundle.ages]
    some = [t for t in bundle.topics if t.framed or t.every(rates) > 1]
    absent = [column for t in some for column in range(t.columns.start, t.columns.stop)] + list(bundle.ages.values())
    frames = [(1 + i, bundle.ages[topic.name]) for i, topic in enumerate(slow)]
    named = {topic.name: topic.columns for topic in bundle.topics}
    part = TickPart(bundle.codec(), slice(0, bundle.size), 1, absent, frames, named)
    sensors = {number: slow_sensor(config, topic) for (number, _), topic in zip(frames, slow, strict=True)}
    return StampSynchronizer([part], bundle.size, sensors if config.mode == "realtime" else None)


if __name__ == "__main__":
    sys.exit(main())
