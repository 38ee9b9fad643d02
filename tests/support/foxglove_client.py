"""Clients of Foxglove's WebSocket protocol, written from its description: who looks, who acts, who never reads."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import socket
import struct
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1
CALL, ANSWER = 2, 3
CALL_HEADER = struct.Struct("<BIII")
ANSWER_S = 30.0
HEADER = struct.Struct("<BIQ")


class FoxgloveClient:
    """Subscribes to every channel that is advertised and keeps what comes until the server closes.

    Attributes
    ----------
    channels : advertised channels by topic, as the protocol describes them
    messages : (log time [ns], payload) of each topic, in order of arrival
    """

    def __init__(self, address: str) -> None:
        self.channels: dict[str, dict] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self.error: BaseException | None = None
        self._address = address.replace("ws://", "http://")
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self) -> None:
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            asyncio.run(self._receive())
        except BaseException as error:
            self.error = error

    async def _receive(self) -> None:
        request = HTTPRequest(self._address.replace("http://", "ws://"))
        connection = await websocket_connect(request, subprotocols=[SUBPROTOCOL], max_message_size=1 << 24)
        assert connection.selected_subprotocol == SUBPROTOCOL
        topics: dict[int, str] = {}
        while (message := await connection.read_message()) is not None:
            if isinstance(message, bytes):
                kind, subscription, time_ns = HEADER.unpack_from(message)
                if kind == MESSAGE_DATA:
                    self.messages[topics[subscription]].append((time_ns, message[HEADER.size :]))
                continue
            content = json.loads(message)
            if content["op"] != "advertise":
                continue
            for channel in content["channels"]:
                self.channels[channel["topic"]] = channel
                self.messages.setdefault(channel["topic"], [])
                topics[channel["id"]] = channel["topic"]
            wanted = [{"id": c["id"], "channelId": c["id"]} for c in content["channels"]]
            await connection.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))


class FoxgloveSession:
    """A viewer that acts: parameters and services, one request at a time; a context of ``async with``.

    Attributes
    ----------
    services : identifiers of the advertised services, by name
    capabilities : of the server
    told : messages of status, in order of arrival
    published : values of parameters that came without a request, in order of arrival
    """

    def __init__(self, address: str, **headers: str) -> None:
        self._address, self._headers = address, headers
        self.services: dict[str, int] = {}
        self.capabilities: list[str] = []
        self.told: list[str] = []
        self.published: list[dict[str, object]] = []
        self._number = 0

    async def __aenter__(self) -> FoxgloveSession:
        request = HTTPRequest(self._address, headers=self._headers)
        self._connection = await websocket_connect(request, subprotocols=[SUBPROTOCOL], max_message_size=1 << 24)
        await self._until(lambda content: content["op"] == "serverInfo")
        return self

    async def __aexit__(self, *error: object) -> None:
        self._connection.close()

    async def parameters(self, *names: str) -> dict[str, object]:
        """Values of parameters; all, without names."""
        return await self._values({"op": "getParameters", "parameterNames": names})

    async def set(self, values: dict[str, object]) -> dict[str, object]:
        """Values after a request to set these."""
        parameters = [{"name": name, "value": value} for name, value in values.items()]
        return await self._values({"op": "setParameters", "parameters": parameters})

    async def subscribe(self, *names: str) -> None:
        """Ask for the values of parameters when they change."""
        await self._connection.write_message(json.dumps({"op": "subscribeParameterUpdates", "parameterNames": names}))

    async def next_published(self) -> dict[str, object]:
        """The next values that come without a request."""
        count = len(self.published)
        await self._until(lambda content: len(self.published) > count)
        return self.published[-1]

    async def call(self, name: str, payload: bytes = b"{}") -> dict[str, object]:
        """Answer of a service, or the message of its failure."""
        self._number += 1
        if not self.services:
            await self._until(lambda content: bool(self.services))
        head = CALL_HEADER.pack(CALL, self.services[name], self._number, 4)
        await self._connection.write_message(head + b"json" + payload, binary=True)
        wanted = self._number
        found = await self._until(lambda content: content.get("callId") == wanted)
        return dict(found["answer"]) if "answer" in found else {"failure": found["message"]}

    async def _values(self, request: dict[str, object]) -> dict[str, object]:
        self._number += 1
        wanted = str(self._number)
        await self._connection.write_message(json.dumps({**request, "id": wanted}))
        found = await self._until(lambda content: content.get("id") == wanted and content["op"] == "parameterValues")
        return {parameter["name"]: parameter.get("value") for parameter in found["parameters"]}

    async def _until(self, condition: Callable[[dict], bool]) -> dict:
        """The first message for which this holds."""
        while True:
            message = await asyncio.wait_for(self._connection.read_message(), ANSWER_S)
            assert message is not None, "the server has closed"
            content = self._take(message)
            if content is not None and condition(content):
                return content

    def _take(self, message: str | bytes) -> dict | None:
        if isinstance(message, bytes):
            if message[0] != ANSWER:
                return None
            _, service, call, length = CALL_HEADER.unpack_from(message)
            answer = json.loads(message[CALL_HEADER.size + length :])
            return {"op": "answer", "serviceId": service, "callId": call, "answer": answer}
        content: dict = json.loads(message)
        if content["op"] == "serverInfo":
            self.capabilities = content["capabilities"]
        elif content["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in content["services"]}
        elif content["op"] == "status":
            self.told.append(content["message"])
        elif content["op"] == "parameterValues" and not content.get("id"):
            self.published.append({p["name"]: p.get("value") for p in content["parameters"]})
        return content


def never_reading(address: str, path: str, subprotocol: str = "", subscribe_to: int = 0) -> socket.socket:
    """A connection that asks for data, with the smallest receive buffer, and never reads it."""
    parts = urlsplit(address)
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    connection.connect((parts.hostname, parts.port))
    key = base64.b64encode(os.urandom(16)).decode()
    lines = [
        f"GET {path} HTTP/1.1",
        f"Host: {parts.netloc}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
        *([f"Sec-WebSocket-Protocol: {subprotocol}"] if subprotocol else []),
    ]
    connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
    if subscribe_to:
        subscriptions = [{"id": i, "channelId": i} for i in range(1, subscribe_to + 1)]
        text = json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()
        connection.sendall(b"\x81\xfe" + struct.pack(">H", len(text)) + bytes(4) + text)  # masked with zeros
    return connection
