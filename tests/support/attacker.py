"""A stranger on the domain of a run, as a process of its own: it floods a topic or calls a service of the run.

    python attacker.py DOMAIN CASE        CASE as JSON, see :class:`Case`

Or it is a reader that asks for lost messages and takes none. It writes a line when it listens and, where it
is early, one when it begins to send; it ends on SIGTERM.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from typing import IO

import numpy as np

STAMPS = ("future", "past", "hold", "off_grid", "next", "repeated", "ahead")
"""Stamps relative to those of the run: 1000 s ahead, 1000 s back, zero, between two ticks, of the next tick, equal, a
few ticks ahead."""

CLOCK = "/clock"
SILENT = "silent reader"
"""In place of a topic: a reliable reader of all topics of the loop that takes nothing, not even from its sockets."""

TRANSITIONS = {"unknown": 250, "activate": 3, "deactivate": 4, "cleanup": 2, "shutdown": 7}
PARAMETERS = {
    "refused": {"fault": ['{"name": "camera_dropout", "value": "no"}', '{"name": "active", "value": false}', "{"]},
    "read_only": {"seed": [99], "duration": [1e5], "namespace": ["/stranger"], "use_sim_time": [False]},
    "noise": {"noise": [False]},
    "disturbance": {"disturbance": [False]},
    "camera": {"camera_dropout": [0.9]},
    "stop": {"fault": ['{"name": "stop", "value": true}']},
    "stop_later": {"fault": ['{"name": "stop", "value": true, "at": 0.5}']},
    "stage": {"loop": ["isolator"]},
    "authority": {"fsm_authority": [1e-6]},
}
"""Values of parameters that a request sets, by the name of the request."""

REQUESTS = {
    "plant/stop": ("",),
    "plant/start": ("",),
    "plant/reset": ("",),
    "plant/set_parameters": ("refused", "read_only", "noise", "disturbance", "camera", "stop", "stop_later"),
    "plant/set_parameters_atomically": ("refused", "read_only", "noise", "stop"),
    "controller/set_parameters": ("refused", "read_only", "stage", "authority"),
    "controller/set_parameters_atomically": ("refused", "stage"),
    "estimator/set_parameters": ("refused", "read_only"),
    "recorder/set_parameters": ("refused", "read_only"),
    "controller/change_state": tuple(TRANSITIONS),
    "estimator/change_state": tuple(TRANSITIONS),
}
SERVICES = tuple(REQUESTS)
EARLY = -1
"""Value of `begin` for a stranger that is there before the nodes of the run."""


@dataclass(frozen=True)
class Case:
    """What a stranger does.

    Attributes
    ----------
    topic : name of a topic of the loop, or of ``recorder/progress``, a diagnostics topic or CLOCK; or of a service; or
        SILENT
    name, namespace : of its node
    stamps : one of STAMPS
    rate : messages a second
    size : bytes added to each message (or cut from it, if negative)
    begin : tick of the run at which it begins to send; EARLY: before
    seconds : how long it sends
    request : what it asks of a service, one of REQUESTS
    """

    topic: str = "truth/los"
    name: str = "stranger"
    namespace: str = "/"
    stamps: str = "future"
    rate: float = 2000.0
    size: int = 0
    begin: int = 200
    seconds: float = 3.0
    request: str = ""

    @property
    def node(self) -> str:
        """Full name of its node."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def path(self) -> str:
        """Full name of its topic or service."""
        return self.topic if self.topic.startswith("/") else f"/telescope/{self.topic}"


