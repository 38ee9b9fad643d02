"""Services of the plant: start, stop and reset of the run (``std_srvs/srv/Trigger``)."""

from __future__ import annotations

import importlib.util
from typing import Any

from rclpy.node import Node

from lftkit.errors import InputError
from los_testbed.nodes.support.requesters import Requesters
from los_testbed.run.loop.changes import RESET, STOP, Changes

WAITING, RUNNING, OVER = "waiting for its start", "running", "over"


class RunServices:
    """Answers ``plant/start``, ``plant/stop`` and ``plant/reset``; a request in the wrong state is rejected.

    A start that comes again before the run begins is answered like the first one: requests may be repeated on the way.
    Without the package ``std_srvs`` there are no services; the parameter ``fault`` stops and resets as well.

    Parameters
    ----------
    node : Node
        The plant's.
    changes : Changes
        Stop and reset are changes: they apply at one tick and are recorded.
    waits : bool
        Whether a run begins only when it is started.
    requesters : Requesters, optional
        Tells who asks.

    Raises
    ------
    ValueError
        A run that waits, without ``std_srvs``.
    """

    def __init__(self, node: Node, changes: Changes, waits: bool, requesters: Requesters | None = None) -> None:
        self._changes = changes
        self._waits = waits
        self._asked = False
        self.state = WAITING
        if importlib.util.find_spec("std_srvs") is None:
            if waits:
                raise InputError("std_srvs must be installed for wait_for_start, got no such package")
            node.get_logger().warning("std_srvs must be installed for the services start, stop and reset")
            return
        from std_srvs.srv import Trigger

        for name, answer in (("start", self._start), (STOP, self._end(STOP)), (RESET, self._end(RESET))):
            service = node.create_service(Trigger, f"~/{name}", answer)
            if requesters is not None and name != "start":
                requesters.watch(service)

    @property
    def may_begin(self) -> bool:
        """Whether the run may begin."""
        return self._asked or not self._waits

    def begin(self) -> None:
        """Start of the run; the next one needs another start request."""
        self.state, self._asked = RUNNING, False

    def _start(self, request: Any, response: Any) -> Any:
        if self.state != WAITING or not self._waits:
            return _refuse(response, "start", WAITING, self.state if self.state != WAITING else "starting")
        self._asked = response.success = True
        response.message = "the run begins when all nodes answer"
        return response

    def _end(self, name: str) -> Any:
        def answer(request: Any, response: Any) -> Any:
            if self.state != RUNNING:
                return _refuse(response, name, RUNNING, self.state)
            self._changes.request(name, True)
            response.success, response.message = True, "at the next tick"
            return response

        return answer


def _refuse(response: Any, name: str, expected: str, state: str) -> Any:
    response.success, response.message = False, f"the run must be {expected} for {name}, got {state}"
    return response
