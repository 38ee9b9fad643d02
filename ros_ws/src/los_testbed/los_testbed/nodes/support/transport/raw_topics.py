"""Publishers and subscriptions of serialised messages, and a wait on them, outside any executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import AccelStamped, Vector3Stamped
from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Header

from los_testbed.config.topics import DEPTH
from los_testbed.nodes.support.transport.serialized_reader import SerializedReader, Taken
from los_testbed.run.loop.members import members
from los_testbed.run.loop.source_guard import Endpoint, SourceGuard
from pointing_analysis.read.messages.message_types import ACCEL, HEADER, IMAGE, JOINT_STATE, VECTOR3

MESSAGES = {ACCEL: AccelStamped, VECTOR3: Vector3Stamped, JOINT_STATE: JointState, HEADER: Header, IMAGE: Image}
READER_DEPTH = 200
"""History depth of a subscription of the loop: a foreign publisher must not displace the others within a few ticks."""

LOCKSTEP_DEPTH = 5000
"""The same in lockstep: a displaced message would never be sent again."""

_UNKNOWN = "_NODE_NAME_UNKNOWN_"

SETTLE_S = 1.0
"""Longest wait for subscribers to receive a node's last messages [s]; with a dead subscriber all of it passes."""


class NoExecutorGroup(CallbackGroup):  # type: ignore[misc, unused-ignore]
    """Callback group of entities without executor: the loop takes their messages."""

    def can_execute(self, entity: Any) -> bool:
        """Nothing is executed."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Nothing is executed."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was executed."""
        return


def listed_publisher(node: Node, message: Any, name: str, quality: QoSProfile) -> Any:
    """A publisher of a node, whose topic is in the list of the run before it is there."""
    members().publishes(node.resolve_topic_name(name))
    return node.create_publisher(message, name, quality)


class RawPublisher:
    """Publisher of serialised messages on a topic relative to the node's namespace."""

    def __init__(self, node: Node, name: str, type_name: str, depth: int = DEPTH) -> None:
        self._publisher = listed_publisher(node, MESSAGES[type_name], name, QoSProfile(depth=depth))
        self._handle = self._publisher.handle
        self._handle.__enter__()  # keeps it alive; entered once instead of at every message
        self.publish = self._handle.publish_raw

    def settle(self, deadline: float) -> bool:
        """Wait until all subscribers have the messages, or until `deadline` (steady clock [s]); whether they do."""
        rest = max(0.0, deadline - time.monotonic())
        return bool(self._publisher.wait_for_all_acked(Duration(nanoseconds=int(rest * 1e9))))

    def close(self) -> None:
        """Release the handle."""
        self._handle.__exit__(None, None, None)


def settle(publishers: Sequence[RawPublisher]) -> bool:
    """Wait until the last messages of these have arrived, at most :data:`SETTLE_S`; whether all have.

    Readers drop the messages of a process that they have not yet taken in when they learn that it has left, and they
    learn that on another port.
    """
    deadline = time.monotonic() + SETTLE_S
    arrived = [publisher.settle(deadline) for publisher in publishers]
    return all(arrived)


class RawSubscription:
    """Subscription whose messages are taken as bytes.

    A reliable subscription delivers nothing until a lost message was retransmitted. That suits a recorder; a loop
    misses one sample rather than getting all following ones late, so it subscribes best effort (`reliable` False) to
    the same reliable publishers.

    Parameters
    ----------
    node : Node
        The node that subscribes.
    name : str
        Topic, relative to the node's namespace.
    message : str or type
        Message type, or its name.
    depth : int
        Messages kept.
    reliable : bool
        See above.
    publisher : str
        Name of the node that should send.
    """

    def __init__(
        self, node: Node, name: str, message: Any, depth: int = DEPTH, reliable: bool = True, publisher: str = ""
    ) -> None:
        self.name = node.resolve_topic_name(name)
        expected = f"{node.get_namespace().rstrip('/')}/{publisher}"
        self.guard = SourceGuard(expected, partial(members().standing, self.name, expected))
        self.message = MESSAGES[message] if isinstance(message, str) else message
        self._node = node
        self._node_names: dict[str, str] = {}
        how = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        quality = QoSProfile(depth=depth, reliability=how)
        self._subscription = node.create_subscription(
            self.message, name, _ignore, quality, callback_group=NoExecutorGroup(), raw=True
        )
        self.handle = self._subscription.handle
        self.handle.__enter__()
        self._reader = SerializedReader(self.handle)
        self.take: Callable[[], Taken | None] = self._reader.take
        """Oldest message with its times and its publisher, or None."""

    def sort(self, taken: Taken, now_ns: int) -> str:
        """Class of a message by :meth:`~los_testbed.run.loop.source_guard.SourceGuard.sort`.

        Parameters
        ----------
        taken : Taken
            What :attr:`take` returned.
        now_ns : int
            Steady clock [ns].
        """
        return self.guard.sort(taken.gid, now_ns, taken.data)

    def endpoints(self) -> list[Endpoint]:
        """Publishers of the topic that the graph knows; about 0.3 ms.

        The graph learns the node of a publisher after the publisher. One that was out of reach for longer than the
        lease and is found again is the same one, of the node that it was of.
        """
        publishers = []
        for info in self._node.get_publishers_info_by_topic(self.name):
            gid = bytes(info.endpoint_gid).hex()
            if info.node_name != _UNKNOWN:
                self._node_names[gid] = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            publishers.append(Endpoint(gid, self._node_names.get(gid, "")))
        return publishers

    def decide(self, now_ns: int) -> None:
        """Query the graph if there are messages of an undecided publisher."""
        if self.guard.undecided(now_ns):
            self.guard.decide(self.endpoints(), now_ns)

    def close(self) -> None:
        """Release the handle and leave the topic."""
        self._reader.close()
        self.handle.__exit__(None, None, None)
        self._node.destroy_subscription(self._subscription)


def is_raw(subscription: Any) -> bool:
    """Whether a subscription of rclpy is one of a :class:`RawSubscription`."""
    return isinstance(subscription.callback_group, NoExecutorGroup)


class Waiter:
    """Wait until one of some subscriptions has a message."""

    def __init__(self, node: Node, subscriptions: Sequence[RawSubscription]) -> None:
        self._handles = [subscription.handle for subscription in subscriptions]
        with node.context.handle:
            self._set = rclpy_implementation.WaitSet(len(self._handles), 0, 0, 0, 0, 0, node.context.handle)

    def wait(self, timeout_ns: int) -> None:
        """Return when there is a message or after `timeout_ns`."""
        waiting = self._set
        waiting.clear_entities()
        for handle in self._handles:
            waiting.add_subscription(handle)
        waiting.wait(timeout_ns)


def _ignore(message: bytes) -> None:
    """Callback that is never called."""