class Attacker:
    """The process of a case."""

    def __init__(self, domain: int, case: Case) -> None:
        command = [sys.executable, __file__, str(domain), json.dumps(asdict(case))]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ
        )
        begins = b"begins" if case.begin == EARLY else b"listens"  # a run may be over before a process has started
        while (line := self._output.readline().strip()) != begins:
            assert line, f"it has ended: {self._errors.read().decode()}"

    @property
    def _output(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout

    @property
    def _errors(self) -> IO[bytes]:
        assert self.process.stderr is not None
        return self.process.stderr

    def close(self) -> str:
        """End it; what it said since."""
        self.process.send_signal(signal.SIGCONT)
        self.process.send_signal(signal.SIGTERM)
        end = time.monotonic() + 20.0
        while self.process.poll() is None:
            time.sleep(0.01)
            if time.monotonic() > end:
                self.process.kill()
        with self._output as output, self._errors:
            return output.read().decode()


def _stamp(kind: str, newest: int, count: int, start: int) -> int:
    from titop_plant.interface import TICK_NS

    return {
        "future": newest + 1000 * 10**9 + count * TICK_NS,
        "past": max(TICK_NS, newest - 1000 * 10**9 + count * TICK_NS),
        "hold": 0,
        "off_grid": newest + 123_457,
        "next": newest + TICK_NS,
        "repeated": newest or start,
        "ahead": newest + 3 * TICK_NS,
    }[kind]


def main() -> None:
    """Perform the case of the command line."""
    attack(int(sys.argv[1]), Case(**json.loads(sys.argv[2])))


def attack(domain: int, case: Case) -> None:
    """Perform a case."""
    from los_testbed.bags.cdr import stamp_of
    from los_testbed.config.topics import TRUTH_LOS
    from los_testbed.nodes.support.transport.middleware import choose_middleware
    from los_testbed.nodes.support.transport.raw_topics import RawSubscription

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    choose_middleware(os.environ)
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(case.name, namespace=case.namespace)
    heard = RawSubscription(node, f"/telescope/{TRUTH_LOS.name}", TRUTH_LOS.type_name, 1)
    sys.stdout.write("listens\n")
    sys.stdout.flush()
    newest, count_heard, start = 0, 0, time.time_ns() // 1_000_000 * 1_000_000

    def listen() -> None:
        nonlocal newest, first, count_heard
        while (taken := heard.take()) is not None:
            count_heard += 1
            stamp = stamp_of(taken[0]) if len(taken[0]) >= 12 else 0
            if 0 < stamp < newest + 10**9 or not newest:
                newest, first = max(newest, stamp), first or stamp

    first = 0
    call = _caller(node, case) if case.topic in SERVICES else None  # its service is found before it is used
    while not ended and case.begin != EARLY and not (first and newest >= first + case.begin * 1_000_000):
        listen()
        time.sleep(0.002)
    act = call or (_silent_reader(node, lambda: count_heard) if case.topic == SILENT else _sender(node, case))
    if case.begin == EARLY:
        sys.stdout.write("begins\n")
        sys.stdout.flush()
    start_time, count = time.monotonic(), 0
    while not ended and time.monotonic() < start_time + case.seconds:
        listen()
        act(_stamp(case.stamps, newest or start, count, start))
        count += 1
        rest = start_time + count / case.rate - time.monotonic()
        if rest > 0:
            time.sleep(min(rest, 0.1))
    sys.stdout.write(f"sent {count}, heard {count_heard}\n")
    sys.stdout.flush()
    while not ended:
        time.sleep(0.05)
    node.destroy_node()
    rclpy.try_shutdown()


def _messages(name):
    """Type of a topic's messages, and a function that makes one with a stamp."""
    from diagnostic_msgs.msg import DiagnosticArray
    from los_testbed.bags.cdr import codec_for
    from los_testbed.bags.diagnostics import Status, write_diagnostics
    from los_testbed.config.topics import PROGRESS_TOPIC, TOPICS
    from los_testbed.nodes.support.transport.raw_topics import MESSAGES

    from pointing_analysis.read.messages.cdr import STAMP, Encoder
    from pointing_analysis.read.messages.message_types import HEADER

    if name == CLOCK:
        from rosgraph_msgs.msg import Clock

        return Clock, lambda stamp: b"\0\1\0\0" + STAMP.pack(stamp // 10**9, stamp % 10**9)
    if name == PROGRESS_TOPIC:
        return MESSAGES[HEADER], Encoder(HEADER, 0, "").encode
    topic = next((topic for topic in TOPICS if topic.name == name), None)
    if topic is not None:
        codec, values = codec_for(topic), np.full(topic.size, 2e-4)
        return MESSAGES[topic.type_name], lambda stamp: codec.encode(stamp, values)
    status = Status(0, "telescope: plant", "running", {"missed_ticks": "0", "ticks": "7"})
    return DiagnosticArray, lambda stamp: write_diagnostics(stamp, "", status)


def _sender(node, case):
    """A function that sends a message with a stamp."""
    from rclpy.qos import QoSProfile

    message, encode = _messages(case.topic)
    publisher = node.create_publisher(message, case.path, QoSProfile(depth=1000))

    def send(stamp: int) -> None:
        data = bytes(encode(stamp))
        publisher.publish(data + bytes(case.size) if case.size >= 0 else data[: case.size])

    return send


def _silent_reader(node, heard):
    """A function that stops this process as soon as the run is heard; its readers ask for every message again."""
    from los_testbed.config.topics import TOPICS
    from los_testbed.nodes.support.transport.raw_topics import RawSubscription

    readers = [RawSubscription(node, f"/telescope/{topic.name}", topic.type_name, 5000) for topic in TOPICS]

    def stop(stamp: int) -> None:
        if heard() and readers:
            os.kill(os.getpid(), signal.SIGSTOP)

    return stop


def _caller(node, case):
    """A function that sends a request."""
    client_of, request = _request(case)
    client = node.create_client(client_of, case.path)

    def call(stamp: int) -> None:
        if client.service_is_ready():
            client.call_async(request)

    return call


def _request(case):
    """Type of a service, and a request."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from rcl_interfaces.srv import SetParameters, SetParametersAtomically
    from rclpy.parameter import Parameter
    from std_srvs.srv import Trigger

    if case.topic.endswith("change_state"):
        label = "fly" if case.request == "unknown" else ""  # a label goes before the number
        return ChangeState, ChangeState.Request(transition=Transition(id=TRANSITIONS[case.request], label=label))
    if "set_parameters" not in case.topic:
        return Trigger, Trigger.Request()
    given = [(name, value) for name, values in PARAMETERS[case.request].items() for value in values]
    parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in given]
    kind = SetParametersAtomically if case.topic.endswith("atomically") else SetParameters
    return kind, kind.Request(parameters=parameters)


if __name__ == "__main__":
    main()
