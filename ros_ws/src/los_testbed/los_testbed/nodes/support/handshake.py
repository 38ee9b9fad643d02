"""Start of a run: one plant per domain, and no tick before all nodes receive.

Discovery is not symmetric: a subscription may be matched on one side and not yet on the other. So the plant sends hold
ticks (stamp zero: no time has passed) until it receives the commands for them and, with a recorder, until that has
matched every topic.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from lftkit.errors import InputError
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import ISOLATOR_ACCEL, SENSORS
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_io import PlantIo
from los_testbed.nodes.support.requesters import UNKNOWN
from los_testbed.nodes.support.transport.raw_topics import RawSubscription
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.nodes.support.unread_topics import bypassed_in_words, unread_in_words
from los_testbed.run.loop.source_guard import Endpoint, SourceGuard
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP
from titop_plant.interface import TRUTH

LISTEN_S = 1.0
"""A plant on the same domain is discovered within 0.4 s with the discovery profile of this package."""

NAME_S = 3.0
"""Longest wait for the name of a node whose message was received."""

HOLD_PERIOD_S = 0.02

BUNDLE_LOOKS = 5
"""Hold ticks after the first response on the last command topic by which the graph knows whether the message of all
commands has a publisher."""

LEASE_S = 11.0
"""A node that was killed has left the graph within this time."""


class OtherPlants:
    """Rejects a second plant on a domain: before anything is sent, and until the run begins.

    On a busy machine discovery takes longer than :data:`LISTEN_S`: another plant is then detected while this one waits
    for its followers, which the other's run occupies.

    Parameters
    ----------
    context : NodeContext
        The node.

    Raises
    ------
    ValueError
        Another plant sends on this domain.
    """

    def __init__(self, context: NodeContext) -> None:
        topic = ISOLATOR_ACCEL
        self._listener = RawSubscription(context.node, topic.name, topic.type_name)
        try:
            self._listen(context)
        except ValueError:
            self.close()
            raise

    def _listen(self, context: NodeContext) -> None:
        """Wait for discovery; any sample, also a hold tick, is another plant's."""
        start_time, name = time.monotonic(), self._listener.name
        while not context.stop:
            if (taken := self._listener.take()) is not None:
                raise self._error(taken)
            # a killed plant stays in the graph until its lease ends: only messages count
            patience = 2 * LISTEN_S if context.node.count_publishers(name) else LISTEN_S
            if time.monotonic() - start_time > patience:
                return
            time.sleep(0.01)

    def refuse_running(self) -> None:
        """Check new messages while this node sends hold ticks only: another stamp is of a running plant."""
        while (taken := self._listener.take()) is not None:
            if len(taken[0]) >= 12 and stamp_of(taken[0]) != HOLD_STAMP:
                raise self._error(taken)

    def _error(self, taken: Taken) -> InputError:
        return InputError(
            f"ROS_DOMAIN_ID must be a domain without a plant, got one where {self._listener.name} is sent "
            f"(node {self._sender(taken)})"
        )

    def _sender(self, taken: Taken) -> str:
        """Name of the node; discovery may report it later than its first sample."""
        end = time.monotonic() + NAME_S
        while True:
            nodes = {endpoint.gid: endpoint.node for endpoint in self._listener.endpoints()}
            if name := nodes.get(taken.gid.hex()):
                return name
            if time.monotonic() > end:
                return "unknown"
            time.sleep(0.05)

    def close(self) -> None:
        """Stop listening: from now on the samples are this node's own."""
        self._listener.close()


