"""Second publishers on the topics of a node: seen in the graph, or by their messages."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

from los_testbed.nodes.support.transport.raw_topics import RawSubscription
from los_testbed.run.loop.members import OPEN, OWN, PENDING

UNKNOWN_NODE, SAME_NAME = "unknown", "of the same name"
UNKNOWN_LOOKS = 50
"""Graph queries for a publisher without a node name (a program without ROS) before it is reported as such."""


class SourceWatch:
    """Monitors the publishers of some topics; about 50 us per topic without changes.

    Parameters
    ----------
    node : Node
        The node that looks.
    subscriptions : sequence of RawSubscription
        Its subscriptions.
    """

    def __init__(self, node: Node, subscriptions: Sequence[RawSubscription]) -> None:
        self._node = node
        self._subscriptions = subscriptions
        self._settled: dict[str, int] = {}
        self._looks: dict[str, int] = {}
        self._named: set[bytes] = set()
        self.found: dict[str, set[str]] = {}

    def look(self, now_ns: int) -> list[tuple[str, str]]:
        """Decide on new publishers; topic and node of each second publisher that was not reported before."""
        news = []
        for subscription in self._subscriptions:
            subscription.decide(now_ns)
            name, guard = subscription.name, subscription.guard
            count = self._node.count_publishers(name)
            if count != self._settled.get(name, 1):
                for node in self._second(subscription, count):
                    news += self._note(name, node)
            intruders = [gid for gid in guard.intruders() if gid not in self._named]
            for node in self._senders(subscription, intruders) if intruders else ():
                news += self._note(name, node)
        return news

    def _senders(self, subscription: RawSubscription, intruders: Sequence[bytes]) -> list[str]:
        """Nodes of publishers that have sent; those without a name are waited for."""
        nodes, labels = {e.gid: e.node for e in subscription.endpoints()}, []
        for gid in intruders:
            node, key = nodes.get(gid.hex(), ""), f"{subscription.name} {gid.hex()}"
            self._looks[key] = self._looks.get(key, 0) + 1
            if node or self._looks[key] > UNKNOWN_LOOKS:
                self._named.add(gid)
                del self._looks[key]
                labels.append(_label(subscription, node) if node else UNKNOWN_NODE)
        return labels

    def _second(self, subscription: RawSubscription, count: int) -> list[str]:
        """Nodes with a publisher beside the matched one; those without a name are waited for.

        A publisher in the run's list needs no name: the graph learns that of a restarted node late.
        """
        guard, name, endpoints = subscription.guard, subscription.name, subscription.endpoints()
        standing = [guard.standing(bytes.fromhex(endpoint.gid)) for endpoint in endpoints]
        if not guard.node and (OPEN in standing or PENDING in standing):
            return []
        nodes = [_label(subscription, endpoint.node) for endpoint in guard.foreign_publishers(endpoints)]
        if all(endpoint.node or kind == OWN for endpoint, kind in zip(endpoints, standing, strict=True)):
            self._settled[name] = count
            return nodes
        self._looks[name] = self._looks.get(name, 0) + 1
        if self._looks[name] > UNKNOWN_LOOKS:
            self._looks[name] = 0
            self._settled[name] = count
            nodes.append(UNKNOWN_NODE)
        return nodes

    def _note(self, name: str, node: str) -> list[tuple[str, str]]:
        known = self.found.setdefault(name, set())
        if node in known:
            return []
        known.add(node)
        return [(name, node)]

    def statistics(self) -> dict[str, str]:
        """Second publishers by topic, messages of others, and those of them that were used before that was known."""
        return {
            **{f"second_publishers_{name}": str(len(nodes)) for name, nodes in sorted(self.found.items())},
            **{f"foreign_{s.name}": str(s.guard.foreign) for s in self._subscriptions if s.guard.foreign},
            **{f"misused_{s.name}": str(s.guard.misused) for s in self._subscriptions if s.guard.misused},
        }


def _label(subscription: RawSubscription, node: str) -> str:
    """Name of a node in a report."""
    guard = subscription.guard
    return SAME_NAME if node == (guard.node or guard.expected) else node
