"""Estimator node: sensor topics in, ``los_estimate`` out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import codec_for
from los_testbed.config import ACTIVE, RunConfig
from los_testbed.factories import RunParts, build_estimator
from los_testbed.loop.changes import Fade
from los_testbed.loop.slow_sensor import SlowSensor
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP, StampSynchronizer, TickPart
from los_testbed.nodes.support.follower import Follower
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, settle
from los_testbed.plugins import made_by
from los_testbed.topics import CAMERA_LOS, FSM_ANGLE, LOS_ESTIMATE, SENSORS, sensor_topics, shifted
from los_testbed.user_blocks import watched
from pointing_analysis.replay.gap_stepping import GapStepper
from titop_plant.interface import ESTIMATES, HELD, MEASUREMENTS, TICK_NS

if TYPE_CHECKING:
    from pointing_analysis.replay.replay import EstimatorCore


def main(arguments: Sequence[str] | None = None, build: Callable[[RunConfig], EstimatorCore] = build_estimator) -> int:
    """Run the node; returns the exit code."""

    def body(context: NodeContext) -> int:
        own = build is not build_estimator
        estimator = made_by(build, context.config, "estimator") if own else build(context.config)
        estimate, reset = watched(estimator.step, "step"), watched(estimator.reset, "reset")
        further = () if own else sensor_topics(RunParts(context.config).used["k_fsm"].sensors)
        # those of every tick before the one that wakes this node
        topics = (*SENSORS[:-1], *(shifted(topic, MEASUREMENTS) for topic in further), SENSORS[-1])
        parts = [TickPart(codec_for(t), t.columns, t.every(context.config.frame_ticks), t.framed) for t in topics]
        size = MEASUREMENTS + sum(topic.size for topic in further)
        codec = codec_for(LOS_ESTIMATE)
        publisher = RawPublisher(context.node, LOS_ESTIMATE.name, LOS_ESTIMATE.type_name)
        los, nothing = np.zeros(ESTIMATES), np.zeros(ESTIMATES)
        fade = Fade(context.config.fade_ticks)
        changes = context.allow_changes({ACTIVE: fade.turn})
        step = GapStepper(estimate, size, HELD, context.config.lost_samples)

        def tick(stamp: int, measurement: FloatArray, gap: int) -> None:
            if stamp == HOLD_STAMP:
                reset()
                publisher.publish(codec.encode(stamp, nothing))
                return
            step(measurement, gap, los)
            if not fade.whole:
                np.multiply(los, fade.weight(), out=los)
            publisher.publish(codec.encode(stamp, los))

        slow = slow_sensors(context.config) if context.config.mode == "realtime" else None
        follower = Follower(context, topics, StampSynchronizer(parts, size, slow), tick, changes)
        code = follower.run()
        settle([publisher])
        return code

    return run_node("estimator", arguments, body)


def slow_sensors(config: RunConfig) -> dict[int, SlowSensor]:
    """Sensors that no tick waits for, by their place among the topics; the mirror moves what the camera sees."""
    moved = {CAMERA_LOS.name: (FSM_ANGLE.columns, RunParts(config).basis.los_sensitivity or 0.0)}
    return {
        index: SlowSensor(
            topic.name,
            topic.columns,
            topic.every(config.frame_ticks) * TICK_NS,
            round(config.camera_latency * TICK_NS) if topic.name == CAMERA_LOS.name else 0,
            config.old_frames,
            *moved.get(topic.name, (None, 0.0)),
        )
        for index, topic in enumerate(SENSORS)
        if topic.framed and topic.every(config.frame_ticks) > 1
    }


if __name__ == "__main__":
    sys.exit(main())
