"""Replaces the plant: publishes the sensors of a bag at their own times and stores the outputs of the nodes.

The stamps are those of the bag, so the outputs have them, too, and are compared with the recorded ones tick by tick.
Commands have no effect on the sensors.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, CodecError, codec_for, stamp_of, with_stamp
from los_testbed.config.run_config import NAMESPACE
from los_testbed.config.topics import (
    FSM_COMMAND,
    IMAGE_NAME,
    LOS_ESTIMATE,
    PMA_COMMAND,
    SENSORS,
    TRUTH_LOS,
    TopicDefinition,
    placed_topics,
)
from los_testbed.nodes.support.handshake import HOLD_PERIOD_S, OtherPlants
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, RawSubscription
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.run.loop.tick_clock import wait_until
from los_testbed.run.processes.domains import domain_lock
from los_testbed.run.processes.ros_variables import DOMAIN_VARIABLE, domain_of
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.message_types import IMAGE
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import LoopLayout, Replayed
from titop_plant.interface import TICK_NS

ANSWERS = (LOS_ESTIMATE, FSM_COMMAND, PMA_COMMAND)
ANSWER_DEPTH = 1000
DISCOVERY_S = 1.5
"""A running node is discovered within this time; a topic without a publisher by then is not waited for."""
LAST_ANSWERS_S = 0.5

Signal = tuple[NDArray[np.int64], FloatArray]


@dataclass(frozen=True)
class Played:
    """Published ticks and received outputs.

    Parameters
    ----------
    sent : tuple of str
        Topics that were published.
    ticks, late : int
        Ticks sent; those of them a tick or more behind their time.
    answers : dict of str to (stamps, values)
        Estimates and commands of the nodes.
    warnings : tuple of str
    """

    sent: tuple[str, ...]
    ticks: int
    late: int
    answers: dict[str, Signal]
    warnings: tuple[str, ...]

    def replayed(self, layout: LoopLayout) -> Replayed:
        """The answers in the form of a replay with a layout; commands on the ticks that have both of them."""
        nothing = np.empty(0, np.int64), np.empty((0, 2))
        stamp, estimate = self.answers.get(LOS_ESTIMATE.name, nothing)
        fsm = self.answers.get(FSM_COMMAND.name, nothing)
        pma = self.answers.get(PMA_COMMAND.name, (np.empty(0, np.int64), np.empty((0, 6))))
        both, i, j = np.intersect1d(fsm[0], pma[0], assume_unique=True, return_indices=True)
        return Replayed(stamp, estimate, both, np.hstack([fsm[1][i], pma[1][j]]), layout)


def play(run: Run, domain: int | None, timeout: float, progress: Callable[[int, int], None]) -> Played:
    """Drive the nodes of a domain with the sensors of a bag.

    Parameters
    ----------
    run : Run
        With the sensor topics; truth and images are sent too where the bag has them.
    domain : int, optional
        ROS domain; default: that of the environment.
    timeout : float
        Longest wait for subscribers [s].
    progress : callable
        Called with ticks done and all ticks.

    Raises
    ------
    ValueError
        No sensors in the bag, a plant on this domain, no node that subscribes.
    """
    missing = [topic.name for topic in SENSORS if topic.name not in run]
    if missing:
        raise BagError(
            f"{run.path}: to drive nodes the bag must hold {', '.join(missing)}, got {', '.join(run.topics)}"
        )
    if domain is not None:
        os.environ[DOMAIN_VARIABLE] = str(domain)
    os.environ.setdefault("ROS_LOG_DIR", "/tmp")
    with domain_lock(domain_of(os.environ), NAMESPACE):
        context = NodeContext("replay", [])
        try:
            others = OtherPlants(context)
            return _Player(context, run, others).play(timeout, progress)
        finally:
            context.close()


class _Player:
    """Publishers of the sensors, subscriptions of the answers."""

    def __init__(self, context: NodeContext, run: Run, others: OtherPlants) -> None:
        placed = [
            topic
            for topic in placed_topics({name: run[name].values.shape[1] for name in run.topics})
            if topic.publisher == "plant"
        ]
        topics = [topic for topic in (*placed, *SENSORS, TRUTH_LOS) if topic.name in run]
        self.context = context
        self._others = others
        self.sent = tuple(topic.name for topic in topics)
        self.stamps: NDArray[np.int64] = np.unique(np.concatenate([run[t.name].stamp for t in topics]))
        self._outputs = [self._output(topic, run) for topic in topics]
        node = context.node
        self._images = {stamp_of(data): data for data in run.messages(IMAGE_NAME)}
        self._image_output = RawPublisher(node, IMAGE_NAME, IMAGE) if self._images else None
        self._inputs = {t.name: RawSubscription(node, t.name, t.type_name, ANSWER_DEPTH) for t in ANSWERS}
        self._taken: dict[str, list[bytes]] = {topic.name: [] for topic in ANSWERS}

    def _output(self, topic: TopicDefinition, run: Run) -> tuple[RawPublisher, Codec, NDArray[np.int64], FloatArray]:
        """Publisher, codec, row of the topic on each tick (-1: nothing is due), values."""
        rows = np.full(len(self.stamps), -1)
        rows[np.searchsorted(self.stamps, run[topic.name].stamp)] = np.arange(len(run[topic.name]))
        values = np.ascontiguousarray(run[topic.name].values[:, : topic.size])
        return RawPublisher(self.context.node, topic.name, topic.type_name), codec_for(topic), rows, values

    def play(self, timeout: float, progress: Callable[[int, int], None]) -> Played:
        answered = self._handshake(timeout)
        self._others.close()  # its subscription is not one of a listening node
        warnings = () if answered else self._without_answer(timeout)
        late, total, first = 0, len(self.stamps), int(self.stamps[0])
        start_time = time.monotonic_ns() + 20_000_000
        done = 0
        for k, stamp in enumerate(self.stamps.tolist()):
            if self.context.stop:
                raise KeyboardInterrupt
            behind = wait_until(start_time + stamp - first)
            if behind >= TICK_NS:  # later ticks are not sent faster: the nodes would see another sampling rate
                start_time += behind
                late += 1
            for publisher, codec, rows, values in self._outputs:
                if rows[k] >= 0:
                    publisher.publish(codec.encode(stamp, values[rows[k]]))
            if self._image_output is not None and stamp in self._images:
                self._image_output.publish(self._images[stamp])
            self._drain()
            done += 1
            if k % 200 == 0:
                progress(k, total)
        end = time.monotonic() + LAST_ANSWERS_S
        while time.monotonic() < end:
            self._drain()
            time.sleep(0.01)
        progress(total, total)
        return Played(self.sent, done, late, self._answers(), warnings)

    def _handshake(self, timeout: float) -> bool:
        """Send hold ticks (stamp zero), which reset the nodes, until every responding node responds; whether all do."""
        node, start_time = self.context.node, time.monotonic()
        pending = {topic.name for topic in ANSWERS}
        while not self.context.stop:
            for publisher, codec, _, values in self._outputs:
                publisher.publish(codec.encode(HOLD_STAMP, np.zeros(values.shape[1])))
            if self._image_output is not None:
                first = next(iter(self._images.values()))
                self._image_output.publish(with_stamp(first, HOLD_STAMP))
            time.sleep(HOLD_PERIOD_S)
            self._others.refuse_running()
            for name, subscription in self._inputs.items():
                while (taken := subscription.take()) is not None:
                    if len(taken[0]) >= 12 and stamp_of(taken[0]) == HOLD_STAMP:
                        pending.discard(name)
            waited = time.monotonic() - start_time
            expected = {name for name in pending if node.count_publishers(node.resolve_topic_name(name))}
            if not pending or (waited > DISCOVERY_S and len(pending) < len(ANSWERS) and not expected):
                break
            if waited > timeout:
                return False
        time.sleep(HOLD_PERIOD_S)
        for subscription in self._inputs.values():
            while subscription.take() is not None:
                pass
        return True

    def _without_answer(self, timeout: float) -> tuple[str, ...]:
        """Continue without a response if a node subscribes to the sensors."""
        node = self.context.node
        if not any(node.count_subscribers(node.resolve_topic_name(topic.name)) for topic in SENSORS):
            raise BagError(f"a node must subscribe to {node.get_namespace()}/... within {timeout:g} s, got none")
        return (f"no response to the hold ticks within {timeout:g} s: the nodes may not start from zero state",)

    def _drain(self) -> None:
        for name, subscription in self._inputs.items():
            while (taken := subscription.take()) is not None:
                self._taken[name].append(bytes(taken[0]))

    def _answers(self) -> dict[str, Signal]:
        """Answers by topic, sorted by stamp; hold ticks and unreadable messages are excluded."""
        signals = {}
        for topic in ANSWERS:
            codec, out = codec_for(topic), np.zeros(topic.size)
            rows: dict[int, FloatArray] = {}
            for data in self._taken[topic.name]:
                try:
                    stamp = codec.decode(data, out)
                except CodecError:
                    continue
                if stamp != HOLD_STAMP:
                    rows[stamp] = out.copy()
            if rows:
                stamps = np.array(sorted(rows), np.int64)
                signals[topic.name] = stamps, np.array([rows[s] for s in stamps.tolist()])
        return signals
