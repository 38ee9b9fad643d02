"""A link that loses, repeats, delays and reorders messages, as a process between nodes of a run.

    python bad_link.py DOMAIN TOPIC ...      each TOPIC is taken from link/TOPIC, where its sender is remapped to

What happens to a message follows from its tick alone, so a test can count: of each hundred ticks one is lost, one is
sent twice, one comes after the next three, one comes after its successor. Ends on SIGTERM.
"""

from __future__ import annotations

import os
import signal
import sys

from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import TOPICS
from los_testbed.nodes.support.transport.middleware import choose_middleware
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, RawSubscription, Waiter
from los_testbed.run.loop.scheduling import become_real_time

from titop_plant.interface import TICK_NS

LOST, TWICE, DELAYED, SWAPPED = 10, 30, 50, 70
"""Ticks, modulo 100."""


def fate(stamp: int) -> int:
    """Number of the tick modulo 100."""
    return stamp // TICK_NS % 100


class Link:
    """One topic's way through the link."""

    def __init__(self, node, topic) -> None:
        self.source = RawSubscription(node, f"link/{topic.name}", topic.type_name, 200)
        self.target = RawPublisher(node, topic.name, topic.type_name, 1000)
        self.kept: list[list] = []  # [messages to wait for, data]

    def work(self) -> None:
        while (taken := self.source.take()) is not None:
            self.carry(taken[0])

    def carry(self, data: bytes) -> None:
        stamp = stamp_of(data)
        kind = fate(stamp) if stamp else -1
        if kind in (DELAYED, SWAPPED):
            self.kept.append([3 if kind == DELAYED else 1, data])
            return
        if kind != LOST:
            self.target.publish(data)
        if kind == TWICE:
            self.target.publish(data)
        for entry in self.kept:
            entry[0] -= 1
        for entry in [e for e in self.kept if e[0] <= 0]:
            self.target.publish(entry[1])
            self.kept.remove(entry)


def main() -> None:
    domain, *names = sys.argv[1:]
    choose_middleware(os.environ)
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    rclpy.init(domain_id=int(domain), signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("bad_link", namespace="/telescope")
    links = [Link(node, topic) for topic in TOPICS if topic.name in names]
    waiter = Waiter(node, [link.source for link in links])
    become_real_time(75)
    while not stopped:
        waiter.wait(50_000_000)
        for link in links:
            link.work()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
