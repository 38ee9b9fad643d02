"""Common parts of the nodes: start, parameters, diagnostics, events for the runner, signals, shutdown."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from lftkit.errors import InputError
from los_testbed.bags.diagnostics import Status, write_diagnostics
from los_testbed.config.run_config import ACTIVE, NAMESPACE
from los_testbed.config.topics import DIAGNOSTICS_TOPIC, OWN_DIAGNOSTICS
from los_testbed.nodes.support.lifecycle import MANAGED, ManagedNode
from los_testbed.nodes.support.parameters import ChangingParameters, declare_config
from los_testbed.nodes.support.report_watch import report_quality
from los_testbed.nodes.support.requesters import UNKNOWN, Requesters
from los_testbed.nodes.support.requests import Requests
from los_testbed.nodes.support.transport.middleware import choose_middleware
from los_testbed.nodes.support.transport.raw_topics import listed_publisher
from los_testbed.nodes.support.transport.serialized_reader import publisher_gid
from los_testbed.run.loop.changes import NAMES, Apply, Changes
from los_testbed.run.loop.members import members
from los_testbed.run.loop.scheduling import (
    CPU_INDEX,
    PRIORITIES,
    become_real_time,
    disable_idle_states,
    end_with_parent,
    sharpen_timers,
)
from los_testbed.run.processes.node_launch import EVENTS_VARIABLE
from los_testbed.run.processes.ros_variables import check_variables
from pointing_analysis.command.exit_codes import ExitCode

CHANGING = "set_parameters", "set_parameters_atomically"
"""Services of every node that change the run. Life-cycle services are created by a library below rclpy without
introspection: their clients are not known."""

NO_FRAME = ""
"""Frame of a report: the state of a node has none."""

ALIVE_S = 1.0
"""Interval of a node's heartbeat to the runner [s]."""

REPORT_S = 5.0
"""Longest wait for the recorder to receive the last report of a node [s]; with a killed recorder all of it passes."""


class ProcessContext:
    """Shared state of the nodes of a process: rclpy, the signals that end them, the runner.

    Parameters
    ----------
    name : str
        Of the program.
    arguments : sequence of str
        Command line, ``--ros-args`` included.
    """

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.stop = False
        self.signal = 0
        runner = os.environ.get(EVENTS_VARIABLE, "")
        self.tells = bool(runner)
        if self.tells:
            end_with_parent(int(runner))
        sharpen_timers()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        check_variables(os.environ)
        choose_middleware(os.environ)
        rclpy.init(args=[name, *arguments], signal_handler_options=SignalHandlerOptions.NO)

    def _on_signal(self, number: int, frame: Any) -> None:
        self.stop, self.signal = True, self.signal or number

    def tell(self, event: Mapping[str, Any]) -> None:
        """Write an event for the runner, if one listens."""
        if self.tells:
            try:
                os.write(1, (json.dumps(event) + "\n").encode())
            except OSError:
                self.tells = False


