"""Node that sent the request in progress: not available in rclpy's callbacks, but from service introspection.

For each request that it takes, a service with introspection publishes an event with the identifier of the client. The
node reads its own events; those of others with the same topic are left out by the identifier of their publisher.
"""

from __future__ import annotations

import struct
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState

from los_testbed.nodes.support.transport.raw_topics import RawSubscription
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.run.loop.members import PREFIX_BYTES

RECEIVED = 1
"""Type of the event of a received request (``service_msgs/msg/ServiceEventInfo``)."""

UNKNOWN = "an unknown node"
WAIT_S = 0.02
"""Longest wait for the event of a request [s]; it usually arrives after 0.1 ms."""

GRAPH = "/rosout", "/parameter_events"
"""Topics on which nearly every node has a publisher, from which its name follows."""

_EVENT = struct.Struct("<B3xiI16s")  # after the encapsulation header: kind, stamp, client
_HEADER = 4
_DEPTH = 100


class Requesters:
    """Clients of the services of a node.

    Parameters
    ----------
    node : Node
        The node.
    gid : bytes
        Identifier of one of its publishers.
    """

    def __init__(self, node: Node, gid: bytes) -> None:
        self._node = node
        self._own = gid[:PREFIX_BYTES]
        self._events: list[RawSubscription] = []
        self._names: dict[bytes, str] = {}
        self._count = -1
        self._since = 0

    def watch(self, service: Any) -> None:
        """Identify the clients of a service from now on."""
        quality = QoSProfile(depth=_DEPTH)
        service.configure_introspection(self._node.get_clock(), quality, ServiceIntrospectionState.METADATA)
        name = self._node.resolve_service_name(service.service_name)
        self._events.append(RawSubscription(self._node, f"{name}/_service_event", service.srv_type.Event, _DEPTH))

    def begin(self) -> None:
        """Before a request is taken: events until now are of others."""
        self._learn()
        self._since = time.time_ns()
        for events in self._events:
            while events.take() is not None:
                pass

    def end(self) -> None:
        """After the response to a request."""
        self._since = 0

    def who(self) -> str:
        """Full name of the node that sent the request under way; empty if there is none."""
        if not self._since:
            return ""
        deadline = time.monotonic() + WAIT_S
        while True:
            for events in self._events:
                while (taken := events.take()) is not None:
                    if client := self._client(taken):
                        return self._names.get(client, UNKNOWN)
            if time.monotonic() > deadline:
                return UNKNOWN

    def _client(self, taken: Taken) -> bytes:
        """Beginning of the client's identifier if this is the event of the request under way, else nothing."""
        data = taken.data
        if taken.gid[:PREFIX_BYTES] != self._own or taken.sent < self._since or len(data) < _HEADER + _EVENT.size:
            return b""
        kind, _, _, client = _EVENT.unpack_from(data, _HEADER)
        return bytes(client[:PREFIX_BYTES]) if kind == RECEIVED else b""

    def _learn(self) -> None:
        """Names of the nodes of each process; those that left are kept."""
        count = sum(self._node.count_publishers(topic) for topic in GRAPH)
        if count == self._count:
            return
        by_prefix: dict[bytes, set[str]] = {}
        for topic in GRAPH:
            for info in self._node.get_publishers_info_by_topic(topic):
                name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                by_prefix.setdefault(bytes(info.endpoint_gid)[:PREFIX_BYTES], set()).add(name)
        space = self._node.get_namespace()
        named = {
            prefix: min(names, key=lambda name: (not name.startswith(space), name))
            for prefix, names in by_prefix.items()
        }
        if not any("_NODE_NAME_UNKNOWN_" in name for name in named.values()):
            self._count = count
        self._names.update(named)
