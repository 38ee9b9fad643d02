"""What the nodes of a run send and hear is what their permissions for DDS security say, no less."""

import contextlib
import os
import time
from fnmatch import fnmatchcase
from typing import Any

import pytest

pytest.importorskip("foxglove")
import rclpy
from bystander import middleware
from los_testbed.config.topics import NODES
from los_testbed.nodes.remote_control import remote_control
from los_testbed.run.processes.enclaves import heard_by, sent_by
from los_testbed.run.processes.viewers import Live
from los_testbed.run.runner import Runner
from rclpy.context import Context
from rclpy.node import Node
from ros_runs import PLANT, config_for

SPACE = "/telescope"
SECONDS = 20.0


def names_in_the_middleware(graph, node, space):
    """What a node sends and hears."""
    topics = {
        "sent": graph.get_publisher_names_and_types_by_node(node, space),
        "heard": graph.get_subscriber_names_and_types_by_node(node, space),
    }
    found = {way: {f"rt{name}" for name, _ in listed} for way, listed in topics.items()}
    for name, _ in graph.get_service_names_and_types_by_node(node, space):
        found["heard"].add(f"rq{name}Request")
        found["sent"].add(f"rr{name}Reply")
    for name, _ in graph.get_client_names_and_types_by_node(node, space):
        found["sent"].add(f"rq{name}Request")
        found["heard"].add(f"rr{name}Reply")
    return found


def enclave_of(node):
    return "live" if node.startswith("live_control") else "control" if node.startswith("control_") else node


@contextlib.contextmanager
def environment_kept():
    """What a remote control sets for its process is undone."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def look(domain):
    """Names of all nodes of the run, and of ``los-testbed control``."""
    with middleware():
        context = Context()
        context.init(domain_id=domain)
    node = Node("looking", context=context, start_parameter_services=False, enable_rosout=False)
    found, end = {}, time.monotonic() + SECONDS
    try:
        with environment_kept(), remote_control(domain, SPACE, 20.0):
            while time.monotonic() < end:
                listed = [each for each in node.get_node_names_and_namespaces() if each[0] != "looking"]
                found = {each: names_in_the_middleware(node, *each) for each in listed}
                if len(found) >= 7 and all(ways["sent"] and ways["heard"] for ways in found.values()):
                    break
                time.sleep(0.1)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    return found


def test_permissions_cover_every_name_of_a_run(tmp_path):
    found: dict[Any, Any] = {}
    config = config_for(tmp_path, duration=60.0)

    def progress(ticks):
        if not found:
            found.update(look(config.domain))
            raise KeyboardInterrupt

    Runner(config, progress, {"plant": PLANT}, live=Live(port=0)).run()
    assert {enclave_of(name) for name, _ in found} == {*NODES, "live", "control"}
    missing = {
        (node, way, name)
        for (node, _), ways in found.items()
        for way, may in (("sent", sent_by), ("heard", heard_by))
        for name in ways[way]
        if not any(fnmatchcase(name, expression) for expression in may(enclave_of(node), SPACE))
    }
    assert not missing
    assert "rt/telescope/fsm/command" in found["controller", SPACE]["sent"]
    assert "rt/telescope/fsm/command" in found["plant", SPACE]["heard"]
