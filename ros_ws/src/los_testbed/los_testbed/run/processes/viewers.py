"""The server for viewers beside a run: where it listens, whom it serves, what it shows."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass

from lftkit.errors import InputError

LIVE = "live"
"""Name of the node that serves viewers."""


@dataclass(frozen=True)
class Live:
    """Server for viewers beside a run.

    Attributes
    ----------
    host, port : where it listens; port 0 takes two free ones
    tell : gets its addresses, Foxglove's and that of the page
    origins : sites whose pages may connect by Foxglove's protocol, beside those of this machine and of Foxglove
    topics : relative names of the topics that are served; empty for all
    tls_cert, tls_key : files of a certificate and its key; empty for connections without encryption
    """

    host: str = "127.0.0.1"
    port: int = 8765
    tell: Callable[[str, str], None] = lambda foxglove, page: None
    origins: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    tls_cert: str = ""
    tls_key: str = ""

    @property
    def page_port(self) -> int:
        """Port of the page."""
        return self.port and self.port + 1

    def arguments(self) -> list[str]:
        """Command line of the node.

        Examples
        --------
        >>> Live(port=0, topics=("truth/los",)).arguments()
        ['--host=127.0.0.1', '--port=0', '--topic=truth/los']
        """
        words = [f"--host={self.host}", f"--port={self.port}"]
        words += [f"--origin={origin}" for origin in self.origins]
        words += [f"--topic={topic}" for topic in self.topics]
        return words + ([f"--tls-cert={self.tls_cert}", f"--tls-key={self.tls_key}"] if self.tls_cert else [])


def listening_sockets(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen there.

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """
    from tornado.netutil import bind_sockets

    try:
        opened: list[socket.socket] = bind_sockets(port, host)
    except OSError as error:
        raise InputError(f"live port must be free on {host}, got {port} ({error.strerror})") from None
    return opened
