"""A client of Foxglove's WebSocket protocol, written from its description, and a viewer that never reads."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import socket
import struct
import threading
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1
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
