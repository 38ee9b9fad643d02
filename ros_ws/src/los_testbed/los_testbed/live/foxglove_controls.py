"""Actions of the page by Foxglove's protocol: settings as parameters, the rest as services.

A connection may act after setting the parameter ``token`` to the token of the page's address; before that it is
read-only, as is the page without the token.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator
from typing import Any

from foxglove import MessageSchema, Parameter, ParameterType, Schema, Service, ServiceRequest, ServiceSchema
from foxglove.websocket import Client, ServerListener

from los_testbed.live.frames import CHANGING

ENCODING = "json"
TOKEN = "token"
NO_TOKEN = "the parameter token must first be set to the token of the page's address on this connection"
SERVICES = {
    **{f"plant/{name}": (name, True) for name in ("start", "stop", "reset")},
    **{f"{node}/{name}": (name, node) for node in ("estimator", "controller") for name in ("activate", "deactivate")},
}
"""Relative names of the services, each with name and value of the action of the page."""
_EMPTY = {"type": "object", "properties": {}}
_ANSWER = {"type": "object", "properties": {"success": {"type": "boolean"}, "message": {"type": "string"}}}

Settings = Callable[[], dict[str, Any]]
"""Settings in force, by the names of :data:`los_testbed.live.frames.CHANGING`."""

Act = Callable[[str, Any], None]
"""Perform an action of the page and wait for its end; ValueError or RuntimeError where it is refused."""


class FoxgloveControls(ServerListener):  # type: ignore[misc, unused-ignore]
    """Parameters and services of a server of Foxglove's protocol, whose threads call the methods.

    A parameter has the name ``NAMESPACE/NODE.NAME`` of the node that applies the setting; a service that of ROS 2, or
    of the transition of the life cycle, with an answer of ``success`` and ``message``.

    Parameters
    ----------
    namespace : str
        Of the run.
    settings : callable
    act : callable
    token : str
        That of the page.
    tell : callable
        Receives the reason why a parameter was not set.
    """

    def __init__(
        self, namespace: str, settings: Settings, act: Act, token: str, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        self._names = {name: f"{namespace.rstrip('/')}/{node}.{name}" for name, node in CHANGING.items()}
        self._namespace, self._settings, self._act, self._token = namespace.rstrip("/"), settings, act, token
        self.tell = tell
        self._may_act: set[int] = set()
        self._known = settings()

    def services(self) -> list[Service]:
        """The services, for the server."""
        request, answer = (
            MessageSchema(
                encoding=ENCODING,
                schema=Schema(name=name, encoding="jsonschema", data=json.dumps(content).encode()),
            )
            for name, content in (("Request", _EMPTY), ("Response", _ANSWER))
        )
        schema = ServiceSchema("std_srvs/srv/Trigger", request=request, response=answer)
        return [Service(f"{self._namespace}/{name}", schema=schema, handler=self.call) for name in SERVICES]

    def call(self, request: ServiceRequest) -> bytes:
        """Answer to a service."""
        name, value = SERVICES[request.service_name.removeprefix(f"{self._namespace}/")]
        refused = NO_TOKEN if request.client_id not in self._may_act else self._refused(name, value)
        return json.dumps({"success": not refused, "message": refused}).encode()

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        """Those of these names; all, without names."""
        return [p for p in self._parameters(self._settings()) if not param_names or p.name in param_names]

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set them one after the other; the values that then hold, also of those that were refused."""
        asked = {parameter.name: parameter.get_value() for parameter in parameters}
        token = asked.get(TOKEN)
        if isinstance(token, str) and secrets.compare_digest(token.encode(), self._token.encode()):
            self._may_act.add(client.id)
        elif TOKEN in asked:
            self._may_act.discard(client.id)
            self.tell("token must be that of the page's address, got another one")
        values = self._settings()
        for name, full in self._names.items():
            if full not in asked:
                continue
            if refused := NO_TOKEN if client.id not in self._may_act else self._refused(name, asked[full]):
                self.tell(f"{full}: {refused}")
            else:
                values[name] = asked[full]
        return [parameter for parameter in self._parameters(values) if parameter.name in asked]

    def changed(self) -> list[Parameter]:
        """Parameters whose values have changed since the last call, by whomever."""
        before, self._known = self._known, self._settings()
        news = {name for name, value in self._known.items() if value != before[name]}
        return [parameter for name, parameter in zip(self._names, self._of_settings(self._known)) if name in news]

    def _refused(self, name: str, value: Any) -> str:
        """Perform an action; why it was refused."""
        if not isinstance(value, (bool, int, float, str)):
            return f"value must be a number, a text, true or false, got {type(value).__name__}"
        try:
            self._act(name, value)
        except (ValueError, RuntimeError) as error:
            return " ".join(str(error).split())
        return ""

    def _of_settings(self, values: dict[str, Any]) -> Iterator[Parameter]:
        for name, full in self._names.items():
            value = values[name]
            if isinstance(value, (bool, str)):
                yield Parameter(full, value=value)
            else:
                yield Parameter(full, value=float(value), type=ParameterType.Float64)

    def _parameters(self, values: dict[str, Any]) -> list[Parameter]:
        """All; the token is never sent."""
        return [Parameter(TOKEN, value=""), *self._of_settings(values)]
