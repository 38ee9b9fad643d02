"""Web server of the page (package tornado): files, frames over a web socket, actions that need a token.

Every request must name the server in Host, and a web socket be opened by this page. A connection becomes a viewer when
it has answered a ping; before, it is one of the silent ones, of which the least recently active is closed for another.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from lftkit.errors import InputError
from los_testbed.live.access import MAX_VIEWERS, Access
from los_testbed.live.connections import SilentConnections, place_is_free
from los_testbed.run.processes.viewers import listening_sockets

STATIC = Path(__file__).with_name("static")
FRAME_S = 0.1
"""Time between frames of a viewer that keeps up."""


MAX_SILENT = 128
"""Connections that are no viewers."""

IDLE_S = 20.0
"""Time in which a connection must send its next request."""

PING_S = 5.0
"""Time from one ping to the next, and for the answer."""

STALE_S = 8.0
"""A viewer that has not answered for this long is closed for another one."""

TOKEN_HEADER = "X-Token"
MAX_REQUEST = 4096
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

Frame = Callable[[dict[str, int]], dict[str, Any]]
"""Next frame of a viewer; the argument is what the viewer has, kept by this function."""

Act = Callable[[str, Any], None]
"""Perform an action of this name with this value; ValueError where it is refused."""


class _OwnName(RequestHandler):  # type: ignore[misc, unused-ignore]
    """A request that names this server."""

    def initialize(self, server: PageServer) -> None:
        self._server = server

    def prepare(self) -> None:
        if not self._server.access.host(self.request.headers.get("Host", "")):
            raise HTTPError(403, reason="Host must be a name of this server")


class _Files(_OwnName, StaticFileHandler):  # type: ignore[misc, unused-ignore]
    def initialize(self, server: PageServer, path: str = str(STATIC), default_filename: str = "page.html") -> None:
        _OwnName.initialize(self, server)
        StaticFileHandler.initialize(self, path, default_filename)

    def parse_url_path(self, url_path: str) -> str:
        if url_path not in {"", *(file.name for file in STATIC.iterdir())}:
            raise HTTPError(404)
        return url_path

    def set_extra_headers(self, path: str) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)


class _Data(_OwnName, WebSocketHandler):  # type: ignore[misc, unused-ignore]
    """A viewer: it gets the next frame after receiving the last one."""

    answered = 0.0
    """Time of the last answer to a ping; 0 before the first."""

    def check_origin(self, origin: str) -> bool:
        """A page of another origin is refused; tornado asks only about those."""
        return False

    def open(self, *args: str, **kwargs: str) -> None:
        self._stream = self.ws_connection.stream
        self.ping()

    def on_pong(self, data: bytes) -> None:
        first = not self.answered
        self.answered = time.monotonic()
        if not first:
            return
        if not self._server.place_is_free():
            self.close(1013, f"viewers must be at most {MAX_VIEWERS}, got one more")
            return
        self._server.viewers.add(self)
        self._server.silent.remove(self._stream)
        self._frames = asyncio.ensure_future(self._send())

    async def _send(self) -> None:
        seen: dict[str, int] = {}
        with contextlib.suppress(WebSocketClosedError):
            while self in self._server.viewers:
                await self.write_message(json.dumps(self._server.frame(seen), separators=(",", ":")))
                await asyncio.sleep(FRAME_S)

    def on_close(self) -> None:
        self._server.viewers.discard(self)


class _Action(_OwnName):  # type: ignore[misc, unused-ignore]
    """An action: the token of the printed address in a header, name and value as JSON."""

    async def post(self) -> None:
        server = self._server
        if not secrets.compare_digest(self.request.headers.get(TOKEN_HEADER, "").encode(), server.token.encode()):
            self._answer(403, "token must be that of the printed address, got another one or none")
            return
        try:
            content = json.loads(self.request.body)
            if not isinstance(content, dict) or set(content) != {"name", "value"}:
                raise InputError("action must be a JSON object with name and value, got another content")
            await asyncio.get_running_loop().run_in_executor(None, server.act, str(content["name"]), content["value"])
        except (ValueError, RuntimeError) as error:
            self._answer(400, " ".join(str(error).split()))
        else:
            self._answer(200, "")

    def _answer(self, code: int, error: str) -> None:
        self.set_status(code)
        self.finish({"error": error})


class _Server(HTTPServer):  # type: ignore[misc, unused-ignore]
    """Server that knows its connections."""

    silent: SilentConnections

    def handle_stream(self, stream: IOStream, address: tuple[str, int]) -> None:
        self.silent.add(stream)
        super().handle_stream(stream, address)

    def start_request(self, server_conn: object, request_conn: Any) -> Any:
        self.silent.add(request_conn.stream)
        return super().start_request(server_conn, request_conn)


class PageServer:
    """The page on a port of its own.

    Parameters
    ----------
    host, port : str, int
        Where to listen; port 0 takes a free one.
    frame : callable
        Makes the frames.
    act : callable
        Performs actions; it is called in another thread.
    tls : ssl.SSLContext, optional
        The certificate; then the address begins with https.

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """

    def __init__(
        self,
        host: str,
        port: int,
        frame: Frame,
        act: Act,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self.frame, self.act, self.access = frame, act, Access(host)
        self.silent = SilentConnections(MAX_SILENT)
        self.token = secrets.token_urlsafe(16)
        self.viewers: set[_Data] = set()
        arguments = {"server": self}
        handlers = [(r"/data", _Data, arguments), (r"/action", _Action, arguments), (r"/(.*)", _Files, arguments)]
        sockets = listening_sockets(host, port)
        self.port = int(sockets[0].getsockname()[1])
        application = Application(handlers, websocket_ping_interval=PING_S, websocket_ping_timeout=PING_S)
        limits = {"max_body_size": MAX_REQUEST, "idle_connection_timeout": IDLE_S, "body_timeout": IDLE_S}
        self._server = _Server(application, ssl_options=tls, max_header_size=2 * MAX_REQUEST, **limits)
        self._server.silent = self.silent
        self._server.add_sockets(sockets)

    def place_is_free(self) -> bool:
        """Whether one more viewer can be served; the least recently active one that is stale is closed for it."""
        return place_is_free(
            self.viewers,
            lambda viewer: viewer.answered,
            STALE_S,
            lambda viewer: viewer.close(1013, "no response"),
        )

    async def stop(self, frames: int = 3) -> None:
        """Send the viewers some more frames, then close."""
        await asyncio.sleep(frames * FRAME_S)
        for viewer in list(self.viewers):
            viewer.close(1000, "the run is over")
        self._server.stop()
        await asyncio.sleep(FRAME_S)
        self.silent.close()
