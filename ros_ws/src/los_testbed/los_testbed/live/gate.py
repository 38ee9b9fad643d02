"""Access gate of a third-party web socket server: it forwards permitted requests only."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import time
from dataclasses import dataclass, field

from tornado.httputil import HTTPHeaders, HTTPInputError, parse_request_start_line
from tornado.iostream import IOStream, StreamClosedError, UnsatisfiableReadError
from tornado.tcpserver import TCPServer

from los_testbed.live.access import MAX_VIEWERS, Access
from los_testbed.live.connections import SilentConnections, place_is_free

HEAD_S = 10.0
"""Time in which the request must be complete."""

MAX_HEAD = 8192
PIECE = 65536
MAX_SILENT = 64
"""Connections that have subscribed to nothing."""

STALE_S = 5.0
"""A viewer that has received nothing for this long is closed for another one."""

TAKEN_S = 30.0
"""A viewer that has received none of its pending data for this long is closed."""


@dataclass(eq=False)
class _Viewer:
    outer: IOStream
    inner: IOStream
    active: float = field(default_factory=time.monotonic)

    def close(self) -> None:
        self.outer.close()
        self.inner.close()


class Gate(TCPServer):  # type: ignore[misc, unused-ignore]
    """Passes web sockets on to a server on another address.

    Parameters
    ----------
    access : Access
        Whose requests are passed on.
    target : tuple of str and int
        Address and port of the server.
    tls : ssl.SSLContext, optional
        The certificate; the way to the server is not encrypted.
    """

    def __init__(self, access: Access, target: tuple[str, int], tls: ssl.SSLContext | None = None) -> None:
        super().__init__(ssl_options=tls, max_buffer_size=4 * PIECE)
        self._access, self._target = access, target
        self._silent = SilentConnections(MAX_SILENT)
        self._viewers: list[_Viewer] = []

    async def handle_stream(self, stream: IOStream, address: tuple[str, int]) -> None:
        """Serve one connection."""
        self._silent.add(stream)
        inner = None
        with contextlib.suppress(StreamClosedError, UnsatisfiableReadError, OSError, asyncio.TimeoutError):
            head = await asyncio.wait_for(stream.read_until(b"\r\n\r\n", MAX_HEAD), HEAD_S)
            refusal = self._refusal(head)
            if refusal:
                await stream.write(refusal)
            else:
                inner = IOStream(socket.socket(), max_buffer_size=4 * PIECE)
                await inner.connect(self._target)
                await inner.write(head)
                await self._pass_on(_Viewer(stream, inner))
        for end in (stream, inner):
            if end is not None:
                end.close()
        self._silent.remove(stream)

    def _refusal(self, head: bytes) -> bytes:
        """Response to a rejected request; empty for others."""
        try:
            first, _, rest = head.decode("latin-1").partition("\r\n")
            parse_request_start_line(first)
            headers = HTTPHeaders.parse(rest)
        except (ValueError, HTTPInputError):
            return _answer("400 Bad Request", "request must be one of HTTP/1.1")
        hosts, origins = headers.get_list("Host"), headers.get_list("Origin")
        if len(hosts) != 1 or not self._access.host(hosts[0]):
            return _answer("403 Forbidden", "Host must be a name of this server (--live-host)")
        if not all(self._access.origin(origin, hosts[0]) for origin in origins):
            return _answer("403 Forbidden", "Origin must be permitted (--live-origin)")
        if not self._place_is_free():
            return _answer("503 Service Unavailable", f"viewers must be at most {MAX_VIEWERS}, got one more")
        return b""

    def _place_is_free(self) -> bool:
        """Whether one more viewer can be served; the least recently active stale one is closed for it."""
        return place_is_free(self._viewers, lambda viewer: viewer.active, STALE_S, _Viewer.close)

    async def _pass_on(self, viewer: _Viewer) -> None:
        """Both directions, until one of them ends."""
        ways = [asyncio.ensure_future(way) for way in (self._to_server(viewer), self._to_viewer(viewer))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            viewer.close()
            await asyncio.gather(*ways, return_exceptions=True)
            if viewer in self._viewers:
                self._viewers.remove(viewer)

    async def _to_server(self, viewer: _Viewer) -> None:
        """The first bytes after the request make a viewer of the connection."""
        first = True
        while data := await viewer.outer.read_bytes(PIECE, partial=True):
            if first and not self._place_is_free():
                return
            if first:
                self._silent.remove(viewer.outer)
                self._viewers.append(viewer)
            first = False
            await viewer.inner.write(data)

    async def _to_viewer(self, viewer: _Viewer) -> None:
        while data := await viewer.inner.read_bytes(PIECE, partial=True):
            await asyncio.wait_for(viewer.outer.write(data), TAKEN_S)
            viewer.active = time.monotonic()

    def stop(self) -> None:
        """Close everything."""
        super().stop()
        self._silent.close()
        for viewer in list(self._viewers):
            viewer.close()


def _answer(status: str, text: str) -> bytes:
    head = f"HTTP/1.1 {status}\r\nContent-Type: text/plain\r\nContent-Length: {len(text) + 1}\r\nConnection: close"
    return f"{head}\r\n\r\n{text}\n".encode()
