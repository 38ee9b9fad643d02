"""Estimator node: sensor topics in, ``los_estimate`` out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fsm_pma_controller.fade import Fade
from lftkit.arrays import FloatArray, IntArray
from los_testbed.bags.cdr import codec_for
from los_testbed.config.plugins import made_by
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import (
    CAMERA_LOS,
    FSM_ANGLE,
    LOS_ESTIMATE,
    SENSORS,
    TopicDefinition,
    sensor_topics,
)
from los_testbed.nodes.support.follower import Follower
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, settle
from los_testbed.parts.run_parts import RunParts, build_estimator
from los_testbed.parts.user_blocks import watched
from los_testbed.run.identity import announced
from los_testbed.run.loop.changes import appliers_of
from los_testbed.run.loop.slow_sensor import SlowSensor
from los_testbed.run.loop.stamp_synchronizer import StampSynchronizer, TickPart
from pointing_analysis.replay.gap_stepping import GapStepper
from titop_plant.interface import ESTIMATES, TICK_NS

if TYPE_CHECKING:
    from pointing_analysis.replay.replay import EstimatorCore


def main(arguments: Sequence[str] | None = None, build: Callable[[RunConfig], EstimatorCore] = build_estimator) -> int:
    """Run the node; returns the exit code."""

    def body(context: NodeContext) -> int:
        law = EstimatorLaw(context, build)
        topics = sorted(law.topics, key=lambda topic: topic.name == SENSORS[-1].name)  # the last one wakes this node
        return Follower(topics, synchronizer_of(context, topics, law.size), [law]).run()

    return run_node("estimator", arguments, body)


class EstimatorLaw:
    """The observer in its node, see :class:`~los_testbed.nodes.support.follower.NodeLaw`.

    Parameters
    ----------
    context : NodeContext
    build : callable
        Makes the observer.
    columns : ndarray of int, optional
        Where its inputs are in the joined vector of a tick; default: the vector has nothing else.

    Attributes
    ----------
    topics : tuple of TopicDefinition
        Sensors that it reads, with the columns of its inputs.
    size : int
        Number of its inputs.
    los : ndarray, shape (2,)
        Its output [rad], the same array at every tick.
    digest : str
        By which the node announces it (:func:`los_testbed.run.identity.announced`).
    """

    def __init__(self, context: NodeContext, build: Callable[[RunConfig], EstimatorCore] = build_estimator) -> None:
        self.context = context
        by_user = build is not build_estimator
        parts = RunParts(context.config)
        estimator = made_by(build, parts.config, "estimator") if by_user else build(context.config)
        self._reset = watched(estimator.reset, "reset")
        self.digest = "" if by_user else announced(parts)["estimator"]
        ports = parts.telescope_ports.of_law("k_fsm") if by_user else parts.used["k_fsm"]
        self.topics, self.size = sensor_topics(ports.sensors), ports.measurements
        self.columns: IntArray | None = None
        self.los = np.zeros(ESTIMATES)
        self._sample = np.zeros(self.size)
        self._codec = codec_for(LOS_ESTIMATE)
        self._publisher = RawPublisher(context.node, LOS_ESTIMATE.name, LOS_ESTIMATE.type_name)
        self._fade = Fade(context.config.fade_ticks)
        self.changes = context.allow_changes(appliers_of(estimator, self._fade))
        step = watched(estimator.step, "step")
        self._step = GapStepper(step, self.size, ports.held, context.config.lost_samples)

    def reset(self) -> None:
        """Back to the start of the run."""
        self._reset()
        self.los[:] = 0.0

    def step(self, vector: FloatArray, gap: int) -> None:
        """Step on the inputs in `vector`, after `gap` missing ticks."""
        sample = vector if self.columns is None else vector.take(self.columns, out=self._sample)
        self._step(sample, gap, self.los)
        if not self._fade.whole:
            self.los *= self._fade.weight()

    def publish(self, stamp: int) -> None:
        """Send the estimate."""
        self._publisher.publish(self._codec.encode(stamp, self.los))

    def settle(self) -> None:
        """Wait until the subscribers have received the last messages."""
        settle([self._publisher])


def synchronizer_of(context: NodeContext, topics: Sequence[TopicDefinition], size: int) -> StampSynchronizer:
    """Joins topics at their columns; in real time no tick waits for a slow sensor."""
    config, rates = context.config, RunParts(context.config).ports.ticks
    ticks = [topic.every(rates) for topic in topics]
    parts = [
        TickPart(codec_for(t), t.columns, every, range(t.size) if t.framed else ())
        for t, every in zip(topics, ticks, strict=True)
    ]
    if config.mode != "realtime":
        return StampSynchronizer(parts, size)
    late = (i for i, (t, every) in enumerate(zip(topics, ticks, strict=True)) if t.framed and every > 1)
    return StampSynchronizer(parts, size, {i: slow_sensor(config, topics[i]) for i in late})


def slow_sensor(config: RunConfig, topic: TopicDefinition) -> SlowSensor:
    """A sensor that no tick waits for in real time; the mirror moves what the camera sees."""
    camera, run = topic.name == CAMERA_LOS.name, RunParts(config)
    return SlowSensor(
        topic.name,
        topic.columns,
        topic.every(run.ports.ticks) * TICK_NS,
        round(config.camera_latency * TICK_NS) if camera else 0,
        config.old_frames,
        FSM_ANGLE.columns if camera else None,
        (run.basis.los_sensitivity or 0.0) if camera else 0.0,
    )


if __name__ == "__main__":
    sys.exit(main())
