"""Deadline and liveliness of the nodes' reports, counted by the middleware for a subscriber.

A node reports once a second from its loop, so a loop that hangs sends none: unlike the liveliness that the middleware
renews by a thread of its own. On the topics of the loop, a thousand times a second, a deadline would cost too much.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy

from los_testbed.config.topics import LATE_REPORTS, LIVELINESS_LOST, OWN_DIAGNOSTICS, REPORT_DEADLINE_S
from los_testbed.nodes.support.transport.raw_topics import NoExecutorGroup

_EVENTS = rclpy_implementation.rcl_subscription_event_type_t
_DEADLINE = _EVENTS.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED
_LIVELINESS = _EVENTS.RCL_SUBSCRIPTION_LIVELINESS_CHANGED


def report_quality(depth: int, seconds: float = REPORT_DEADLINE_S) -> QoSProfile:
    """Quality of service of a report: deadline and liveliness lease of this time."""
    limit = Duration(nanoseconds=round(seconds * 1e9))
    return QoSProfile(
        depth=depth,
        deadline=limit,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=limit,
    )


class ReportWatch:
    """Subscriptions with deadline and liveliness; the reports themselves are read elsewhere.

    A publisher that offers neither, possibly a program that replaces a node, is not matched and not watched.

    Parameters
    ----------
    node : Node
        Who watches.
    names : iterable of str
        Nodes of the run.
    seconds : float
        Longest time between two reports [s].
    """

    def __init__(self, node: Node, names: Iterable[str], seconds: float = REPORT_DEADLINE_S) -> None:
        quality = report_quality(1, seconds)
        quality.reliability = ReliabilityPolicy.BEST_EFFORT  # no node that ends waits for this reader
        self._counts: Counter[str] = Counter()
        self._events: list[tuple[str, Any, Any]] = []
        for name in names:
            subscription = node.create_subscription(
                DiagnosticArray,
                f"{name}/{OWN_DIAGNOSTICS}",
                lambda _: None,
                quality,
                callback_group=NoExecutorGroup(),
                raw=True,
            )
            with subscription.handle:
                events = [rclpy_implementation.EventHandle(subscription.handle, k) for k in (_DEADLINE, _LIVELINESS)]
            self._events.append((name, *events))

    def look(self) -> None:
        """Count the events since the last call."""
        for name, deadline, liveliness in self._events:
            self._counts[f"{LATE_REPORTS}{name}"] += max(deadline.take_event().total_count_change, 0)
            self._counts[f"{LIVELINESS_LOST}{name}"] += max(liveliness.take_event().not_alive_count_change, 0)

    def statistics(self) -> dict[str, str]:
        """Counts that are not zero."""
        return {name: str(count) for name, count in self._counts.items() if count}
