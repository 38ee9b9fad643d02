"""Web server of the page (package tornado): files, frames over a web socket, actions that need a token."""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

STATIC = Path(__file__).with_name("static")
FRAME_S = 0.1
"""Time between frames of a viewer that keeps up."""

MAX_VIEWERS = 16
"""Viewers that are served; each one costs the server some percent of a processor."""

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


class _Files(StaticFileHandler):  # type: ignore[misc, unused-ignore]
    def set_extra_headers(self, path: str) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)


class _Data(WebSocketHandler):  # type: ignore[misc, unused-ignore]
    """A viewer: it gets the next frame when it has taken the one before."""

    def initialize(self, server: PageServer) -> None:
        self._server = server

    async def open(self, *args: str, **kwargs: str) -> None:
        if len(self._server.viewers) >= MAX_VIEWERS:
            self.close(1013, f"there are {MAX_VIEWERS} viewers already")
            return
        self._server.viewers.add(self)
        seen: dict[str, int] = {}
        while self in self._server.viewers:
            try:
                await self.write_message(json.dumps(self._server.frame(seen), separators=(",", ":")))
            except WebSocketClosedError:
                return
            await asyncio.sleep(FRAME_S)

    def on_close(self) -> None:
        self._server.viewers.discard(self)


class _Action(RequestHandler):  # type: ignore[misc, unused-ignore]
    """An action: the token of the printed address in a header, name and value as JSON."""

    def initialize(self, server: PageServer) -> None:
        self._server = server

    async def post(self) -> None:
        server = self._server
        if not secrets.compare_digest(self.request.headers.get(TOKEN_HEADER, "").encode(), server.token.encode()):
            self._answer(403, "token must be that of the printed address, got another one or none")
            return
        try:
            content = json.loads(self.request.body)
            if not isinstance(content, dict) or set(content) != {"name", "value"}:
                raise ValueError("action must be a JSON object with name and value, got another content")
            await asyncio.get_running_loop().run_in_executor(None, server.act, str(content["name"]), content["value"])
        except (ValueError, RuntimeError) as error:
            self._answer(400, " ".join(str(error).split()))
        else:
            self._answer(200, "")

    def _answer(self, code: int, error: str) -> None:
        self.set_status(code)
        self.finish({"error": error})


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

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """

    def __init__(self, host: str, port: int, frame: Frame, act: Act) -> None:
        self.frame, self.act = frame, act
        self.token = secrets.token_urlsafe(16)
        self.viewers: set[_Data] = set()
        own = {"server": self}
        files = {"path": str(STATIC), "default_filename": "page.html"}
        handlers = [(r"/data", _Data, own), (r"/action", _Action, own), (r"/(.*)", _Files, files)]
        try:
            sockets = bind_sockets(port, host)
        except OSError as error:
            raise ValueError(f"live port must be free on {host}, got {port} ({error.strerror})") from None
        self.port = int(sockets[0].getsockname()[1])
        self._server = HTTPServer(Application(handlers), max_body_size=MAX_REQUEST)
        self._server.add_sockets(sockets)

    async def stop(self, frames: int = 3) -> None:
        """Let the viewers take some more frames, then close."""
        await asyncio.sleep(frames * FRAME_S)
        for viewer in list(self.viewers):
            viewer.close(1000, "the run is over")
        self._server.stop()
        await asyncio.sleep(FRAME_S)
