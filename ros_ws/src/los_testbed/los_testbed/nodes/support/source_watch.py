"""Second publishers on the topics of a node: seen in the graph, or by the numbers of their messages."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

from los_testbed.nodes.support.raw_topics import RawSubscription

UNKNOWN_LOOKS = 50
"""Looks at a publisher without a node name (a program without ROS) until it is reported as such."""


class SourceWatch:
    """Looks at the publishers of some topics; about 50 us a topic while nothing changes.

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
            if guard.doubled and not self.found.get(name):
                news += self._note(name, "of the same name")
        return news

    def _second(self, subscription: RawSubscription, count: int) -> list[str]:
        """Nodes with a publisher beside the matched one; those without a name are waited for."""
        if not subscription.guard.node:
            return []
        name, endpoints = subscription.name, subscription.endpoints()
        nodes = [endpoint.node for endpoint in subscription.guard.strangers(endpoints)]
        if all(endpoint.node for endpoint in endpoints):
            self._settled[name] = count
            return nodes
        self._looks[name] = self._looks.get(name, 0) + 1
        if self._looks[name] > UNKNOWN_LOOKS:
            self._looks[name] = 0
            self._settled[name] = count
            nodes.append("unknown")
        return nodes

    def _note(self, name: str, node: str) -> list[tuple[str, str]]:
        known = self.found.setdefault(name, set())
        if node in known:
            return []
        known.add(node)
        return [(name, node)]

    def statistics(self) -> dict[str, str]:
        """Second publishers by topic, and the messages that were not of the matched one."""
        return {
            **{f"second_publishers_{name}": str(len(nodes)) for name, nodes in sorted(self.found.items())},
            **{f"foreign_{s.name}": str(s.guard.foreign) for s in self._subscriptions if s.guard.foreign},
        }