class NodeContext:
    """A node, by default in namespace ``/telescope``, with the run's configuration as parameters.

    Parameters
    ----------
    name : str
        plant, estimator, controller or recorder.
    arguments : sequence of str
        Command line, ``--ros-args`` included.
    beside : NodeContext, optional
        Node of the same process, whose command line it shares.
    """

    def __init__(self, name: str, arguments: Sequence[str] = (), beside: NodeContext | None = None) -> None:
        self.name = name
        self.process: ProcessContext = ProcessContext(name, arguments) if beside is None else beside.process
        self._first = beside is None
        self._next_alive = 0.0
        self.code: int = ExitCode.FINISHED
        managed = name in MANAGED
        self.node = ManagedNode(name, namespace=NAMESPACE) if managed else rclpy.create_node(name, namespace=NAMESPACE)
        self.config = declare_config(self.node, NAMES.get(name, ()))
        self._changing: ChangingParameters | None = None
        self.requesters: Requesters | None = None
        if isinstance(self.node, ManagedNode):
            self.node.begin()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._requests = Requests(self.node)
        self._work: deque[Callable[[], None]] = deque()
        self._label = f"{self.config.namespace.strip('/') or 'root'}: {name}"
        self._statistics = self.node.create_publisher(Float64MultiArray, "~/statistics", QoSProfile(depth=10))
        with self._statistics.handle:
            self._gid = publisher_gid(self._statistics.handle)
        members().join(self.node.get_fully_qualified_name(), self._gid)
        usual = QoSProfile(depth=10)
        of_reports = report_quality(10) if self.config.mode == "realtime" else usual
        self._diagnostics = [
            listed_publisher(self.node, DiagnosticArray, topic, quality)
            for topic, quality in ((DIAGNOSTICS_TOPIC, usual), (f"{name}/{OWN_DIAGNOSTICS}", of_reports))
        ]

    def all_listed(self) -> None:
        """Notify the other nodes of the run that all publishers of this one exist."""
        members().complete(self.node.get_fully_qualified_name())

    @property
    def stop(self) -> bool:
        """Whether the process is to end."""
        return self.process.stop

    @property
    def ended(self) -> bool:
        """Whether the node is to end: by a signal, or by a request of its life cycle."""
        return self.stop or (isinstance(self.node, ManagedNode) and self.node.ended)

    def allow_changes(self, appliers: Mapping[str, Apply], limits: Mapping[str, float] | None = None) -> Changes:
        """Let users change these settings during the run; the loop calls ``advance`` of the result at every tick.

        Raises
        ------
        ValueError
            The parameter ``fault`` has an invalid value.
        """
        requesters = Requesters(self.node, self._gid)
        changes = Changes(self.config, appliers, limits or {}, requesters.who)
        if isinstance(self.node, ManagedNode):
            self.node.on_active = lambda active: changes.enqueue(ACTIVE, active, by=UNKNOWN)
        self._changing = ChangingParameters(self.node, changes)
        for service in list(self.node.services):
            if service.service_name.endswith(CHANGING):
                requesters.watch(service)
        self.requesters = requesters
        return changes

    def end(self, value: bool = True) -> None:
        """End the process as a signal does."""
        self.process.stop = self.stop or value

    def become_real_time(self) -> None:
        """Set real-time scheduling of the process, or report once what was not permitted."""
        if not self.config.priority or self.config.mode != "realtime":
            return
        if self.name == "plant":
            disable_idle_states()
        cpu = CPU_INDEX[self.name] if self.config.pin else None
        refused = become_real_time(PRIORITIES[self.name], cpu)
        if refused:
            self.event("warning", message=f"not permitted: {', '.join(refused)}; running without")
            if not self.process.tells:
                self.node.get_logger().warning(f"not permitted: {', '.join(refused)}; running without")

    def warn_alone(self, lines: Sequence[str]) -> None:
        """Log warnings that a runner, if one listens, has printed before it started this node."""
        if not self.process.tells:
            for line in lines:
                self.node.get_logger().warning(line)

    def alive(self, **content: Any) -> None:
        """Send the runner a heartbeat once a second, with what the node does or waits for."""
        if self.process.tells and (now := time.monotonic()) >= self._next_alive:
            self._next_alive = now + ALIVE_S
            self.event("alive", **content)

    def service(self) -> None:
        """Answer a request, if there is one."""
        self.alive()
        if self._requests.waiting():
            if self.requesters is not None:
                self.requesters.begin()
            try:
                self._executor.spin_once(timeout_sec=0.0)
            except rclpy_implementation.RCLError as error:  # a request that cannot be read must not end the loop
                self.node.get_logger().error(f"request refused: {error}")
            if self.requesters is not None:
                self.requesters.end()
        if self._changing is not None:
            self._changing.follow()

    def work(self) -> bool:
        """Do one piece of the pending reports; whether there was one."""
        if not self._work:
            return False
        self._work.popleft()()
        return True

    def finish_work(self) -> None:
        """Do all pending work."""
        while self.work():
            pass

    def diagnose(self, level: int, message: str, values: Callable[[], Mapping[str, str]], stamp_ns: int) -> None:
        """Publish the state of this node on /diagnostics and on its own topic, which the recorder reads.

        The next calls of :meth:`work` do it: values as text, message, and one call for each topic. Before the first
        tick, where `stamp_ns` is not positive, a report in real time has the time of the wall.
        """
        if stamp_ns <= 0 and self.config.mode == "realtime":
            stamp_ns = time.time_ns()

        def make() -> None:
            status = Status(level, self._label, message, dict(values()))
            self._work.appendleft(lambda: write(status))

        def write(status: Status) -> None:
            data = write_diagnostics(max(stamp_ns, 0), NO_FRAME, status)
            self._work.extendleft(partial(publisher.publish, data) for publisher in self._diagnostics)

        self._work.append(make)

    def plot(self, values: Callable[[], Mapping[str, float]]) -> None:
        """Publish values since the last report on ``~/statistics``, by a later call of :meth:`work`.

        The numbers are in ``data``; ``layout.dim[0].label`` holds their names in the same order, with commas.
        """
        self._work.append(lambda: self._plot(values()))

    def _plot(self, values: Mapping[str, float]) -> None:
        message = Float64MultiArray(data=[float(value) for value in values.values()])
        size = len(values)
        message.layout.dim = [MultiArrayDimension(label=",".join(values), size=size, stride=size)]
        self._statistics.publish(message)

    def event(self, kind: str, **content: Any) -> None:
        """Send an event to the runner, if there is one; else log it if it is of interest.

        The last event (``done``) has the number of the signal that ended the node, 0 without one.
        """
        if not self.process.tells and (text := _log_line(kind, content)):
            self.node.get_logger().info(text)
        if kind == "done":
            content["signal"] = self.process.signal
        self.process.tell({"event": kind, "node": self.name, **content})

    def report_second_publishers(self, news: Sequence[tuple[str, str]]) -> None:
        """Report to the runner, or log, the topics with a second publisher, and its node."""
        for topic, node in news:
            self.event("second_publisher", topic=topic, publisher=node)
            if not self.process.tells:
                self.code = ExitCode.RESTARTED
                self.node.get_logger().error(f"{topic} must have one publisher, got a second one: node {node}")

    def close(self) -> None:
        """Leave the graph when the recorder has the last report; the first node of a process is closed last."""
        self.finish_work()
        self._diagnostics[1].wait_for_all_acked(Duration(seconds=REPORT_S))
        self._executor.shutdown()
        self.node.destroy_node()
        if self._first:
            rclpy.try_shutdown()


