"""Which publishers of the graph are reported as second ones."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
from los_testbed.nodes.support.source_watch import UNKNOWN_LOOKS, UNKNOWN_NODE, SourceWatch
from los_testbed.run.loop.members import OPEN, OTHER, OWN
from los_testbed.run.loop.source_guard import Endpoint, SourceGuard

TOPIC, NODE = "/telescope/fsm/command", "/telescope/controller"


def watch_of(endpoints, standing):
    """A watch of one topic whose publishers are these."""
    guard = SourceGuard(NODE, lambda gid: standing[gid.hex()], node=NODE)
    subscription: Any = SimpleNamespace(
        name=TOPIC, guard=guard, endpoints=lambda: endpoints, decide=lambda now_ns: guard.decide(endpoints, now_ns)
    )
    node: Any = SimpleNamespace(count_publishers=lambda name: len(endpoints))
    return SourceWatch(node, [subscription])


def reported(watch, looks=2 * UNKNOWN_LOOKS):
    return [news for k in range(looks) for news in watch.look(k * 20_000_000)]


def test_a_node_that_was_started_again_is_not_a_second_publisher_while_the_graph_has_no_name_of_it():
    """The publisher of the ended one is there for as long as its lease."""
    endpoints = [Endpoint("01", NODE), Endpoint("02", "")]
    assert reported(watch_of(endpoints, {"01": OWN, "02": OWN})) == []


@pytest.mark.parametrize("kind", [OTHER, OPEN])
def test_a_publisher_without_a_name_that_is_not_of_the_run_is_reported_once(kind):
    endpoints = [Endpoint("01", NODE), Endpoint("02", "")]
    assert reported(watch_of(endpoints, {"01": OWN, "02": kind})) == [(TOPIC, UNKNOWN_NODE)]


def test_a_stranger_beside_a_new_node_of_the_run_is_reported_by_its_name():
    endpoints = [Endpoint("01", NODE), Endpoint("02", ""), Endpoint("03", "/stranger")]
    assert reported(watch_of(endpoints, {"01": OWN, "02": OWN, "03": OTHER})) == [(TOPIC, "/stranger")]
