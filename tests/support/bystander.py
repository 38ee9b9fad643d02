"""A node beside a run, in the process of the test: it sends what it likes and sees what is sent."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from los_testbed.bags.cdr import stamp_of
from los_testbed.bags.diagnostics import read_diagnostics
from los_testbed.config.topics import FSM_COMMAND, TRUTH_LOS, TopicDefinition
from los_testbed.nodes.support.transport.middleware import (
    PROFILE_VARIABLES,
    TRANSPORT_VARIABLE,
    choose_middleware,
)
from los_testbed.nodes.support.transport.raw_topics import RawPublisher, RawSubscription
from los_testbed.run.processes.node_launch import RANGE_VARIABLE
from los_testbed.run.runner import Runner
from rclpy.context import Context
from rclpy.node import Node


@contextlib.contextmanager
def middleware(ours=True):
    """Inside, participants are made as the nodes of a run have them, or as a user on this machine has them."""
    before = dict(os.environ)
    for variable in (*PROFILE_VARIABLES, TRANSPORT_VARIABLE):
        os.environ.pop(variable, None)
    os.environ[RANGE_VARIABLE] = "LOCALHOST"
    if ours:
        choose_middleware(os.environ)
    try:
        yield
    finally:
        for variable in (*PROFILE_VARIABLES, TRANSPORT_VARIABLE, RANGE_VARIABLE):
            os.environ.pop(variable, None)
            if variable in before:
                os.environ[variable] = before[variable]


def kill_a_node(runner: Runner, name: str) -> tuple[int, int]:
    """Kill a node of a run; stamps from before and from after that, when commands have come again."""
    seen = Bystander(runner.domain, hears=[TRUTH_LOS, FSM_COMMAND])
    try:
        before = seen.next(TRUTH_LOS)
        os.kill(runner.processes[name], signal.SIGKILL)
        time.sleep(0.5)  # what the bystander has still to read is from before
        after = seen.next(TRUTH_LOS)
        seen.next(FSM_COMMAND, after)
    finally:
        seen.close()
    return before, after


class Bystander:
    """Node with publishers on `sends` and subscriptions on `hears`; with `wait`, matched with the run's nodes."""

    def __init__(
        self,
        domain: int,
        sends: Sequence[TopicDefinition] = (),
        hears: Sequence[TopicDefinition] = (),
        wait: bool = True,
        pause: float = 0.3,
        name: str = "bystander",
        namespace: str = "/",
    ) -> None:
        with middleware():
            self.context = Context()
            self.context.init(domain_id=domain)
            self.node = Node(name, namespace=namespace, context=self.context)
        # deep enough that nothing is pushed out before its reader has it
        self._outputs = {t.name: RawPublisher(self.node, t.path, t.type_name, 1000) for t in sends}
        self._inputs = {t.name: RawSubscription(self.node, t.path, t.type_name) for t in hears}
        end = time.monotonic() + (60.0 if wait else 0.0)
        while True:
            matched = self._matched()
            time.sleep(pause)  # the other side, or one more node, may see the match a little later
            if (matched and self._matched()) or time.monotonic() > end:
                break

    def _matched(self) -> bool:
        """Whether each topic has a reader of the run, and every reader that the graph knows gets what is sent."""
        node = self.node
        count = {n: node.count_subscribers(f"/telescope/{n}") for n in (*self._outputs, *self._inputs)}
        heard = all(count[n] > (n in self._inputs) for n in count)
        known = {n: output._publisher.get_subscription_count() for n, output in self._outputs.items()}
        return heard and all(known[n] >= count[n] for n in known)

    def next(self, topic: TopicDefinition, newer_than: int = 0, timeout: float = 30.0) -> int:
        """Stamp of a message on `topic` that comes after this call and is newer than a stamp."""
        source = self._inputs[topic.name]
        while source.take() is not None:
            pass
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            while (taken := source.take()) is not None:
                if (stamp := stamp_of(taken[0])) > newer_than:
                    return stamp
            time.sleep(1e-3)
        raise TimeoutError(f"nothing newer than {newer_than} on {topic.path} within {timeout:g} s")

    def send(self, topic: TopicDefinition, data: bytes | bytearray) -> None:
        self._outputs[topic.name].publish(data)

    def send_until_counted(self, topic: TopicDefinition, data: bytes | bytearray, node: str, count: str) -> int:
        """Send a message again and again until the reports of a node of the run have this count; how often it was sent.

        Readers of the loop are best effort: one that has not yet found this publisher gets nothing, and neither the
        graph nor the publisher's own matches tell whether it has.
        """
        name = f"/telescope/{node}/diagnostics"
        reports = RawSubscription(self.node, name, DiagnosticArray)
        end, sent = time.monotonic() + 60.0, 0
        try:
            while time.monotonic() < end:
                self.send(topic, data)
                sent += 1
                time.sleep(0.02)
                while (taken := reports.take()) is not None:
                    if any(int(status.values.get(count, 0)) for status in read_diagnostics(taken[0])[1]):
                        return sent
        finally:
            reports.close()
        raise TimeoutError(f"{node} reports no {count} within 60 s")

    def settle(self) -> None:
        """Wait until every reader has what was sent."""
        deadline = time.monotonic() + 60.0
        assert all(publisher.settle(deadline) for publisher in self._outputs.values())

    def close(self) -> None:
        for end in (*self._outputs.values(), *self._inputs.values()):
            end.close()
        self.node.destroy_node()
        self.context.shutdown()