def _log_line(kind: str, content: Mapping[str, Any]) -> str:
    """Log line of an event without a runner; empty if it is of no interest."""
    if kind == "running":
        return f"run begins at {content['start_ns'] / 1e9:.3f} s"
    if kind == "bag":
        return f"bag closed: {content['path']}"
    if kind == "live":
        return f"viewers: Foxglove {content['foxglove']}, page {content['page']}"
    if kind != "done":
        return ""
    shown = ("ticks", "missed_ticks", "lost_periods", "latency_median_us", "gap_ticks", "messages", "samples_lost")
    statistics = content["statistics"]
    words = [f"{name} {statistics[name]}" for name in shown if name in statistics]
    return ", ".join(["done", *words, *([f"bag {content['bag']}"] if content.get("bag") else [])])


def run_node(name: str, arguments: Sequence[str] | None, body: Callable[[NodeContext], int]) -> int:
    """Run `body` inside a node; a user error is one line and exit code 2."""
    context = None
    try:
        context = NodeContext(name, sys.argv[1:] if arguments is None else arguments)
        return body(context) or context.code
    except (InvalidHandle, ExternalShutdownException):
        return 0 if context is not None and context.stop else 1
    except (ValueError, RuntimeError, OSError) as error:
        message = " ".join(str(error).split())
        if context is not None:
            context.event("error", message=message)
        sys.stderr.write(f"los_testbed {name}: {message}\n")
        return 2 if isinstance(error, InputError) else int(getattr(error, "code", 1))
    finally:
        if context is not None:
            context.close()
        for number in (signal.SIGINT, signal.SIGTERM):  # the node has ended: a second signal changes nothing of that
            signal.signal(number, signal.SIG_IGN)
