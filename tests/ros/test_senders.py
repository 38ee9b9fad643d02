"""Requests and messages as the middleware tells them: whether one waits, who sent it, and forged events."""

from __future__ import annotations

import time

import pytest
from bystander import middleware
from geometry_msgs.msg import Vector3Stamped
from los_testbed.nodes.support.requesters import UNKNOWN, WAIT_S, Requesters
from los_testbed.nodes.support.requests import Requests
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, RawSubscription
from los_testbed.nodes.support.transport.serialized_reader import publisher_gid
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_runs import private_domain, until
from std_srvs.srv import Trigger

from pointing_analysis.read.messages.message_types import VECTOR3


@pytest.fixture
def nodes():
    """Two nodes as in two processes: each has a participant of its own."""
    made = []
    with middleware():
        for name in ("server", "user"):
            context = Context()
            context.init(domain_id=private_domain())
            made.append(Node(name, namespace="/telescope", context=context))
    yield made
    for node in made:
        node.destroy_node()
        node.context.shutdown()


def test_each_message_comes_with_the_identifier_of_its_publisher(nodes):
    reader = RawSubscription(nodes[0], "t", Vector3Stamped)
    senders = [RawPublisher(node, "t", VECTOR3) for node in nodes]
    until(lambda: all(sender._publisher.get_subscription_count() for sender in senders))
    until(lambda: len(reader.endpoints()) == 2 and all(e.node for e in reader.endpoints()))
    nodes_by_gid = {endpoint.gid: endpoint.node for endpoint in reader.endpoints()}
    for sender, size, name in zip(senders, (8, 100_000), ("server", "user"), strict=True):
        data = bytes([0, 1, 0, 0]) + bytes(range(200)) * (size // 200)
        sender.publish(data)
        taken = until(reader.take)
        assert taken.data == data
        assert nodes_by_gid[taken.gid.hex()] == f"/telescope/{name}"
        assert taken.gid == publisher_gid(sender._handle)
        assert abs(taken.received - time.time_ns()) < 60e9 and abs(taken.sent - time.time_ns()) < 60e9
    assert reader.take() is None
    for sender in senders:
        sender.close()
    reader.close()


@pytest.fixture
def served(nodes):
    """A service that notes who asked, and a function that asks as the user."""
    server, user = nodes
    publisher = server.create_publisher(Vector3Stamped, "own", 1)
    with publisher.handle:
        requesters = Requesters(server, publisher_gid(publisher.handle))
    told = []

    def answer(request, response):
        told.append(requesters.who())
        return response

    service = server.create_service(Trigger, "~/stop", answer)
    requesters.watch(service)
    executors = [SingleThreadedExecutor(context=node.context) for node in nodes]
    for executor, node in zip(executors, nodes, strict=True):
        executor.add_node(node)
    client = user.create_client(Trigger, "/telescope/server/stop")
    assert client.wait_for_service(30.0)

    def ask():
        count, future = len(told), client.call_async(Trigger.Request())
        time.sleep(0.3)
        requesters.begin()
        end = time.monotonic() + 30.0
        while len(told) == count and time.monotonic() < end:
            executors[0].spin_once(timeout_sec=0.1)
        requesters.end()
        executors[1].spin_until_future_complete(future, 10.0)
        return told[-1]

    return requesters, ask


def test_a_request_is_of_the_node_that_sent_it(served, monkeypatch):
    requesters, ask = served
    monkeypatch.setattr("los_testbed.nodes.support.requesters.WAIT_S", 20.0)  # a busy machine
    assert requesters.who() == ""
    assert [ask(), ask()] == ["/telescope/user"] * 2
    assert requesters.who() == "", "nobody asks any more"


def test_events_that_others_publish_name_nobody(served, nodes):
    """An event of the user's own with the service's topic: the request is not the user's to tell."""
    requesters, _ = served
    forged = nodes[1].create_publisher(Trigger.Event, "/telescope/server/stop/_service_event", 10)
    until(lambda: forged.get_subscription_count() > 0)
    event = Trigger.Event()
    event.info.event_type = 1
    requesters.begin()
    for _ in range(5):
        forged.publish(event)
    time.sleep(max(0.3, WAIT_S))
    assert requesters.who() == UNKNOWN
    requesters.end()


def test_a_request_waits_until_the_executor_has_answered_it(nodes):
    server, user = nodes
    requests, executor = Requests(server), SingleThreadedExecutor(context=server.context)
    executor.add_node(server)
    assert not requests.waiting()

    def answer(request, response):
        response.success = True
        return response

    server.create_service(Trigger, "~/go", answer)  # seen although it was made after the first question
    assert not requests.waiting()
    client = user.create_client(Trigger, "/telescope/server/go")
    assert client.wait_for_service(60.0)
    future = client.call_async(Trigger.Request())
    until(requests.waiting)
    assert requests.waiting(), "asking does not take it"
    executor.spin_once(timeout_sec=0.0)
    assert not requests.waiting()
    other = SingleThreadedExecutor(context=user.context)
    other.add_node(user)
    other.spin_until_future_complete(future, 60.0)
    assert future.result().success
