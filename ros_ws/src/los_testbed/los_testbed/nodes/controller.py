"""Controller node: ``los_estimate`` and ``isolator/accel`` in, both command topics out.

A law of the user takes in further sensors of the telescope's file, too, and commands further actuators.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import codec_for
from los_testbed.config import ACTIVE, RunConfig
from los_testbed.factories import RunParts, build_controller
from los_testbed.law_devices import NO_DEVICES
from los_testbed.loop.changes import Apply, Fade
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP, StampSynchronizer, TickPart
from los_testbed.nodes.support.follower import Follower
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, settle
from los_testbed.plugins import made_by
from los_testbed.topics import COMMANDS, ISOLATOR_ACCEL, LOS_ESTIMATE, actuator_topics, sensor_topics, shifted
from los_testbed.user_blocks import watched
from pointing_analysis.replay.gap_stepping import GapStepper
from titop_plant.interface import COMMANDS as COMMAND_SIZE
from titop_plant.interface import DesignBasis

if TYPE_CHECKING:
    from pointing_analysis.replay.replay import ControllerCore

ESTIMATE = slice(0, LOS_ESTIMATE.size)
ACCEL = slice(ESTIMATE.stop, ESTIMATE.stop + ISOLATOR_ACCEL.size)
"""Columns of what this node takes in at a tick."""


def main(
    arguments: Sequence[str] | None = None, build: Callable[[RunConfig], ControllerCore] = build_controller
) -> int:
    """Run the node; returns the exit code."""

    def body(context: NodeContext) -> int:
        own = build is not build_controller
        run = RunParts(context.config)
        controller = made_by(build, context.config, "controller") if own else run.controller()
        control, reset = watched(controller.step, "step"), watched(controller.reset, "reset")
        if not own:
            context.warn_alone(run.check())
        devices = NO_DEVICES if own else run.used["k_pma"]
        further = tuple(shifted(topic, ACCEL.stop) for topic in sensor_topics(devices.sensors))
        size = ACCEL.stop + sum(topic.size for topic in further)
        parts = [
            TickPart(codec_for(ISOLATOR_ACCEL), ACCEL),
            *(TickPart(codec_for(topic), topic.columns) for topic in further),
            TickPart(codec_for(LOS_ESTIMATE), ESTIMATE),
        ]
        topics = (*actuator_topics(devices.actuators), *COMMANDS)  # the last ones close the tick
        outputs = [(RawPublisher(context.node, t.name, t.type_name), codec_for(t), t.columns) for t in topics]
        command, nothing = (np.zeros(COMMAND_SIZE + len(devices.actuators)) for _ in range(2))
        fill = context.config.lost_samples
        step = GapStepper(lambda sample, out: control(sample[ESTIMATE], sample[ESTIMATE.stop :], out), size, fill=fill)
        fade = Fade(context.config.fade_ticks)
        changes = context.allow_changes({ACTIVE: fade.turn, **_appliers(controller)}, _limits(run.basis))
        slots = [(publisher, codec, command[c], nothing[c]) for publisher, codec, c in outputs]

        def tick(stamp: int, sample: FloatArray, gap: int) -> None:
            if stamp == HOLD_STAMP:
                reset()
                for publisher, codec, _, zero in slots:
                    publisher.publish(codec.encode(stamp, zero))
                return
            step(sample, gap, command)
            if not fade.whole:
                np.multiply(command, fade.weight(), out=command)
            for publisher, codec, values, _ in slots:
                publisher.publish(codec.encode(stamp, values))

        synchronizer = StampSynchronizer(parts, size, {} if context.config.mode == "realtime" else None)
        follower = Follower(context, (ISOLATOR_ACCEL, *further, LOS_ESTIMATE), synchronizer, tick, changes)
        code = follower.run()
        settle([publisher for publisher, _, _ in outputs])
        return code

    return run_node("controller", arguments, body)


def _appliers(controller: ControllerCore) -> dict[str, Apply]:
    """Settings that a controller can change, those of the package's own at least."""
    if not isinstance(controller, FsmPmaController):
        return {}
    return {
        "loop": controller.switch,
        "fsm_authority": lambda value: controller.limit(fsm_authority=value),
        "pma_authority": lambda value: controller.limit(pma_authority=value),
    }


def _limits(telescope: DesignBasis) -> dict[str, float]:
    """Authorities of the start: the plant rejects more."""
    return dict(zip(("fsm_authority", "pma_authority"), telescope.authority))


if __name__ == "__main__":
    sys.exit(main())
