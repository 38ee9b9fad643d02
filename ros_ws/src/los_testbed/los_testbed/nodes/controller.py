"""Controller node: ``los_estimate`` and the sensors of K_PMA in, such as ``isolator/accel``; command topics out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fsm_pma_controller.fade import Fade
from lftkit.arrays import FloatArray, IntArray
from los_testbed.bags.cdr import codec_for
from los_testbed.config.plugins import made_by
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import COMMAND_TOPICS, LOS_ESTIMATE, command_topics, sensor_topics
from los_testbed.nodes.estimator import synchronizer_of
from los_testbed.nodes.support.follower import Follower
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.transport.bundle import TickBundle
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, settle
from los_testbed.parts.run_parts import RunParts, build_controller
from los_testbed.parts.user_blocks import watched
from los_testbed.run.identity import announced
from los_testbed.run.loop.changes import appliers_of
from pointing_analysis.replay.gap_stepping import GapStepper
from titop_plant.interface import DesignBasis

if TYPE_CHECKING:
    from pointing_analysis.replay.replay import ControllerCore

ESTIMATE = slice(0, LOS_ESTIMATE.size)
"""Columns of the estimate in what this node takes in at a tick; the sensors are behind it."""


def main(
    arguments: Sequence[str] | None = None, build: Callable[[RunConfig], ControllerCore] = build_controller
) -> int:
    """Run the node; returns the exit code."""

    def body(context: NodeContext) -> int:
        law = ControllerLaw(context, build)
        topics = (*law.topics, replace(LOS_ESTIMATE, columns=ESTIMATE))
        return Follower(topics, synchronizer_of(context, topics, law.size), [law]).run()

    return run_node("controller", arguments, body)


class ControllerLaw:
    """Mirror and proof-mass laws in their node, see :class:`~los_testbed.nodes.support.follower.NodeLaw`.

    Parameters
    ----------
    context : NodeContext
    build : callable
        Makes the controller.

    Attributes
    ----------
    topics : tuple of TopicDefinition
        Sensors that it reads, with the columns of its inputs.
    size : int
        Number of its inputs.
    command : ndarray, shape (u,)
        Its output [rad, N], the same array at every tick.
    digest : str
        By which the node announces it (:func:`los_testbed.run.identity.announced`).
    """

    def __init__(self, context: NodeContext, build: Callable[[RunConfig], ControllerCore] = build_controller) -> None:
        self.context = context
        by_user = build is not build_controller
        run = RunParts(context.config)
        controller = made_by(build, run.config, "controller") if by_user else run.controller()
        if not by_user:
            context.warn_alone(run.check())
        self.digest = "" if by_user else announced(run)["controller"]
        ports = run.telescope_ports.used_by() if by_user else run.ports
        used = run.telescope_ports.of_law("k_pma") if by_user else run.used["k_pma"]
        self._reset, control = watched(controller.reset, "reset"), watched(controller.step, "step")
        first = ESTIMATE.stop
        self.topics = tuple(
            replace(topic, columns=slice(first + topic.columns.start, first + topic.columns.stop))
            for topic in sensor_topics(used.sensors)
        )
        self.size = first + used.measurements
        self.command = np.zeros(ports.commands)
        placed = [topic for topic in command_topics(ports.actuators) if topic not in COMMAND_TOPICS]
        topics = (*placed, *COMMAND_TOPICS)  # the last ones close the tick
        self._outputs = [
            (RawPublisher(context.node, t.name, t.type_name), codec_for(t), self.command[t.columns]) for t in topics
        ]
        self._sample = np.zeros(self.size)
        self._estimate: FloatArray = np.zeros(0)
        self._columns: IntArray | None = None
        self._step = GapStepper(
            lambda sample, out: control(sample[ESTIMATE], sample[ESTIMATE.stop :], out),
            self.size,
            first + used.held,
            context.config.lost_samples,
        )
        self._fade = Fade(context.config.fade_ticks)
        self.changes = context.allow_changes(appliers_of(controller, self._fade), _limits(run.basis))

    def compose(self, estimate: FloatArray, columns: IntArray, bundle: TickBundle) -> None:
        """Read the estimate of an observer in this process; publish the commands in one message before their topics.

        Parameters
        ----------
        estimate : ndarray, shape (2,)
            Output of the observer, the same array at every tick.
        columns : ndarray of int
            Where the other inputs are in the joined vector of a tick.
        bundle : TickBundle
            The message.
        """
        self._estimate, self._columns = estimate, columns
        whole = RawPublisher(self.context.node, bundle.name, bundle.type_name), bundle.codec(), self.command
        self._outputs.insert(0, whole)

    def reset(self) -> None:
        """Back to the start of the run."""
        self._reset()
        self.command[:] = 0.0

    def step(self, vector: FloatArray, gap: int) -> None:
        """Step on the inputs in `vector`, after `gap` missing ticks."""
        sample = vector
        if self._columns is not None:
            sample = self._sample
            sample[ESTIMATE] = self._estimate
            sample[ESTIMATE.stop :] = vector[self._columns]
        self._step(sample, gap, self.command)
        if not self._fade.whole:
            self.command *= self._fade.weight()

    def publish(self, stamp: int) -> None:
        """Send the commands."""
        for publisher, codec, values in self._outputs:
            publisher.publish(codec.encode(stamp, values))

    def settle(self) -> None:
        """Wait until the subscribers have received the last messages."""
        settle([publisher for publisher, _, _ in self._outputs])


def _limits(telescope: DesignBasis) -> dict[str, float]:
    """Authorities of the start: the plant rejects more."""
    return dict(zip(("fsm_authority", "pma_authority"), telescope.authority))


if __name__ == "__main__":
    sys.exit(main())
