"""Server of Foxglove's protocol (package foxglove-sdk): the bytes and schemas of the topics as they are."""

from __future__ import annotations

import secrets
import ssl
from collections.abc import Mapping

import foxglove
from foxglove import Channel, Context, Schema, StatusLevel
from foxglove.websocket import Capability

from los_testbed.bags.schemas import DEFINITIONS
from los_testbed.live.access import FOXGLOVE_SITE, Access
from los_testbed.live.foxglove_controls import ENCODING, FoxgloveControls
from los_testbed.live.gate import Gate
from los_testbed.run.processes.viewers import listening_sockets

BACKLOG = 16_384
"""Messages buffered for a slow viewer, about 2 s or 3 MB; older ones are dropped."""

REFUSED = "refused"
"""Name of the status with the reason why a parameter was not set; the next one replaces it."""


class FoxgloveServer:
    """One channel per topic; who subscribes is served in threads of the library, outside Python.

    The library serves whoever connects. So it listens on a loopback address that is drawn at random of 2**24, which a
    page in a browser cannot find, and a :class:`~los_testbed.live.gate.Gate` passes on who has access. Made inside the
    event loop.

    Parameters
    ----------
    topics : mapping of str to str
        Message type of each topic.
    host, port : str, int
        Where to listen; port 0 takes a free one.
    origins : tuple of str
        Origins whose pages may connect, besides those of this machine and of Foxglove.
    tls : ssl.SSLContext, optional
        The certificate; then the address begins with wss.
    controls : FoxgloveControls, optional
        Parameters and services; without them viewers are read-only.

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """

    def __init__(
        self,
        topics: Mapping[str, str],
        host: str,
        port: int,
        origins: tuple[str, ...] = (),
        tls: ssl.SSLContext | None = None,
        controls: FoxgloveControls | None = None,
    ) -> None:
        sockets = listening_sockets(host, port)
        self.port = int(sockets[0].getsockname()[1])
        self._context = Context()  # nothing else keeps it alive
        inside = hidden_address()
        self._controls = controls
        self._server = foxglove.start_server(
            name="los-testbed",
            host=inside,
            port=0,
            context=self._context,
            message_backlog_size=BACKLOG,
            capabilities=[Capability.Parameters, Capability.Services] if controls else None,
            server_listener=controls,
            supported_encodings=[ENCODING] if controls else None,
            services=controls.services() if controls else None,
        )
        if controls is not None:
            controls.tell = lambda text: self._server.publish_status(text, StatusLevel.Error, REFUSED)
        self._gate = Gate(Access(host, (FOXGLOVE_SITE, *origins)), (inside, int(self._server.port)), tls)
        self._gate.add_sockets(sockets)
        self._channels = {
            topic: Channel(
                topic,
                schema=Schema(name=kind, encoding="ros2msg", data=DEFINITIONS[kind].encode()),
                message_encoding="cdr",
                context=self._context,
            )
            for topic, kind in topics.items()
        }

    def send(self, topic: str, data: bytes, time_ns: int) -> None:
        """Send a serialised message to the subscribers."""
        self._channels[topic].log(data, log_time=time_ns)

    def tell_changes(self) -> None:
        """Publish the parameters that have changed."""
        if self._controls is not None and (news := self._controls.changed()):
            self._server.publish_parameter_values(news)

    def stop(self) -> None:
        """Close all connections."""
        self._gate.stop()
        self._server.stop()


def hidden_address() -> str:
    """A random address of this machine's loopback network, 127.1.0.0 to 127.254.255.255."""
    return f"127.{1 + secrets.randbelow(254)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