def wait_for_followers(
    context: NodeContext,
    io: PlantIo,
    may_begin: Callable[[], bool] = lambda: True,
    refuse_others: Callable[[], None] = lambda: None,
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Send hold ticks until estimator, controller and, if configured, recorder respond and the run `may_begin`.

    Every 20 ms `meanwhile` is called, by which a rig that is open is read.

    Raises
    ------
    ValueError
        One of them did not answer in time, or `refuse_others` raised it.
    """
    answers = Answers(context, io)
    start_time = time.monotonic()
    while not context.stop:
        hold(io)
        time.sleep(HOLD_PERIOD_S)
        meanwhile()
        refuse_others()
        answers.take()
        context.service()
        if answers.complete and not may_begin():
            start_time = time.monotonic()
        elif answers.complete:
            time.sleep(HOLD_PERIOD_S)  # the last echoes arrive
            _refuse_second_commander(context, io, meanwhile)
            io.choose_readers(answers.bundled)
            topics = (*SENSORS, *(one.topic for one in io.commands)) if answers.bundled else ()
            if text := bypassed_in_words(context.node, topics, io.bundle_reader.source.name):
                context.event("warning", message=text)
                context.warn_alone([text])
            return
        elif time.monotonic() - start_time > context.config.start_timeout:
            _refuse_second_commander(context, io, meanwhile)
            missing = ", ".join(subscription.name + _strangers_on(subscription) for subscription in answers.missing)
            raise InputError(
                f"all nodes must answer within {context.config.start_timeout:g} s, got no message on {missing}"
                f"{unread_in_words(context.node)}"
            )


def hold(io: PlantIo) -> None:
    """Send a hold tick."""
    none = np.zeros(io.ports.measurements)
    io.pack(HOLD_STAMP, none)
    io.publish(HOLD_STAMP, none, np.zeros(TRUTH))


class Answers:
    """Responses to the hold ticks: the message with all commands, or each command topic, and the recorder.

    Parameters
    ----------
    context : NodeContext
    io : PlantIo
    """

    def __init__(self, context: NodeContext, io: PlantIo) -> None:
        self._node = context.node
        self._bundle = io.bundle_reader.source
        self._topics = [reader.source for reader in io.topic_readers if reader in io.readers]
        self._recorder = [io.progress_input] if context.config.wait_for_recorder else []
        self._answered: set[str] = set()
        self._looks = 0

    @property
    def bundled(self) -> bool:
        """Whether the message with all commands has come."""
        return self._bundle.name in self._answered

    @property
    def missing(self) -> list[RawSubscription]:
        """Subscriptions without an answer."""
        commands = [] if self.bundled else self._topics or [self._bundle]
        return [one for one in (*commands, *self._recorder) if one.name not in self._answered]

    @property
    def complete(self) -> bool:
        """Whether all have answered; a node that also sends the message of all commands is waited for a while."""
        if self.missing:
            return False
        self._looks += not self.bundled
        return self.bundled or (self._looks > BUNDLE_LOOKS and not self._node.count_publishers(self._bundle.name))

    def take(self) -> None:
        """Take what has come."""
        for subscription in (self._bundle, *self._topics, *self._recorder):
            while (taken := subscription.take()) is not None:
                ours = not subscription.sort(taken, time.monotonic_ns())
                if ours and len(taken[0]) >= 12 and stamp_of(taken[0]) == HOLD_STAMP:
                    self._answered.add(subscription.name)
            subscription.decide(time.monotonic_ns())


def _strangers_on(subscription: RawSubscription) -> str:
    """Other publishers of a topic, in brackets; empty if there are none."""
    guard = subscription.guard
    nodes = sorted({_called(endpoint, guard) for endpoint in guard.foreign_publishers(subscription.endpoints())})
    return f" (other publishers: {', '.join(nodes)})" if nodes else ""


def _called(endpoint: Endpoint, guard: SourceGuard) -> str:
    """Displayed name of a foreign node."""
    same = endpoint.node == (guard.node or guard.expected)
    return f"another node named {endpoint.node}" if same else endpoint.node or UNKNOWN


def _refuse_second_commander(context: NodeContext, io: PlantIo, meanwhile: Callable[[], None]) -> None:
    """Reject foreign publishers of commands when a run begins.

    Raises
    ------
    ValueError
        Another node has a publisher on a command topic.
    """
    end = time.monotonic() + LEASE_S
    for subscription in (reader.source for reader in (io.bundle_reader, *io.topic_readers)):
        while True:
            foreign = subscription.guard.foreign_publishers(subscription.endpoints())
            if not foreign or context.stop:
                break
            if time.monotonic() > end:
                others = ", ".join(sorted({_called(endpoint, subscription.guard) for endpoint in foreign}))
                raise InputError(f"{subscription.name} must have one publisher, got also one of {others}")
            time.sleep(HOLD_PERIOD_S)
            meanwhile()
