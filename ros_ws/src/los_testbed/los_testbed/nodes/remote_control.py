"""Requests to the nodes of a run from another process: settings, faults, life cycle."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from lftkit.errors import InputError
from los_testbed.nodes.support.parameters import FAULT
from los_testbed.nodes.support.transport.middleware import LOCALHOST_PROFILE, choose_middleware
from los_testbed.run.loop.changes import ALIASES, owner_of
from los_testbed.run.processes.domains import require_participants
from los_testbed.run.processes.node_launch import PROFILE_VARIABLES, RANGE_VARIABLE
from los_testbed.run.processes.ros_variables import domain_of

TRANSITIONS = {"activate": Transition.TRANSITION_ACTIVATE, "deactivate": Transition.TRANSITION_DEACTIVATE}


class NoAnswerError(RuntimeError):
    """No node answered in time."""


class RemoteControl:
    """Clients of the nodes in a namespace.

    Parameters
    ----------
    node : Node
        Node of the client.
    namespace : str
        Where the run is.
    timeout : float
        Wait for an answer at most this long [s].
    """

    def __init__(self, node: Node, namespace: str, timeout: float = 10.0) -> None:
        self._node = node
        self._namespace = namespace.rstrip("/")
        self._timeout = timeout
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def change(self, name: str, value: Any, at: float | None = None) -> None:
        """Change a setting of the run, at once or `at` seconds after its start.

        Raises
        ------
        ValueError
            Refused by the node that applies it, or no such setting.
        NoAnswerError
            The node does not answer.
        """
        node, name = owner_of(name), ALIASES.get(name, name)
        change = {"name": name, "value": value, **({} if at is None else {"at": at})}
        parameter = Parameter(FAULT, value=json.dumps(change))
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
        (result,) = self._call(SetParameters, f"{node}/set_parameters", request).results
        if not result.successful:
            raise InputError(result.reason)

    def turn(self, node: str, transition: str) -> None:
        """Activate or deactivate estimator or controller.

        Raises
        ------
        ValueError
            Refused: it is in that state already.
        NoAnswerError
            The node does not answer.
        """
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        if not self._call(ChangeState, f"{node}/change_state", request).success:
            state = {"activate": "inactive", "deactivate": "active"}[transition]
            raise InputError(f"{node} must be {state} for the transition {transition}, got another state")

    def trigger(self, name: str) -> None:
        """Start, stop or reset the run.

        Raises
        ------
        ValueError
            Refused: the run is in another state.
        NoAnswerError
            The plant does not answer.
        """
        from std_srvs.srv import Trigger

        response = self._call(Trigger, f"plant/{name}", Trigger.Request())
        if not response.success:
            raise InputError(response.message)

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        service = f"{self._namespace}/{name}"
        client = self._node.create_client(kind, service)
        try:
            end = time.monotonic() + self._timeout
            if not client.wait_for_service(self._timeout):
                raise NoAnswerError(f"a run must be active, got no service {service} within {self._timeout:g} s")
            future = client.call_async(request)
            self._executor.spin_until_future_complete(future, max(0.1, end - time.monotonic()))
            if not future.done():
                raise NoAnswerError(f"{service} must answer within {self._timeout:g} s, got nothing")
            return future.result()
        finally:
            self._node.destroy_client(client)


@contextmanager
def remote_control(domain: int | None, namespace: str, timeout: float) -> Iterator[RemoteControl]:
    """Clients in a process of their own; `domain` None is that of the environment.

    Raises
    ------
    ValueError
        Discovery ends at this machine, which has no run on the domain.
    """
    os.environ.setdefault(RANGE_VARIABLE, "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", "/tmp")
    choose_middleware(os.environ)
    if os.environ.get(PROFILE_VARIABLES[0]) == str(LOCALHOST_PROFILE):
        require_participants(domain_of(os.environ) if domain is None else domain, namespace)
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = Node(f"control_{os.getpid()}", context=context)
    try:
        yield RemoteControl(node, namespace, timeout)
    finally:
        node.destroy_node()
        context.shutdown()
